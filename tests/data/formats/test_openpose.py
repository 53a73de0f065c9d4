"""OpenPose's frames: parts, people without numbers, gaps, and folders that are something else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_files_json import openpose_frame, people, write_json

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.layouts import HANDS, OPENPOSE15, OPENPOSE18, OPENPOSE25, OPENPOSE_FACE70
from uplift.errors import UserError


def write_video(folder: Path, bodies: np.ndarray, name: str = "walk_{:012d}_keypoints.json", start: int = 0) -> Path:
    """Write (frames, people, joints, 3), one file a frame."""
    for frame, each in enumerate(bodies):
        content = openpose_frame([{"pose": one} for one in each])
        write_json(folder / name.format(start + frame), content)
    return folder


def video(frames: int = 6, joints: int = 25, bodies: int = 1) -> np.ndarray:
    """Return (frames, bodies, joints, 3): people who stay where they are."""
    still = people(bodies, joints, seed=joints)
    drift = np.arange(frames)[:, None, None] * np.array([0.5, 0.25])
    moving = np.repeat(still[None], frames, 0)
    moving[..., :2] += np.where(still[None, ..., 2:] > 0, drift[:, None], 0)
    return moving


def refused(path: Path, **options) -> str:
    with pytest.raises(UserError) as error:
        read(path, ReadOptions(format="openpose", **options))
    return str(error.value)


@pytest.mark.parametrize(("joints", "names"), [(25, OPENPOSE25), (18, OPENPOSE18), (15, OPENPOSE15)])
def test_one_person_comes_back(tmp_path: Path, joints: int, names: tuple[str, ...]) -> None:
    bodies = video(12, joints)
    folder = write_video(tmp_path / "out", bodies)
    assert KEYPOINT_FORMATS.guess(folder).name == "openpose"
    data = read(folder)
    np.testing.assert_array_equal(data.keypoints, bodies[:, 0, :, :2].astype(np.float32))
    np.testing.assert_array_equal(data.confidence, bodies[:, 0, :, 2].astype(np.float32))
    assert data.joint_names == names
    assert data.identity["frame"].tolist() == list(range(12))
    assert set(data.identity["sequence"]) == {"walk"}
    assert "instance" not in data.identity
    assert data.follows().sum() == 11


def test_frames_are_in_order_of_their_numbers_and_gaps_stay(tmp_path: Path) -> None:
    folder = write_video(tmp_path / "out", video(12), "{}.json", start=3)
    (folder / "8.json").unlink()
    data = read(folder)
    assert data.identity["frame"].tolist() == [3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 14]
    assert set(data.identity["sequence"]) == {"out"}
    assert data.follows().sum() == 9


def test_several_videos_and_people_are_clips_of_their_own(tmp_path: Path) -> None:
    bodies = video(6, bodies=2)
    folder = write_video(tmp_path, bodies, "cam01.{:04d}.json")
    write_video(tmp_path, bodies[:4], "cam02.{:04d}.json", start=50)
    data = read(folder)
    assert len(data) == 20
    assert len(set(data.clips())) == 4
    assert data.follows().sum() == 16
    assert any("linked by place" in note for note in data.notes)
    first = (data.identity["sequence"] == "cam01") & (data.identity["instance"] == "0")
    np.testing.assert_array_equal(data.keypoints[first], bodies[:, 0, :, :2].astype(np.float32))


def test_numbers_of_people_are_kept(tmp_path: Path) -> None:
    for frame, each in enumerate(video(3, bodies=2)):
        content = openpose_frame([{"pose": one} for one in each])
        for number, person in enumerate(content["people"]):
            person["person_id"] = [5 - number]
        write_json(tmp_path / f"a_{frame}_keypoints.json", content)
    assert set(read(tmp_path).identity["instance"]) == {"4", "5"}


def test_hands_and_face_where_filled(tmp_path: Path) -> None:
    pose, hand, face = video(2)[:, 0], people(2, 21, seed=8), people(2, 70, seed=9)
    write_json(tmp_path / "a_0.json", openpose_frame([{"pose": pose[0], "hand_right": hand[0], "face": face[0]}]))
    write_json(tmp_path / "a_1.json", openpose_frame([{"pose": pose[1], "hand_right": hand[1]}]))
    data = read(tmp_path)
    assert data.joint_names == (*OPENPOSE25, *HANDS["right"], *OPENPOSE_FACE70)
    np.testing.assert_array_equal(data.keypoints[:, 25:46], hand[..., :2].astype(np.float32))
    np.testing.assert_array_equal(data.keypoints[0, 46:], face[0, :, :2].astype(np.float32))
    assert (data.confidence[1, 46:] == 0).all()


def test_frames_without_people_and_people_without_keypoints_give_no_row(tmp_path: Path) -> None:
    bodies = video(3)
    write_video(tmp_path, bodies)
    write_json(tmp_path / "walk_000000000001_keypoints.json", openpose_frame([]))
    write_json(tmp_path / "walk_000000000002_keypoints.json", openpose_frame([{"pose": 0 * bodies[2, 0]}, {}]))
    assert KEYPOINT_FORMATS.guess(tmp_path).name == "openpose"
    assert read(tmp_path).identity["frame"].tolist() == [0]


def test_one_file_and_photos(tmp_path: Path) -> None:
    frame = openpose_frame([{"pose": one} for one in video(1, bodies=2)[0]])
    write_json(tmp_path / "beach_keypoints.json", frame)
    write_json(tmp_path / "street7_keypoints.json", frame)
    data = read(tmp_path)
    assert data.identity["image"].tolist() == ["beach", "beach", "street7", "street7"]
    assert "sequence" not in data.identity
    assert len(set(data.clips())) == 4
    data = read(tmp_path / "street7_keypoints.json")
    assert data.identity["frame"].tolist() == [7, 7]


def test_names_before_version_1_2(tmp_path: Path) -> None:
    content = {"version": 1.0, "people": [{"pose_keypoints": video(1, 18)[0, 0].ravel().tolist()}]}
    assert read(write_json(tmp_path / "a_1.json", content)).joint_names == OPENPOSE18


def test_other_files_are_refused(tmp_path: Path) -> None:
    folder = write_video(tmp_path / "a", video(3))
    other = write_json(folder / "walk_000000000003_keypoints.json", [{"image_id": 3, "keypoints": []}])
    assert f"{other} has no list of 'people'" in refused(folder)
    write_json(other, openpose_frame([{"pose": video(1, 18)[0, 0]}]))
    assert "'pose_keypoints_2d' has 54 numbers, but 75 in" in refused(folder)
    only_3d = openpose_frame([{}])
    only_3d["people"][0]["pose_keypoints_3d"] = [1.0] * 100
    write_json(other, only_3d)
    assert "person 0 has 3D keypoints only" in refused(folder)
    write_json(other, {"people": ["me"]})
    assert "person 0 is 'me'" in refused(folder)
    write_json(other, {"people": [{"person_id": ["x"], "pose_keypoints_2d": [1, 2, 0.5] * 25}]})
    assert "person_id 'x'" in refused(folder)
    write_json(other, {"people": [{"person_id": [1, 2], "pose_keypoints_2d": [1, 2, 0.5] * 25}]})
    assert "person_id" in refused(folder)
    assert "no person with 2D keypoints" in refused(write_json(tmp_path / "b_1.json", openpose_frame([])))
    assert "has no *.json" in refused((tmp_path / "empty").absolute()) if (tmp_path / "empty").mkdir() is None else ""
    assert "layout=rat23" in refused(write_video(tmp_path / "c", video(3)), layout="rat23")


def test_one_filled_list_among_many_people_takes_no_memory(tmp_path: Path) -> None:
    face = [1.0] * 30_000
    content = {"people": [{"pose_keypoints_2d": [1, 2, 0.5] * 25}] * 3000 + [{"face_keypoints_2d": face}]}
    assert "only 1 of 3,001 people" in refused(write_json(tmp_path / "a_1.json", content))


def test_real_folders(benchmark_data) -> None:
    data = read(benchmark_data("trackers/openpose/single_person_cam01_json"))
    assert len(data) == 40
    assert set(data.identity["sequence"]) == {"cam01"}
    frame = data.identity["frame"]
    assert sorted(set(frame)) == list(range(20))
    first = data.keypoints[frame == 0][:, 0]
    assert np.isin(np.float32([505.232, 431.63]), first).all()
    row = np.flatnonzero((frame == 0) & (data.keypoints[:, 0, 0] == np.float32(505.232)))[0]
    assert data.confidence[row, 0] == np.float32(0.664216)
    mine = data.identity["instance"] == data.identity["instance"][row]
    assert mine.sum() == 20  # the same person all through
    last = np.flatnonzero(mine & (frame == 19))[0]
    np.testing.assert_array_equal(data.keypoints[last, 24], np.float32([316.003, 1020.45]))
    assert data.confidence[last, 24] == np.float32(0.549226)
    assert data.joint_names[17] == "UpperNeck"  # BODY_25B, told by its bones; tests/test_readers_likely_layout.py


def test_real_people(benchmark_data) -> None:
    data = read(benchmark_data("trackers/openpose/two_persons_cam02_json"))
    assert len(data) == 36
    frame, nose = data.identity["frame"], data.keypoints[:, 0, 0]
    row = np.flatnonzero((frame == 0) & (nose == np.float32(120.41368195942864)))[0]
    assert data.confidence[row, 0] == 1
    heel = data.keypoints[(frame == 11) & (data.identity["instance"] == data.identity["instance"][row]), 24]
    np.testing.assert_array_equal(heel, np.float32([[168.90098903659282, 761.8035021091599]]))
    assert len(set(data.identity["instance"])) == 3
