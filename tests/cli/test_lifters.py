"""Ready lifters on the command line: which there are, which a name means, what they take and what they refuse."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import uplift
from uplift.cli.lifters import hint_for
from uplift.cli.main import _complete, main
from uplift.config.files import shipped, shipped_names
from uplift.config.run import read_weights
from uplift.config.safe_weights import describe_safe
from uplift.data.formats.npz import write_keypoints
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.match import match_joints

READY = shipped_names("lifters")
HUMAN = (
    "coco17",
    "halpe26",
    "openpose25",
    "openpose25b",
    "mediapipe33",
    "mpii16",
    "h36m17",
    "coco_wholebody133",
    "mpi_inf_3dhp28",
)


def walk(path: Path, skeleton: str = "h36m17", frames: int = 40) -> Path:
    write_keypoints(simulate(load_skeleton(skeleton), frames, seed=1), path)
    return path


def skeleton_of(name: str) -> Skeleton:
    return Skeleton.from_dict(describe_safe(shipped("lifters") / f"{name}.safetensors")["skeleton"])


def test_person_is_ready_and_listed(capsys: pytest.CaptureFixture) -> None:
    assert "person" in READY
    assert main(["lifters"]) == 0
    shown = capsys.readouterr().out
    for name in READY:
        assert f"\n{name} " in f"\n{shown}"
        assert main(["lifters", name]) == 0
        card = capsys.readouterr().out
        assert card.startswith(f"# {name}\n")
    assert "MB" in shown
    assert "p_mpjpe" in shown
    assert "licence" in shown


@pytest.mark.parametrize("name", READY)
def test_each_has_its_card_and_says_where_it_comes_from(name: str) -> None:
    found = describe_safe(shipped("lifters") / f"{name}.safetensors")
    assert found["about"].keys() >= {
        "title",
        "figures",
        "licence",
        "origin",
        "command",
        "seed",
        "sha256 of the weights",
    }
    assert np.array(found["usual"]).shape == (2, len(found["skeleton"]["joints"]))
    skeleton, included = Skeleton.from_dict(found["skeleton"]), load_skeleton(found["skeleton"]["name"])
    assert (skeleton.joints, skeleton.bones, skeleton.root) == (included.joints, included.bones, included.root)
    card = (shipped("lifters") / f"{name}.md").read_text()
    for part in ("## Limits", "Not for:", found["about"]["sha256 of the weights"], found["about"]["origin"]):
        assert part in card


@pytest.mark.parametrize("layout", HUMAN)
def test_every_human_layout_makes_a_person(layout: str) -> None:
    names = [joint for joint in load_skeleton(layout).joints if joint not in load_skeleton(layout).midpoints]
    assert len(match_joints(names, skeleton_of("person")).missing) <= 1


@pytest.mark.parametrize(("words", "message"), [(["horse"], "no ready lifter 'horse'"), (["persn"], "Did you mean 'person'"), (["a", "b"], "one ready lifter at most")])  # fmt: skip
def test_other_names_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(UserError, match=message):
        from uplift.cli.lifters import lifters_command

        lifters_command(words)


def test_a_name_is_the_ready_lifter_unless_a_run_has_it(here: Path) -> None:
    assert read_weights("person").ready
    (here / "person").mkdir()  # a folder of data, say
    found = read_weights("person")
    assert found.ready
    assert found.settings() is None
    (here / "person/config.yaml").write_text("skeleton: h36m17\n")
    (here / "person/run.json").write_text("{}")
    with pytest.raises(UserError, match="has no lifter.pt yet"):
        read_weights("person")
    uplift.load(shipped("lifters") / "person.safetensors").save(here / "person/lifter.pt")
    found = read_weights("person")
    assert not found.ready
    assert "the run in the folder person, not the ready one" in found.note


def test_names_that_nothing_has_get_the_nearest(here: Path) -> None:
    with pytest.raises(UserError, match="No run persom, and no ready lifter of that name. Did you mean 'person'"):
        read_weights("persom")
    with pytest.raises(UserError, match="No lifter my.safetensors"):
        read_weights("my.safetensors")
    with pytest.raises(UserError, match="person is a ready lifter, expected the folder of a run"):
        uplift.compare(["person", "person"])


def test_a_lifter_is_used_by_name_and_by_file(here: Path, capsys: pytest.CaptureFixture) -> None:
    file = walk(here / "walk.npz")
    assert main(["predict", "run=person", f"input={file}", "output=a.npz", "refine=off"]) == 0
    assert "lifter: person, ready-made (uplift lifters person)" in capsys.readouterr().out
    shutil.copy(shipped("lifters") / "person.safetensors", here / "mine.safetensors")
    assert main(["predict", "run=mine.safetensors", f"input={file}", "output=b.npz", "refine=off"]) == 0
    poses = [np.load(here / name)["pose"] for name in ("a.npz", "b.npz")]
    np.testing.assert_array_equal(*poses)


def test_it_is_evaluated_without_a_run(here: Path, capsys: pytest.CaptureFixture) -> None:
    file = walk(here / "walk.npz")
    assert main(["evaluate", "run=person", f"data.test={file}", "refine=off"]) == 0
    shown = capsys.readouterr().out
    assert "p_mpjpe" in shown
    assert "it has no run in which the figures could be kept" in shown
    assert [path.name for path in here.iterdir()] == ["walk.npz"]
    with pytest.raises(UserError, match="person is a lifter without a run, so without test data: give data.test=FILE"):
        uplift.evaluate("person")
    with pytest.raises(UserError, match="evaluation=stairs: person is a lifter without a run"):
        uplift.evaluate("person", file, name="stairs")


@pytest.mark.parametrize("skeleton", ["quadruped28", "hand21", "ap10k17", "fly32"])
def test_joints_of_others_are_refused_by_name(skeleton: str, here: Path) -> None:
    joints = load_skeleton(skeleton).joints
    keypoints = np.random.default_rng(0).uniform(0, 500, (4, len(joints), 2)).astype(np.float32)
    np.savez(here / "a.npz", keypoints=keypoints, joint_names=np.array(joints))
    hint = hint_for(joints, "person")
    assert f"the file's joints are those of {skeleton}" in hint
    assert "run=person" not in hint
    with pytest.raises(UserError, match="a.npz: person knows h36m17") as refused:
        uplift.predict("person", here / "a.npz")
    assert str(refused.value).endswith(hint)


def test_the_lifter_that_fits_is_named() -> None:
    assert (
        hint_for(load_skeleton("coco17").joints, "quadruped")
        == "the file's joints are those of coco17: run=person lifts them."
    )
    assert hint_for(["a", "b", "c"], "person") == ""


def test_bodies_of_others_are_refused_unless_asked_for(here: Path, capsys: pytest.CaptureFixture) -> None:
    skeleton = load_skeleton("h36m17")
    data = simulate(skeleton, 60, seed=2)
    order = np.random.default_rng(5).permutation(len(skeleton.joints))
    np.savez(here / "a.npz", keypoints=data.keypoints[:, order], joint_names=np.array(skeleton.joints))
    words = ["predict", "run=person", "input=a.npz", "output=o.npz"]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "do not look like the body that person knows" in error
    assert "check=false" in error
    assert not (here / "o.npz").exists()
    assert main([*words, "check=false", "refine=off"]) == 0


def test_names_are_completed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COMP_LINE", "uplift predict run=")
    assert _complete("predict", "run=") == [f"run={name}" for name in READY]
    assert _complete("lifters", "") == READY
