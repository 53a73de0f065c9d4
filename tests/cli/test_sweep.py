"""Sweeps from the command line: each fit is the lone one, scored without truth; what fails or stops loses nothing else."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from bodies import own_data, refusal, status_of, write_body

from uplift.cli.main import main
from uplift.cli.sweep.folder import Outcome, Sweep
from uplift.cli.sweep.stacked import stacks_of
from uplift.cli.sweep.table import best_of
from uplift.config.grid import Axis, split_grid
from uplift.config.loading import load_settings

pytestmark = pytest.mark.usefixtures("here")
STEPS = ("trainer.max_steps=20", "trainer.checkpoint_steps=2")
DEADLY = """
import os, signal
from uplift import Prior

class Deadly(Prior):
    def __init__(self, skeleton, die=False):
        super().__init__(skeleton)
        if die:
            os.kill(os.getpid(), signal.SIGKILL)

    def loss(self, lift):
        return lift.pose.square().mean()
"""


def fit_words(folder: Path) -> list[str]:
    """Return the words of a quick fit with a prior that can kill its process, and write its files."""
    (folder / "deadly.py").write_text(DEADLY)
    words = [word for word in own_data(folder / "a.npz") if not word.startswith("trainer.max_steps")]
    # In bfloat16 the sums of a stack are rounded otherwise than lone ones, and each step of Adam doubles what that changes.
    return [*words, *STEPS, "trainer.precision=32-true", f"priors.deadly.use={folder}/deadly.py:Deadly"]


def weights(run: Path) -> dict[str, torch.Tensor]:
    return torch.load(run / "lifter.pt", weights_only=True)["state"]


def same_weights(one: Path, other: Path) -> bool:
    first, second = weights(one), weights(other)
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def apart(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> float:
    return sum(float((one[name].double() - other[name].double()).square().sum()) for name in one) ** 0.5


def rows_of(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a sweep in two processes: two seeds, each with a prior that is well and with one that kills."""
    folder = tmp_path_factory.mktemp("swept")
    write_body(folder / "b.npz", seed=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        grid = ("priors.deadly.die=false,true", "seed=0..1", "sweep.workers=2")
        assert main(["fit", *fit_words(folder), "data.test=b.npz", *grid]) == 1
    (found,) = (folder / "runs/h36m17").glob("sweep_*")
    return found


def test_each_fit_of_a_sweep_is_the_lone_one_bit_by_bit(swept: Path, here: Path) -> None:
    assert status_of("fit", *fit_words(here), "seed=1") == 0
    assert same_weights(swept / "1_die=false_seed=1", here / "runs/h36m17/last")
    assert not same_weights(swept / "1_die=false_seed=1", swept / "0_die=false_seed=0")


def test_a_process_that_dies_fails_its_fit_alone(swept: Path) -> None:
    rows = rows_of(swept / "sweep.csv")
    assert [row["state"] for row in rows] == ["finished", "finished", "failed", "failed"]
    assert "SIGKILL: out of memory?" in rows[2]["error"]
    assert "failed: priors.deadly.die=true seed=0: " in (swept / "sweep.md").read_text()


def test_scores_are_without_truth_and_errors_apart(swept: Path) -> None:
    rows = rows_of(swept / "sweep.csv")
    assert rows[0]["scored_on"].endswith("test frames, their 2D alone")
    assert np.isfinite([float(row["score_2d"]) for row in rows[:2]]).all()
    assert not any("mpjpe" in name for name in rows[0])
    errors = rows_of(swept / "errors.csv")
    assert [row["run"] for row in errors] == [row["run"] for row in rows[:2]]
    assert float(errors[0]["p_mpjpe"]) > 0


def test_the_best_is_that_of_the_lowest_score_and_is_named_last(swept: Path) -> None:
    rows = rows_of(swept / "sweep.csv")[:2]
    best = min(rows, key=lambda row: float(row["score_2d"]))["run"]
    assert (swept / "best").resolve() == swept / best
    assert (swept.parent / "last").resolve() == swept / best
    assert f"Run: `{best}`" in (swept / "sweep.md").read_text()


def test_predict_and_compare_take_runs_of_a_sweep(swept: Path, capsys: pytest.CaptureFixture) -> None:
    data = swept.parents[2] / "b.npz"
    assert status_of("predict", f"run={swept}/best", f"input={data}", "output=poses.npz") == 0
    assert status_of("compare", str(swept / "0_die=false_seed=0"), str(swept / "1_die=false_seed=1")) == 0
    capsys.readouterr()
    assert "is a sweep, expected one of its runs" in refusal(
        capsys, "predict", f"run={swept}", f"input={data}", "output=b.npz"
    )


def test_stopped_by_ctrl_c_and_resumed_it_is_the_unbroken_one(swept: Path, here: Path) -> None:
    words = [*fit_words(here), "seed=0,1", "sweep.workers=1"]
    command = [sys.executable, "-m", "uplift.cli.main", "fit", *words, "sweep.how=processes"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, text=True, stdout=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests in the background inherit that it is ignored
    )  # fmt: skip
    while not list(here.glob("runs/h36m17/sweep_*/0_*/checkpoints/*.ckpt")) and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=120)[1]
    (folder,) = here.glob("runs/h36m17/sweep_*")
    assert process.returncode == 130, said
    assert f"Go on with: uplift fit resume=runs/h36m17/{folder.name} trust=deadly.py" in said
    assert not (folder / "0_seed=0/lifter.pt").exists()
    (other := here / "elsewhere").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(other)
        assert status_of("fit", f"resume={folder}", "sweep.how=auto", f"trust={here}/deadly.py") == 0
    assert same_weights(folder / "0_seed=0", swept / "0_die=false_seed=0")
    assert same_weights(folder / "1_seed=1", swept / "1_die=false_seed=1")


def test_resumed_what_is_finished_is_kept_and_what_failed_begins_again(
    swept: Path, capsys: pytest.CaptureFixture
) -> None:
    before = {path: path.stat().st_mtime_ns for path in swept.glob("*/lifter.pt")}
    deadly = swept.parents[2] / "deadly.py"
    deadly.write_text(DEADLY.replace("os.kill(os.getpid(), signal.SIGKILL)", "raise ValueError('not now')"))
    assert main(["fit", f"resume={swept}", "sweep.workers=1", f"trust={deadly}"]) == 1
    said = capsys.readouterr().out
    assert "a sweep with 2 of its 4 fits left" in said
    assert "not now" in rows_of(swept / "sweep.csv")[3]["error"]
    assert {path: path.stat().st_mtime_ns for path in swept.glob("*/lifter.pt")} == before
    assert "give it no others, found seed=0,1" in refusal(capsys, "fit", f"resume={swept}", "seed=0,1")


def test_masks_are_swept_without_a_score_and_without_a_best(tmp_path: Path) -> None:
    made = Sweep(tmp_path, "masks", [], [Axis("seed", ("0", "1"))])
    (tmp_path / "cells").mkdir()
    for cell in made.cells:
        made.put_outcome(cell, Outcome("", 10, 1.0, {}, "no score: there is none for masks"))
    assert best_of(made) is None


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["seed=0..1999"], "2,000 fits, more than sweep.most=1000. If you mean it, add sweep.most=2000"),
        (["seed=0..9", "lifter.options.units=1..4", "sweep.most=30"], "seed (10) x lifter.options.units (4): 40 fits"),
        (["seed=0,1", "trainer.devices=2"], "leave out trainer.devices"),
        (["seed=0,1", "lifter.camera=fisheye,perspective"], "lifter.camera='fisheye': expected"),
        (["seed=0,1", "data.train=none.npz"], "none.npz"),
        (["seed=0,1", "sweep.how=clouds"], "sweep.how='clouds'"),
        (["seed=0..3000000000", "sweep.most=100000"], "values"),
        (["seed=0,-1"], "seed=-1"),
    ],
)
def test_what_would_go_wrong_in_every_fit_is_refused_before_there_is_a_folder(
    here: Path, words: list[str], says: str, capsys: pytest.CaptureFixture
) -> None:
    data = [] if any(word.startswith("data.train") for word in words) else own_data(here / "a.npz")
    base = [word for word in data if not word.startswith("lifter.options.units")] or ["skeleton=h36m17"]
    message = refusal(capsys, "fit", *base, *words)
    assert says in message.splitlines()[0]
    assert not list(here.glob("runs/*/sweep_*"))


def test_an_error_of_all_fits_is_the_error_of_the_sweep(here: Path, capsys: pytest.CaptureFixture) -> None:
    words = [*own_data(here / "a.npz"), "student.options.unit=3", "sweep.workers=1", "seed=0,1"]
    message = refusal(capsys, "fit", *words)
    assert "all fits failed: " in message
    assert not list(here.glob("runs/*/sweep_*"))
    assert "unit" in message


def outcomes(made: Sweep, scores: list[list[float]]) -> None:
    (made.path / "cells").mkdir()
    for cell, score in zip(made.cells, np.ravel(scores), strict=True):
        made.put_outcome(cell, Outcome("", 10, 1.0, {"score_2d": float(score)}, "2D"))


def test_the_best_setting_has_the_lowest_mean_over_seeds_not_the_luckiest_seed(tmp_path: Path) -> None:
    axes = [Axis("lifter.options.units", ("8", "16")), Axis("seed", ("0", "1"))]
    made = Sweep(tmp_path, "", [], axes)
    outcomes(made, [[0.0, 1.0], [0.4, 0.3]])
    best = best_of(made)
    assert best is not None
    assert best[0].values == {"lifter.options.units": "16", "seed": "1"}
    assert "mean score_2d 0.3500" in best[1]
    assert "less than seeds differ" in best[1]


def test_fits_that_differ_in_their_skeleton_have_no_best(tmp_path: Path) -> None:
    made = Sweep(tmp_path, "", [], [Axis("skeleton", ("h36m17", "coco17"))])
    outcomes(made, [[0.0], [0.4]])
    assert best_of(made) is None


def test_a_stack_leaves_what_lone_fits_leave(swept: Path, here: Path) -> None:
    assert main(["fit", *fit_words(here), "seed=0,1", "sweep.how=stack"]) == 0
    (folder,) = here.glob("runs/h36m17/sweep_*")
    # Adam moves weights of tiny gradients by rounding: what is the same in double precision is near here.
    lone = [weights(swept / f"{seed}_die=false_seed={seed}") for seed in (0, 1)]
    for seed in (0, 1):
        found = weights(folder / f"{seed}_seed={seed}")
        assert apart(found, lone[seed]) < 0.05 * apart(found, lone[1 - seed])
    assert {row["state"] for row in rows_of(folder / "sweep.csv")} == {"finished"}


def test_fits_that_differ_in_more_than_a_stack_can_are_several_stacks(here: Path) -> None:
    words, axes = split_grid(["seed=0..4", "lifter.options.units=16,32", "priors.bones.weight=1,2"])
    made = Sweep.create(
        load_settings("demo", [f"{axis.key}={axis.values[0]}" for axis in axes]), "demo", words, axes, ""
    )
    groups, reason = stacks_of(made, most=8)
    assert "units" in reason
    assert [len(group) for group in groups] == [8, 2, 8, 2]
    assert all(len({cell.values["lifter.options.units"] for cell in group}) == 1 for group in groups)


@pytest.mark.parametrize(
    ("how", "package"), [(("slurm", "sweep.options.cluster=local"), "submitit"), (("ray", "sweep.workers=1"), "ray")]
)
def test_a_sweep_on_a_cluster(here: Path, how: tuple[str, str], package: str) -> None:
    pytest.importorskip(package)
    assert status_of("fit", *own_data(here / "a.npz"), "seed=0,1", f"sweep.how={how[0]}", how[1]) == 0
    (folder,) = here.glob("runs/h36m17/sweep_*")
    assert [row["state"] for row in rows_of(folder / "sweep.csv")] == ["finished", "finished"]
    assert yaml.safe_load((folder / "1_seed=1/config.yaml").read_text())["trainer"]["threads"] == 1
