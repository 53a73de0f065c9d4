"""From settings to cleaned frames: where files are looked for, joints by name, choices, notes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bodies import body_arrays, refusal, write_body

from uplift.config.loading import load_settings
from uplift.data.formats import read
from uplift.data.load import in_joints_of, load_data
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

BODY = load_skeleton("h36m17")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("UPLIFT_DATA", raising=False)
    return tmp_path


def loaded(*overrides: str, task: str | None = None):
    return load_data(load_settings(task, overrides), BODY)


def test_a_path_of_the_command_line_is_relative_to_the_current_folder(here: Path) -> None:
    write_body(here / "a.npz")
    found = loaded("data.train=a.npz", "data.root=/nowhere")
    assert len(found.train) == 60
    assert found.train.source == str(here / "a.npz")
    assert found.notes == [f"train: 60 frames from {here / 'a.npz'}"]


def test_a_path_of_a_task_file_is_relative_to_the_data_root(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "mine.yaml").write_text("skeleton: h36m17\ndata: {name: bugs, train: a.npz}\n")
    for folder in ("data/bugs", "other/bugs", "given"):
        (here / folder).mkdir(parents=True)
        write_body(here / folder / "a.npz")
    assert loaded(task="mine.yaml").train.source == str(here / "data/bugs/a.npz")
    monkeypatch.setenv("UPLIFT_DATA", str(here / "other"))
    assert loaded(task="mine.yaml").train.source == str(here / "other/bugs/a.npz")
    assert loaded("data.root=given", task="mine.yaml").train.source == str(here / "given/a.npz")


def test_the_data_root_of_a_task_file_is_relative_to_the_file(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "tasks").mkdir()
    write_body(here / "tasks" / "a.npz")
    (here / "tasks" / "mine.yaml").write_text("skeleton: h36m17\ndata: {root: ., train: a.npz}\n")
    assert Path(loaded(task="tasks/mine.yaml").train.source).samefile(here / "tasks" / "a.npz")
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    assert len(loaded(task="../tasks/mine.yaml").train) == 60


def test_a_missing_data_set_says_where_how_and_what_else(here: Path, capsys: pytest.CaptureFixture) -> None:
    message = refusal(capsys, "fit", "task=cmu")
    for part in (str(here / "data/cmu/train.npz"), "task 'cmu'", "Get it: ", "UPLIFT_DATA=", "task=demo"):
        assert part in message
    assert not (here / "runs").exists()
    message = refusal(capsys, "fit", "skeleton=h36m17", "data.train=none.npz")
    assert str(here / "none.npz") in message
    assert "subfolder" not in message


def test_no_training_data_named(here: Path, capsys: pytest.CaptureFixture) -> None:
    assert "set data.train=FILE" in refusal(capsys, "fit", "skeleton=h36m17")


def test_choosing_and_holding_out(here: Path) -> None:
    write_body(here / "a.npz")
    found = loaded("data.train=a.npz", "data.select.subjects=S1,S2", "data.select.actions=walk")
    assert (len(found.train), found.test) == (20, None)
    found = loaded("data.train=a.npz", "data.hold_out.subjects=S3", "data.select.fraction=0.5")
    assert (len(found.train), len(found.test)) == (20, 20)
    assert set(found.test.identity["subject"]) == {"S3"}
    assert "S3" not in found.train.identity["subject"]
    found = loaded("data.train=a.npz", "data.hold_out.fraction=0.25")
    assert (len(found.train), len(found.test)) == (45, 15)
    found = loaded("data.train=a.npz", "data.select.sequences=clip01", "data.select.cameras=0")
    assert set(found.train.identity["sequence"]) == {"clip01"}


def test_names_that_look_like_numbers_stay_names(here: Path) -> None:
    write_body(here / "a.npz", subject=np.array([f"{row * 3 // 60 + 1:02d}" for row in range(60)]))
    assert len(loaded("data.train=a.npz", "data.select.subjects=01").train) == 20
    assert len(loaded("data.train=a.npz", "data.select.subjects=01,03").train) == 40
    write_body(here / "b.npz", action=np.array(["yes" if row < 20 else "1e3" for row in range(60)]))
    assert len(loaded("data.train=b.npz", "data.select.actions=yes").train) == 20
    assert len(loaded("data.train=b.npz", "data.select.actions=1e3").train) == 40


def test_contradictory_choices(here: Path) -> None:
    write_body(here / "a.npz")
    with pytest.raises(UserError, match=r"data.test and data.hold_out are both set"):
        loaded("data.train=a.npz", "data.test=a.npz", "data.hold_out.subjects=S1")
    with pytest.raises(UserError, match="leaves no frame to train on"):
        loaded("data.train=a.npz", "data.hold_out.subjects=S1,S2,S3")
    with pytest.raises(UserError, match="Did you mean 'S2'"):
        loaded("data.train=a.npz", "data.hold_out.subjects=S22")


def test_joints_are_matched_by_name(here: Path) -> None:
    arrays = body_arrays(5)
    order = np.random.default_rng(3).permutation(17)
    shuffled = {key: arrays[key][:, order] for key in ("keypoints", "pose")}
    write_body(here / "a.npz", 5)
    write_body(here / "b.npz", 5, joint_names=arrays["joint_names"][order], **shuffled)
    first, second = (in_joints_of(read(here / name), BODY) for name in ("a.npz", "b.npz"))
    np.testing.assert_array_equal(first.keypoints, second.keypoints)
    np.testing.assert_array_equal(first.pose, second.pose)
    assert first.joint_names == second.joint_names == BODY.joints


def test_poses_are_brought_to_the_skeletons_root(here: Path) -> None:
    arrays = body_arrays(5)
    shift = arrays["pose"][:, 3:4]
    write_body(here / "a.npz", 5, pose=arrays["pose"] - shift, root=arrays["root"] + shift[:, 0])
    moved = in_joints_of(read(here / "a.npz"), BODY)
    np.testing.assert_allclose(moved.pose, arrays["pose"], atol=1e-3)
    np.testing.assert_allclose(moved.root, arrays["root"], atol=1e-3)


def test_what_was_noticed_is_told(here: Path) -> None:
    keypoints = body_arrays(60)["keypoints"]
    confidence = np.full((60, 17), 0.05, np.float32)
    confidence[:7, 2:] = 0
    confidence[7:10, BODY.root_index] = 0
    write_body(here / "a.npz", keypoints=keypoints, confidence=confidence)
    found = loaded("data.train=a.npz")
    assert len(found.train) == 53
    assert "7 of 60 frames dropped: fewer than 3 visible joints" in found.notes
    assert "3 frames had no root joint: filled from its visible neighbours" in found.notes
    assert found.train.root_filled.sum() == 3


def test_simulated_test_bodies_are_others(here: Path) -> None:
    found = loaded("data.simulate=40")
    assert (len(found.train), len(found.test)) == (40, 200)
    assert found.test.pose is not None
    assert not np.isin(found.train.keypoints, found.test.keypoints).all()


# What is trained on: files or what a task simulates.


def test_files_that_are_given_win_over_what_a_task_simulates(here: Path) -> None:
    write_body(here / "a.npz")
    found = loaded("data.train=a.npz", task="demo")
    assert len(found.train) == 60
    assert found.test is None
    assert found.notes[:2] == [
        "data.train is given: what task 'demo' simulates is not used",
        f"train: 60 frames from {here / 'a.npz'}",
    ]
    (here / "mine.yaml").write_text("extends: demo\ndata: {train: a.npz}\n")
    assert len(loaded(task="mine.yaml").train) == 60


def test_simulated_bodies_that_are_given_win_over_the_files_of_a_task(here: Path) -> None:
    (here / "mine.yaml").write_text("skeleton: h36m17\ndata: {train: nowhere.npz}\n")
    assert len(loaded("data.simulate=50", task="mine.yaml").train) == 50


def test_files_and_simulated_bodies_together_are_refused(here: Path) -> None:
    with pytest.raises(
        UserError, match=r"data\.train=.*a\.npz and data\.simulate=50 are both set.*Leave one of them out"
    ):
        loaded("data.train=a.npz", "data.simulate=50")
    (here / "mine.yaml").write_text("skeleton: h36m17\ndata: {train: a.npz, simulate: 50}\n")
    with pytest.raises(UserError, match=r"mine\.yaml: data\.train=a\.npz and data\.simulate=50"):
        loaded(task="mine.yaml")
