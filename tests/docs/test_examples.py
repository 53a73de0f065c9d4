"""The examples page: every file and command, with fewer frames and steps; the poses must beat flat depth."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from bodies import refusal, status_of

import uplift
from benchmarks.examples import EXAMPLES, PAGE, files_of, write_files
from uplift.config.files import shipped_names
from uplift.config.loading import load_settings
from uplift.skeleton import load_skeleton

SHIPPED = {"quadruped": "quadruped28", "rat": "rat23", "hand": "hand21", "chair": "chair10"}

# Seconds instead of minutes: only a small teacher, with a high learning rate.
SMALL = (
    "student.share=0", "lifter.options.units=64", "lifter.refine.iterations=0", "teacher.batch_size=48",
    "teacher.learning_rate=5e-3", "priors.flow.units=16", "priors.flow.blocks=4", "priors.flow.batch_size=128",
    "priors.flow.steps=100", "trainer.max_time=null", "trainer.max_steps=150", "trainer.threads=1",
)  # fmt: skip
# Views from all directions need more steps; handedness and consistency alone need fewer.
HAND = ("priors.flow.weight=0", "priors.handedness.margin=0.5", "teacher.learning_rate=4e-3", "trainer.max_steps=200")
FRAMES = {"train.npz": 1000, "test.npz": 100}


def _commands(name: str) -> list[list[str]]:
    """Return the commands of an example's section."""
    section = next(part for part in PAGE.read_text().split("\n## ") if f"# my_{name}.yaml" in part)
    block = next(text for text in re.findall(r"^```\n(.*?)^```$", section, re.M | re.S) if "uplift fit" in text)
    return [shlex.split(line, comments=True)[1:] for line in block.splitlines()]


@pytest.fixture(params=EXAMPLES, name="name")
def example(request: pytest.FixtureRequest, here: Path) -> str:
    """Return an example whose files are in the current folder."""
    write_files(request.param, here)
    return request.param


def test_the_page_has_these_four_examples() -> None:
    assert set(files_of()) == {f"my_{name}{ending}.yaml" for name in EXAMPLES for ending in ("", "_task")}
    assert set(SHIPPED) == set(EXAMPLES)
    assert not {Path(file).stem for file in files_of()} & {*shipped_names("skeletons"), *shipped_names("tasks")}


def test_files_are_short(name: str) -> None:
    files = files_of()
    assert len(files[f"my_{name}.yaml"].splitlines()) <= 40
    assert len(files[f"my_{name}_task.yaml"].splitlines()) <= 10
    assert max(map(len, "\n".join(files.values()).splitlines())) <= 120


def test_skeletons_equal_the_included_ones(name: str) -> None:
    mine, shipped = load_skeleton(f"my_{name}.yaml"), load_skeleton(SHIPPED[name])
    assert set(mine.joints) == set(shipped.joints)
    assert {frozenset(bone) for bone in mine.bones} == {frozenset(bone) for bone in shipped.bones}
    assert {frozenset(pair) for pair in mine.mirror} == {frozenset(pair) for pair in shipped.mirror}
    assert (mine.root, mine.gravity, mine.rigid) == (shipped.root, shipped.gravity, shipped.rigid)
    order = [mine.index(joint) for joint in shipped.joints]
    for direction in ("front", "left", "up"):
        assert np.allclose(mine.facing_matrix(direction)[order], shipped.facing_matrix(direction)), direction
    assert not mine.body


def test_tasks_use_the_default_recipe(name: str) -> None:
    settings, default = load_settings(f"my_{name}_task.yaml"), load_settings(None)
    assert settings.skeleton == str(Path(f"my_{name}.yaml").absolute())
    assert settings.priors == default.priors
    assert (settings.teacher, settings.student) == (default.teacher, default.student)
    assert settings.data.root == str(Path.cwd())


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_real_sets_have_these_joints(name: str, tmp_path: Path, benchmark_data) -> None:
    from uplift.data.load import load_file
    from uplift.metrics.pose_metrics import facing_sign

    write_files(name, tmp_path)
    skeleton = load_skeleton(tmp_path / f"my_{name}.yaml")
    for split in ("train", "test"):
        data = load_file(benchmark_data(f"{name}/{split}.npz"), skeleton)
        assert data.joint_names == skeleton.joints
        assert data.pose is not None
        assert facing_sign(data.pose.astype(np.float64), skeleton).mean() >= 0.995


def _shorter(words: list[str], name: str) -> list[str]:
    """Return the command with less work."""
    if words[0] == "simulate":
        file = next(word for word in words if word.startswith("output=")).removeprefix("output=")
        return [re.sub(r"^frames=\d+$", f"frames={FRAMES[file]}", word) for word in words]
    return [*words, *SMALL, *(HAND if name == "hand" else ())] if words[0] == "fit" else words


def test_every_command_runs_and_the_poses_beat_flat_depth(name: str) -> None:
    done = []
    for words in _commands(name):
        assert status_of(*_shorter(words, name)) == 0, words
        done.append(words[0])
    assert done == ["skeleton", "simulate", "simulate", "data", "fit", "evaluate", "predict"]
    assert "<html" in Path("poses.html").read_text()[:500]
    run = Path(f"runs/my_{name}_task/last")
    model = uplift.load(run)
    assert model.skeleton.to_dict() == load_skeleton(f"my_{name}.yaml").to_dict()
    found = re.search(r"^\| `n_mpjpe` \| (\S+) \| (\S+) \|$", (run / "report.md").read_text(), re.M)
    assert found
    error, flat = map(float, found.groups())
    assert error < 0.8 * flat


MISTAKES = [
    ("quadruped", "joints: [nose,", "joints: [nosee,", "Did you mean 'nosee'?"),
    ("quadruped", "root: croup", "root: crop", "found 'crop' in 'root', which is not a joint. Did you mean 'croup'?"),
    ("rat", "[SpineL, TailBase],", "", "no bones lead from the root 'SpineL' to joint 'TailBase'"),
    ("rat", "loops: true", "loops: false", "write loops: true"),
    ("hand", "gravity: false", "gravty: false", "unknown key 'gravty'. Did you mean 'gravity'?"),
    ("hand", "  up: [wrist, middle_mcp]\n", "", "up is needed where gravity is false"),
    ("chair", "left: [[seat_rear_R, seat_front_R], [seat_rear_L, seat_front_L]]",
     "left: [[seat_rear_R, seat_rear_L], [seat_front_R, seat_front_L]]", "found 'left' along front"),
]  # fmt: skip


@pytest.mark.parametrize(("of", "old", "new", "says"), MISTAKES, ids=[new or old for _, old, new, _ in MISTAKES])
def test_a_mistake_in_a_file_is_reported(
    of: str, old: str, new: str, says: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_files(of, here)
    file = here / f"my_{of}.yaml"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    message = refusal(capsys, "skeleton", "check", file.name)
    assert says in message
    assert f"{file.name}, line " in message


def test_joints_missing_in_the_file_are_named(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_files("rat", here)
    file = here / "my_rat.yaml"
    file.write_text(file.read_text().replace("Snout", "Snuot"))
    uplift.simulate("rat23", "train.npz", frames=20)
    uplift.simulate("rat23", "test.npz", frames=20, seed=1)
    message = refusal(capsys, "fit", "task=my_rat_task.yaml", *SMALL)
    assert "missing 'Snuot'" in message
    assert "Did you mean 'Snout'?" in message
