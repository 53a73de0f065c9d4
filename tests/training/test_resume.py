"""A fit that was killed, interrupted or ran out of disk goes on as if nothing had happened."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from bodies import last_words, own_data, refusal, status_of, write_body

STEPS = ("trainer.max_steps=20", "trainer.checkpoint_steps=3")
ONE_STAGE = (*STEPS, "student.share=0")
# 8 steps of the teacher's, 4 of the first student's, 8 of the second's.
STAGES = (*STEPS, "student.rounds=1,2")
SCENARIOS = {
    "early": (STAGES, "teacher", 2, "kill"),
    "teacher": (STAGES, "teacher", 7, "kill"),
    "student": (STAGES, "student_1", 2, "kill"),
    "one_stage": (ONE_STAGE, "teacher", 10, "kill"),
    "while_saving": (STAGES, "student_2", 5, "kill_while_saving"),
    "interrupted": (STAGES, "teacher", 5, "interrupt"),
    "interrupted_between": (STAGES, "teacher", 8, "interrupt"),
    "interrupted_at_the_end": (STAGES, "student_2", 8, "interrupt"),
    "terminated": (STAGES, "student_2", 2, "terminate"),
    "full_disk": (STAGES, "student_2", 4, "fill_disk"),
}


def the_run(folder: Path) -> Path:
    (run,) = [path for path in (folder / "runs" / "h36m17").iterdir() if path.name != "last"]
    return run


def weights(run: Path) -> dict[str, torch.Tensor]:
    return torch.load(run / "lifter.pt", weights_only=True)["state"]


def same_weights(one: Path, other: Path) -> bool:
    first, second = weights(one), weights(other)
    return first.keys() == second.keys() and all(torch.equal(first[key], second[key]) for key in first)


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, int]]:
    """Return for each scenario its folder and the exit status of its fit."""
    base = tmp_path_factory.mktemp("broken")
    wanted = []
    for name, (settings, stage, step, event) in SCENARIOS.items():
        (base / name).mkdir()
        words = last_words("fit", *own_data(base / "a.npz"), f"data.test={base / 'a.npz'}", *settings)
        wanted.append({"folder": str(base / name), "words": words, "stage": stage, "step": step, "event": event})
    script = Path(__file__).parents[1] / "helpers/broken_fits.py"
    done = subprocess.run(
        [sys.executable, str(script)], input=json.dumps(wanted), capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    statuses = json.loads(done.stdout.splitlines()[-1])
    return {name: (base / name, status) for name, status in zip(SCENARIOS, statuses, strict=True)}


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory, broken: dict) -> dict[tuple, Path]:
    """Return the run folder of an unbroken fit for each of the two kinds of settings."""
    runs = {}
    data = next(iter(broken.values()))[0].parent / "a.npz"
    for settings in (STAGES, ONE_STAGE):
        folder = tmp_path_factory.mktemp("unbroken")
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            assert status_of("fit", *own_data(data), f"data.test={data}", *settings) == 0
        runs[settings] = the_run(folder)
    return runs


@pytest.mark.parametrize("name", [name for name in SCENARIOS if name not in ("interrupted", "terminated")])
def test_a_resumed_fit_ends_bit_identical_to_an_unbroken_one(
    name: str, broken: dict, unbroken: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run may have moved, and the current folder is another: a run is found by its path alone."""
    run = tmp_path / "moved"
    shutil.copytree(the_run(broken[name][0]), run)
    assert not (run / "lifter.pt").exists()
    monkeypatch.chdir(tmp_path)
    assert status_of("fit", f"resume={run}") == 0
    whole = unbroken[SCENARIOS[name][0]]
    assert same_weights(run, whole)
    assert (run / "metrics.csv").read_text() == (whole / "metrics.csv").read_text()
    assert (run / "evaluation.json").read_text() == (whole / "evaluation.json").read_text()
    assert sorted(path.name for path in run.iterdir()) == sorted(path.name for path in whole.iterdir())


@pytest.mark.parametrize("name", ["early", "teacher", "student", "one_stage", "while_saving"])
def test_the_kill_was_a_kill(name: str, broken: dict) -> None:
    folder, status = broken[name]
    assert status == -signal.SIGKILL
    assert not (the_run(folder) / "lifter.pt").exists()


@pytest.mark.parametrize("name", ["interrupted", "interrupted_between", "interrupted_at_the_end", "terminated"])
def test_ctrl_c_saves_and_says_how_to_go_on(name: str, broken: dict) -> None:
    folder, status = broken[name]
    text = (folder / "log.txt").read_text()
    assert status == 130
    assert "stopped and saved. Go on with: uplift fit resume=runs/h36m17/" in text
    assert "Traceback" not in text
    stage, step = SCENARIOS[name][1:3]
    state = torch.load(the_run(folder) / "checkpoints" / f"{stage}.ckpt", weights_only=True)
    assert state["global_step"] - step in (0, 1)  # the step under way is finished


def test_a_full_disk_leaves_the_last_good_checkpoint_and_nothing_half_written(broken: dict) -> None:
    folder, status = broken["full_disk"]
    text = (folder / "log.txt").read_text()
    assert status == 1, text
    assert "Traceback" not in text
    assert text.splitlines()[-1].startswith("uplift: File too large")
    run = the_run(folder)
    assert (run / "checkpoints" / "student_2.ckpt").read_bytes() == (folder / "good_student_2.ckpt").read_bytes()
    assert not list(run.rglob("*.part"))
    assert not (run / "lifter.pt").exists()


def test_resuming_a_finished_run_changes_no_weights(unbroken: dict, tmp_path: Path) -> None:
    whole = unbroken[STAGES]
    run = tmp_path / "run"
    shutil.copytree(whole, run)
    assert status_of("fit", f"resume={run}") == 0
    assert same_weights(run, whole)
    assert (run / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_without_lifter_a_finished_run_gets_it_back(unbroken: dict, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(unbroken[STAGES], run)
    (run / "lifter.pt").unlink()
    assert status_of("fit", f"resume={run}") == 0
    assert same_weights(run, unbroken[STAGES])


def test_seeds_decide_the_weights(
    unbroken: dict, broken: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = broken["early"][0].parent / "a.npz"
    for name, seed in (("same", 0), ("other", 1)):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        assert status_of("fit", *own_data(data), *STAGES, f"seed={seed}") == 0
    assert same_weights(the_run(tmp_path / "same"), unbroken[STAGES])
    assert not same_weights(the_run(tmp_path / "other"), unbroken[STAGES])


def test_what_cannot_be_resumed_is_refused(
    broken: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    run = tmp_path / "run"
    shutil.copytree(the_run(broken["teacher"][0]), run)
    assert "give it no others" in refusal(capsys, "fit", f"resume={run}", "trainer.max_steps=9")
    assert "give it no others" in refusal(capsys, "fit", f"resume={run}", "seed=0,1")
    assert "give it no others" in refusal(capsys, "fit", f"resume={run}", "task=demo")
    assert "resume=RUN" in refusal(capsys, "fit", "resume=")
    assert "No run" in refusal(capsys, "fit", "resume=runs/none")
    checkpoint = run / "checkpoints" / "teacher.ckpt"
    whole = checkpoint.read_bytes()
    for content in (b"", whole[: len(whole) // 2], b"hello"):
        checkpoint.write_bytes(content)
        assert "cannot be read as a checkpoint" in refusal(capsys, "fit", f"resume={run}")
    torch.save({"state_dict": {}, "done": 0.5}, checkpoint)
    assert "does not fit this run's settings" in refusal(capsys, "fit", f"resume={run}")
    checkpoint.write_bytes(whole)
    config = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(config.replace("skeleton: h36m17", "skeleton: coco17"))
    message = refusal(capsys, "fit", f"resume={run}")
    assert "does not fit" in message or "joint" in message
    assert checkpoint.read_bytes() == whole


def test_init_starts_from_another_runs_weights(
    unbroken: dict, broken: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    data = broken["early"][0].parent / "a.npz"
    whole = unbroken[ONE_STAGE]
    words = ["fit", *own_data(data), "student.share=0", "trainer.max_steps=1", "teacher.learning_rate=1e-12"]
    assert status_of(*words, f"init={whole}", "teacher.average=null") == 0
    first, second = weights(the_run(tmp_path)), weights(whole)
    assert all(torch.allclose(first[key], second[key], atol=1e-9) for key in first)
    assert "the network of init=" in refusal(capsys, *words, f"init={whole}", "lifter.options.units=24")
    hands = write_body(tmp_path / "hand.npz", skeleton="hand21")
    message = refusal(capsys, *words, f"init={whole}", "skeleton=hand21", f"data.train={hands}")
    assert "was trained on skeleton 'h36m17' (17 joints: hip, rhip" in message
