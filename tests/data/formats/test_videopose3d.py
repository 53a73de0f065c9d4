"""The 2D files of VideoPose3D: pickles that run nothing, videos as sequences, joints by the metadata."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_files_tables import COCO_METADATA, damaged, videopose3d_custom, videopose3d_detected

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

COCO = load_skeleton("coco17")
H36M = load_skeleton("h36m17")


def keypoints(frames: int, joints: int = 17, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(10, 400, (frames, joints, 2)).astype(np.float32)


def test_videos_are_sequences(tmp_path: Path):
    videos = {"walk.mp4": keypoints(6), "run.mp4": keypoints(4, seed=1)}
    path = videopose3d_custom(tmp_path / "data_2d_custom_mine.npz", videos)
    assert KEYPOINT_FORMATS.guess(path).name == "videopose3d"
    data = read(path)
    np.testing.assert_array_equal(data.keypoints, np.concatenate(list(videos.values())))
    assert (data.confidence == 1).all()
    assert data.joint_names == tuple(joint for joint in COCO.joints if joint not in COCO.midpoints)
    assert data.identity["sequence"].tolist() == ["walk.mp4"] * 6 + ["run.mp4"] * 4
    assert data.identity["frame"].tolist() == [*range(6), *range(4)]
    assert data.image_size == (640, 480)
    assert "instance" not in data.identity
    assert data.clips().max() == 1


@pytest.mark.parametrize("how", ["symmetry", "name"])
def test_human36m_joints_by_the_metadata(tmp_path: Path, how):
    told = {"keypoints_symmetry": [[4, 5, 6, 11, 12, 13], [1, 2, 3, 14, 15, 16]]}
    if how == "name":
        told = {"keypoints_symmetry": None, "layout_name": "h36m"}
    data = read(videopose3d_custom(tmp_path / "a.npz", {"v": keypoints(3)}, **told))
    assert data.joint_names == H36M.joints


def test_the_user_names_other_joints(tmp_path: Path):
    path = videopose3d_custom(tmp_path / "a.npz", {"v": keypoints(3)}, layout_name="?", keypoints_symmetry=[[], []])
    assert read(path, ReadOptions(layout="h36m17")).joint_names == H36M.joints
    with pytest.raises(UserError, match="17 keypoints"):
        read(path, ReadOptions(layout="hand21"))


def test_cameras_and_actions_of_a_set(tmp_path: Path):
    views = [keypoints(3, seed=seed) for seed in range(4)]
    table = {"S1": {"Walking 1": views, "Posing": views[:1]}}
    np.savez(tmp_path / "a.npz", positions_2d=table, metadata={"num_joints": 17})  # type: ignore[arg-type]
    data = read(tmp_path / "a.npz")
    assert len(data) == 15
    assert data.clips().max() == 4
    assert set(data.identity["action"]) == {"Walking 1", "Posing"}
    assert data.identity["camera"].tolist()[:12] == [n for n in "0123" for _ in range(3)]
    assert set(data.identity["subject"]) == {"S1"}


def test_a_camera_without_video_has_no_frames(tmp_path: Path):
    """As data_2d_h36m_detectron_pt_coco.npz: subjects, actions, four cameras of which one was not played."""
    views = [keypoints(3), None, keypoints(4, seed=2), keypoints(3, seed=3)]
    table = {"S1": {"Directions": views}, "S5": {"Directions": [keypoints(2, seed=4)] * 4}}
    path = tmp_path / "data_2d_h36m_detectron_pt_coco.npz"
    np.savez_compressed(path, positions_2d=table, metadata=COCO_METADATA)  # type: ignore[arg-type]
    data = read(path)
    assert data.joint_names == COCO.joints[:17]
    first = data.identity["subject"] == "S1"
    assert data.identity["camera"][first].tolist() == ["0"] * 3 + ["2"] * 4 + ["3"] * 3
    np.testing.assert_array_equal(data.keypoints[first][3:7], views[2])
    assert set(data.identity["sequence"]) == {"S1 Directions", "S5 Directions"} and data.clips().max() == 6


def test_the_detectors_output(tmp_path: Path):
    rng = np.random.default_rng(0)
    near, far = rng.uniform(0, 50, (2, 17)), rng.uniform(0, 50, (2, 17)) + 500
    frames = []
    for number in range(5):
        bodies = [near, far] if number < 2 else [far, near] if number < 4 else []
        frames.append(np.array([[*(body + number), np.zeros(17), np.full(17, 0.1 * number)] for body in bodies]))
    data = read(videopose3d_detected(tmp_path / "walk.mp4.npz", frames))
    assert data.image_size == (640, 480)
    assert len(data) == 6  # of the first frame all confidences are 0, the last has no body
    assert set(data.identity["sequence"]) == {"walk.mp4"}
    for instance in set(data.identity["instance"]):
        of_one = data.identity["instance"] == instance
        assert data.identity["frame"][of_one].tolist() == [1, 2, 3]
        assert np.ptp(data.keypoints[of_one].mean((1, 2))) < 5
    row = np.flatnonzero((data.identity["frame"] == 3) & (data.keypoints[:, 0, 0] < 100))[0]
    np.testing.assert_array_equal(data.keypoints[row], (near + 3).T.astype(np.float32))
    np.testing.assert_array_equal(data.confidence[row], np.float32(0.1 * 3))


class Payload:
    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_pickles_never_run(tmp_path: Path):
    marker = tmp_path / "marker"
    for name in ("positions_2d", "metadata"):
        arrays = {"positions_2d": {"v": {"custom": [keypoints(2)]}}, "metadata": {}, name: {"v": Payload(marker)}}
        np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
        with pytest.raises(UserError, match="a.npz"):
            read(tmp_path / "a.npz")
    assert not marker.exists()


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ([1, 2], "positions_2d is"),
        ({"v": [1]}, "expected a dictionary"),
        ({"v": {"custom": 5}}, "expected a list of arrays"),
        ({"v": {"custom": [np.zeros((2, 17, 5))]}}, "expected numbers (frames, joints, 2)"),
        ({"v": {"custom": [keypoints(2)]}, "w": {"custom": [keypoints(2, 16)]}}, "videos with 16, 17 keypoints"),
        ({"v": {"custom": [np.full((2, 17, 2), np.nan)]}}, "no visible joint"),
        ({"v": {"custom": [np.full((2, 17, 2), 1e30)]}}, "expected pixels"),
        ({}, "no video"),
    ],
)
def test_wrong_files_are_told(tmp_path: Path, table, says):
    np.savez(tmp_path / "a.npz", positions_2d=table, metadata={})  # type: ignore[arg-type]
    with pytest.raises(UserError, match="a.npz") as caught:
        read(tmp_path / "a.npz")
    assert says in str(caught.value)


def test_a_damaged_file_is_refused_or_read_in_full(tmp_path: Path):
    whole = videopose3d_custom(tmp_path / "whole.npz", {"v": keypoints(5)}).read_bytes()
    for content in damaged(whole, 3, 60):
        (tmp_path / "a.npz").write_bytes(content)
        try:
            data = read(tmp_path / "a.npz")
        except UserError as error:
            assert "a.npz" in str(error)
        else:
            assert np.isfinite(data.keypoints[data.confidence > 0]).all()
