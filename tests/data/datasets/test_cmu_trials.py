"""Which files are motions, whose, what is done in them, and which of them are the test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uplift.data.datasets.cmu import Clip, Rig, chosen_test, filmed, find_trials, read_index
from uplift.errors import UserError


def touch(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")
    return folder


def test_files_are_found_in_any_folder_and_paired_by_subject(tmp_path: Path):
    touch(
        tmp_path, "35/35.asf", "35/35_01.amc", "35/35_10.AMC", "all/7.asf", "deep/er/07_2.amc", "bvh/cmu_12_01_walk.bvh"
    )
    touch(tmp_path, "notes.txt", ".hidden_01_01.bvh")
    trials, notes = find_trials(tmp_path)
    assert [(trial.subject, trial.sequence) for trial in trials] == [
        ("S7", "07_02"), ("S12", "12_01"), ("S35", "35_01"), ("S35", "35_10"),
    ]  # fmt: skip
    assert [trial.skeleton and trial.skeleton.name for trial in trials] == ["7.asf", None, "35.asf", "35.asf"]
    assert notes == []


def test_an_amc_goes_before_the_bvh_made_of_it(tmp_path: Path):
    trials, notes = find_trials(touch(tmp_path, "35.asf", "35_01.amc", "35_01.bvh", "35_02.bvh"))
    assert [trial.path.name for trial in trials] == ["35_01.amc", "35_02.bvh"]
    assert "1 .bvh left out" in notes[0]


def test_the_skeleton_beside_the_motion_is_its_own(tmp_path: Path):
    trials, _ = find_trials(touch(tmp_path, "a/35.asf", "a/35_01.amc", "b/35.asf", "b/35_02.amc"))
    assert [trial.skeleton.parent.name for trial in trials if trial.skeleton] == ["a", "b"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["35_01.amc"], "its skeleton is missing. Expected 35.asf"),
        (["35.asf"], r"no motions \(found 1 .asf, 0 .amc, 0 .bvh\)"),
        (["a/12_01.bvh", "b/12_01.bvh"], "are both motion 12_01: keep one"),
        (["a/35.asf", "b/35.asf", "c/35_01.amc"], "2 skeletons of S35"),
    ],
)
def test_folders_that_do_not_fit_are_one_message(tmp_path: Path, names: list[str], message: str):
    with pytest.raises(UserError, match=message):
        find_trials(touch(tmp_path, *names))


def test_a_missing_folder_is_one_message(tmp_path: Path):
    with pytest.raises(UserError, match=r"No folder .*nowhere"):
        find_trials(tmp_path / "nowhere")


def test_motions_and_subjects_can_be_skipped(tmp_path: Path):
    touch(tmp_path, "12_01.bvh", "12_02.bvh", "13_01.bvh")
    trials, _ = find_trials(tmp_path, ["12_01", "S13"])
    assert [trial.sequence for trial in trials] == ["12_02"]
    with pytest.raises(UserError, match="skip=12_07: no such subject or motion"):
        find_trials(tmp_path, ["12_07"])


def test_the_index_is_read_among_its_other_lines(tmp_path: Path):
    path = tmp_path / "index.txt"
    text = "Carnegie-Mellon Database\n CMU says: “browse”\n\nSubject #1 (climb, swing)\n\n01_01\tplayground - jumps, turn\n"
    path.write_bytes((text + "02_3.amc,  run/jog\n137_42 90\n").encode() + b"\x93 no utf-8\n")
    assert read_index(path) == {"01_01": "playground - jumps, turn", "02_03": "run/jog", "137_42": "90"}


def test_something_else_is_no_index(tmp_path: Path):
    path = tmp_path / "index.txt"
    path.write_text("Subject #1 (climb)\n")
    with pytest.raises(UserError, match="no line describes a motion"):
        read_index(path)
    with pytest.raises(UserError, match="No index file"):
        read_index(tmp_path / "none.txt")


def clips(**lengths: int) -> list[Clip]:
    """Return clips named as ``S1_2=30``: subject, trial, frames."""
    made = []
    for name, length in lengths.items():
        random = np.random.default_rng(length)
        made.append(Clip(name.split("_")[0], name[1:], random.uniform(-900, 900, (length, 17, 3)).astype(np.float32)))
    return made


def test_the_test_is_whole_subjects_in_seeded_order():
    some = clips(**{f"S{subject}_{trial}": 20 for subject in range(1, 9) for trial in (1, 2)})
    chosen = [chosen_test(some, [], seed) for seed in range(6)]
    for found, how in chosen:
        subjects = {clip.subject for clip in some if clip.sequence in found}
        assert len(found) == 2 * len(subjects) == 4  # two of eight subjects reach 15 %
        assert all(subject in how for subject in subjects)
    assert len({frozenset(found) for found, _ in chosen}) > 1
    assert chosen_test(some, [], 3) == chosen[3]


def test_one_subject_is_split_by_clips_and_says_so():
    found, how = chosen_test(clips(S1_1=20, S1_2=20, S1_3=20), [], 0)
    assert len(found) == 1
    assert "no other person" in how


def test_something_is_always_left_to_train_on():
    for seed in range(5):
        found, _ = chosen_test(clips(S1_1=1, S2_1=1000), [], seed)
        assert len(found) == 1
    with pytest.raises(UserError, match="One motion only"):
        chosen_test(clips(S1_1=20), [], 0)
    with pytest.raises(UserError, match="leaves nothing to train on"):
        chosen_test(clips(S1_1=20, S2_1=20), ["S1", "S2"], 0)


def test_the_test_can_be_named_by_subject_and_motion():
    some = clips(S1_1=20, S1_2=20, S2_1=20, S3_1=20)
    assert chosen_test(some, ["S2", "1_2"], 0)[0] == {"2_1", "1_2"}
    with pytest.raises(UserError, match="test=S4: no such subject or motion. Valid: .*S1, S2, S3"):
        chosen_test(some, ["S4"], 0)


def test_rows_are_clip_by_clip_camera_by_camera_in_time_order():
    data = filmed(clips(S1_1=5, S2_1=3), Rig(cameras=2), 10.0, actions={"1_1": "walk"})
    assert len(data) == 16
    assert data.identity["sequence"].tolist() == ["1_1"] * 10 + ["2_1"] * 6
    assert data.identity["action"].tolist() == ["walk"] * 10 + ["unknown"] * 6
    assert data.identity["camera"].tolist() == [0] * 5 + [1] * 5 + [0] * 3 + [1] * 3
    assert data.identity["frame"].tolist() == [0, 12, 24, 36, 48] * 2 + [0, 12, 24] * 2
    assert data.follows().sum() == 16 - 4


def test_a_clips_cameras_do_not_depend_on_the_others():
    alone = filmed(clips(S2_1=3), Rig(), 10.0, seed=5)
    among = filmed(clips(S1_1=5, S2_1=3), Rig(), 10.0, seed=5)
    other = filmed(clips(S2_1=3), Rig(), 10.0, seed=6)
    assert np.array_equal(alone.keypoints, among.keypoints[20:])
    assert not np.allclose(alone.keypoints, other.keypoints)
