"""Kinetics skeletons, MPII's JSON, and AlphaTracker's labels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_files_json import alphatracker, kinetics, mpii, mpii_selves, people, write_json

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.layouts import COCO_JOINTS, MPII16, OPENPOSE18
from uplift.errors import UserError


def same(data, values: np.ndarray) -> None:
    np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32))
    np.testing.assert_array_equal(data.confidence, values[..., 2].astype(np.float32))


def refused(path: Path, content, format: str) -> str:
    write_json(path, content)
    with pytest.raises(UserError) as error:
        read(path, ReadOptions(format=format))
    return str(error.value)


@pytest.mark.parametrize(("names", "flat"), [(COCO_JOINTS, False), (COCO_JOINTS, True), (OPENPOSE18, True)])
def test_kinetics_comes_back(tmp_path: Path, names: tuple[str, ...], flat: bool) -> None:
    values = people(6, len(names))
    frames = [[one] for one in values]
    path = write_json(tmp_path / "abc.json", kinetics([*frames[:3], [], *frames[3:]], flat))
    assert KEYPOINT_FORMATS.guess(path).name == "kinetics_skeleton"
    data = read(path)
    same(data, values)
    assert data.joint_names == names
    assert data.identity["frame"].tolist() == [1, 2, 3, 5, 6, 7]
    assert set(data.identity["sequence"]) == {"abc"}
    assert "instance" not in data.identity


def test_kinetics_in_shares_and_in_a_folder(tmp_path: Path) -> None:
    values = people(2, 18, size=1.0)
    values[..., :2] = np.minimum(values[..., :2], 0.999)
    for name in ("a", "b"):
        write_json(tmp_path / f"all/{name}.json", kinetics([[values[0], values[1]]] * 3))
    assert KEYPOINT_FORMATS.guess(tmp_path / "all").name == "kinetics_skeleton"
    data = read(tmp_path / "all")
    assert len(data) == 12
    assert len(set(data.clips())) == 4
    assert any("shares of the image" in note for note in data.notes)
    larger = read(tmp_path / "all", ReadOptions(image_size=(340, 256)))
    np.testing.assert_allclose(larger.keypoints, data.keypoints * np.float32([340, 256]), rtol=1e-6)


def test_wrong_kinetics_is_refused(tmp_path: Path) -> None:
    def changed(**changes) -> str:
        content = kinetics([[one] for one in people(3, 18)])
        content["data"][1].update(changes)
        return refused(tmp_path / "a.json", content, "kinetics_skeleton")

    assert "entry 1: 'frame_index' is -3" in changed(frame_index=-3)
    assert "entry 1: 'frame_index' is None" in changed(frame_index=None)
    assert "entry 1 has skeleton None" in changed(skeleton=None)
    assert "skeleton 0: 'pose' has 4 numbers, but 36" in changed(skeleton=[{"pose": [1, 2, 3, 4], "score": [1, 1]}])
    assert "skeleton 0: 'score' is None" in changed(skeleton=[{"pose": [1, 2] * 18}])
    assert "has no 'data'" in refused(tmp_path / "a.json", {"label": "x"}, "kinetics_skeleton")
    assert "no skeleton in any frame" in refused(tmp_path / "a.json", kinetics([[], []]), "kinetics_skeleton")


def test_real_kinetics(benchmark_data) -> None:
    path = benchmark_data("trackers/kinetics_skeleton/baseball.json")
    assert KEYPOINT_FORMATS.guess(path).name == "kinetics_skeleton"
    data = read(path)
    assert data.keypoints.shape == (277, 17, 2)
    assert data.identity["frame"].tolist() == list(range(1, 278))
    np.testing.assert_array_equal(data.keypoints[0, 0], np.float32([567.273, 358.638]))
    np.testing.assert_array_equal(data.keypoints[276, 16], np.float32([515.221, 788.464]))
    assert data.confidence[0, 0] == np.float32(0.951)
    assert data.confidence[276, 16] == np.float32(0.882)


def test_mpii_comes_back(tmp_path: Path) -> None:
    values = people(5, 16)
    path = write_json(tmp_path / "a.json", mpii(values))
    assert KEYPOINT_FORMATS.guess(path).name == "mpii_json"
    data = read(path)
    seen = values[..., 2] > 0
    np.testing.assert_array_equal(data.keypoints[seen], values[seen][:, :2].astype(np.float32))
    np.testing.assert_array_equal(data.confidence, seen)
    assert data.joint_names == MPII16
    assert data.identity["image"].tolist() == [f"{n:09d}.jpg" for n in range(5)]
    assert "frame" not in data.identity


def test_wrong_mpii_is_refused(tmp_path: Path) -> None:
    content = mpii(people(3, 16))
    content[1]["joints_vis"].pop()
    assert "entry 1: 'joints_vis' has 15 numbers" in refused(tmp_path / "a.json", content, "mpii_json")
    content[1].pop("joints")
    assert "entry 1: 'joints' is None" in refused(tmp_path / "a.json", content, "mpii_json")
    content[1]["image"] = 5
    assert "entry 1 has image 5" in refused(tmp_path / "a.json", content, "mpii_json")
    assert "empty list" in refused(tmp_path / "a.json", [], "mpii_json")


def test_real_mpii(benchmark_data) -> None:
    path = benchmark_data("trackers/mpii/test_mpii.json")
    assert KEYPOINT_FORMATS.guess(path).name == "mpii_json"
    data = read(path)
    assert len(data) == 5
    assert data.identity["image"][[0, 4]].tolist() == ["005808361.jpg", "060754485.jpg"]
    np.testing.assert_array_equal(data.keypoints[0, 0], [804, 711])
    assert data.confidence[0, 0] == 1
    np.testing.assert_array_equal(data.keypoints[4, 9], np.float32([591.3663, 117.4341]))
    assert data.joint_names[9] == "headtop"


@pytest.mark.parametrize(("names", "root"), [(MPII16, False), (MPII16, True), (COCO_JOINTS, False)])
def test_joint_self_comes_back(tmp_path: Path, names: tuple[str, ...], root: bool) -> None:
    """Visible, hidden, at (0, 0) and not labelled; the other people of an image are no bodies of their own."""
    values = np.random.default_rng(0).uniform(20, 600, (4, len(names), 3)).round(3)
    values[..., 2] = 1
    values[1, 3, 2], values[1, 4], values[2, 5, 2] = 0, 0, 2
    content = [*mpii_selves(values), {"dataset": "MPI", "isValidation": 0.0, "joint_self": []}]
    path = write_json(tmp_path / "a.json", {"root": content} if root else content)
    assert KEYPOINT_FORMATS.guess(path).name == "mpii_json"
    data = read(path)
    expected = np.ones((4, len(names)))
    expected[1, 3], expected[1, 4], expected[2, 5] = 0.5, 0, 0
    np.testing.assert_array_equal(data.confidence, expected)
    np.testing.assert_array_equal(data.keypoints[expected > 0], values[expected > 0][:, :2].astype(np.float32))
    assert data.joint_names == names and data.image_size == (1280, 720)
    assert data.identity["image"].tolist() == ["000000000.jpg"] * 2 + ["000000001.jpg"] * 2
    content[2]["img_width"] = 640.0
    assert read(write_json(tmp_path / "b.json", content)).image_size is None


def test_wrong_joint_self_is_refused(tmp_path: Path) -> None:
    content = mpii_selves(people(3, 16))
    content[1]["joint_self"].pop()
    assert "entry 1: 'joint_self' has 45 numbers, but 48" in refused(tmp_path / "a.json", content, "mpii_json")
    content[1]["img_paths"] = 5
    content[1]["joint_self"] = content[0]["joint_self"]
    assert "entry 1 has img_paths 5" in refused(tmp_path / "a.json", content, "mpii_json")
    assert "nobody with 'joint_self'" in refused(tmp_path / "a.json", [{"joint_self": []}], "mpii_json")


def test_alphatracker_comes_back(tmp_path: Path) -> None:
    values = people(4, 3)[..., :2]
    path = write_json(tmp_path / "a.json", alphatracker([[values[0], values[1]], [], [values[2], values[3]]]))
    assert KEYPOINT_FORMATS.guess(path).name == "alphatracker"
    data = read(path)
    np.testing.assert_array_equal(data.keypoints, values.astype(np.float32))
    assert (data.confidence == 1).all()
    assert data.joint_names == ("point_0", "point_1", "point_2")
    assert data.identity["image"].tolist() == ["i0.png", "i0.png", "i2.png", "i2.png"]
    assert data.identity["instance"].tolist() == ["0", "1", "0", "1"]


def test_wrong_alphatracker_is_refused(tmp_path: Path) -> None:
    values = people(2, 3)[..., :2]
    content = alphatracker([[values[0]], [values[1]]])
    content[1]["annotations"].pop()
    assert "image 1, animal 0: 'points' has 4 numbers" in refused(tmp_path / "a.json", content, "alphatracker")
    content[1]["annotations"] = content[1]["annotations"][1:]
    assert "a point before the first 'Face'" in refused(tmp_path / "a.json", content, "alphatracker")
    content[1]["annotations"] = [{"class": "tail"}]
    assert "expected a 'Face' or a 'point'" in refused(tmp_path / "a.json", content, "alphatracker")
    content[1]["filename"] = None
    assert "image 1 has filename None" in refused(tmp_path / "a.json", content, "alphatracker")
    assert "no animal with points" in refused(tmp_path / "a.json", alphatracker([[]]), "alphatracker")


def test_real_alphatracker(benchmark_data) -> None:
    path = benchmark_data("trackers/alphatracker/at_testdata.json")
    assert KEYPOINT_FORMATS.guess(path).name == "alphatracker"
    data = read(path)
    assert data.keypoints.shape == (8, 3, 2)
    assert data.identity["image"][0] == "img000.png"
    np.testing.assert_array_equal(data.keypoints[0], [[1, 2], [1, 3], [1, 4]])
