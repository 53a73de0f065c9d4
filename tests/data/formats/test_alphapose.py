"""AlphaPose and Halpe: lists with names of images, tracks, and objects by image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_files_json import alphapose_list, alphapose_objects, people, write_json

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.layouts import COCO_JOINTS, HALPE26, HALPE68, HALPE136, OPENPOSE18, WHOLEBODY133
from uplift.errors import UserError


def same(data, values: np.ndarray) -> None:
    np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32))
    np.testing.assert_array_equal(data.confidence, values[..., 2].astype(np.float32))


def refused(path: Path, content) -> str:
    write_json(path, content)
    with pytest.raises(UserError) as error:
        read(path, ReadOptions(format="alphapose"))
    return str(error.value)


@pytest.mark.parametrize("names", [COCO_JOINTS, HALPE26, HALPE68, WHOLEBODY133, HALPE136])
def test_a_video_comes_back(tmp_path: Path, names: tuple[str, ...]) -> None:
    values = people(12, len(names))
    path = write_json(tmp_path / "results.json", alphapose_list(values))
    assert KEYPOINT_FORMATS.guess(path).name == "alphapose"
    data = read(path)
    same(data, values)
    assert data.joint_names == names
    assert len(set(names)) == len(names)
    assert data.identity["frame"].tolist() == list(range(12))
    assert data.identity["instance"].tolist() == ["1"] * 12
    assert set(data.identity["sequence"]) == {"results"}
    assert data.follows().sum() == 11


def test_photos_have_no_frames(tmp_path: Path) -> None:
    values = people(4, 17)
    content = alphapose_list(values, track=None)
    for entry, name in zip(content, ("a.png", "a.png", "b.png", "785.jpg"), strict=True):
        entry["image_id"] = name
    data = read(write_json(tmp_path / "a.json", content))
    assert data.identity["image"].tolist() == ["a.png", "a.png", "b.png", "785.jpg"]
    assert data.identity["instance"].tolist() == ["0", "1", "2", "3"]
    for number, entry in enumerate(content):
        entry["image_id"] = f"{1000 * number:012d}.jpg"
    assert "frame" not in read(write_json(tmp_path / "a.json", content)).identity


def test_two_people_without_tracks_are_linked(tmp_path: Path) -> None:
    still = people(2, 17)
    content = alphapose_list(np.concatenate([still] * 5), track=None)
    for number, entry in enumerate(content):
        entry["image_id"] = f"walk_{number // 2:06d}.png"
    data = read(write_json(tmp_path / "a.json", content))
    assert data.identity["instance"].tolist() == ["0"] * 5 + ["1"] * 5
    assert set(data.identity["sequence"]) == {"walk"}
    same(data, np.repeat(still, 5, 0))


@pytest.mark.parametrize("form", ["cmu", "open"])
def test_objects_by_image_and_files_of_them(tmp_path: Path, form: str) -> None:
    values = people(12, 18)
    content = alphapose_objects(values, form)
    path = write_json(tmp_path / "video.json", content)
    assert KEYPOINT_FORMATS.guess(path).name == "alphapose"
    data = read(path)
    same(data, values)
    assert data.joint_names == OPENPOSE18
    assert data.identity["frame"].tolist() == list(range(12))
    for name, image in content.items():
        write_json(tmp_path / f"sep/{Path(name).stem}.json", image)
    assert KEYPOINT_FORMATS.guess(tmp_path / "sep").name == ("alphapose" if form == "cmu" else "openpose")
    data = read(tmp_path / "sep")
    same(data, values)
    assert data.identity["frame"].tolist() == list(range(12))


def test_wrong_files_are_refused(tmp_path: Path) -> None:
    def changed(**changes) -> str:
        content = alphapose_list(people(3, 17))
        content[1].update(changes)
        return refused(tmp_path / "a.json", content)

    assert "entry 1: 'keypoints' has 6 numbers, but 51" in changed(keypoints=[1, 2, 0.5] * 2)
    assert "entry 1 has image_id None" in changed(image_id=None)
    assert "entry 1 has idx {" in changed(idx={"a": 1})
    assert "has no bodies" in refused(tmp_path / "a.json", [])
    assert "neither 'bodies' nor 'people'" in refused(tmp_path / "a.json", {"1.jpg": {"version": 1}})
    assert "body 0 is 5" in refused(tmp_path / "a.json", {"1.jpg": {"bodies": [5]}})
    assert "has 50 numbers" in refused(tmp_path / "a.json", {"1.jpg": {"bodies": [{"joints": [1] * 50}]}})


def test_real_file(benchmark_data) -> None:
    path = benchmark_data("trackers/alphapose/alphapose-results.json")
    assert KEYPOINT_FORMATS.guess(path).name == "alphapose"
    data = read(path)
    assert data.keypoints.shape == (60, 26, 2)
    assert data.identity["frame"].tolist() == list(range(60))
    np.testing.assert_array_equal(data.keypoints[0, 0], np.float32([167.5078125, 48.125]))
    np.testing.assert_allclose(data.confidence[0, 0], 0.77336, atol=1e-5)
    np.testing.assert_allclose(data.keypoints[59, 25], [152.61122, 435.29794], rtol=1e-6)
    np.testing.assert_allclose(data.confidence[59, 25], 0.75131, atol=1e-5)
    assert data.joint_names == HALPE26
    assert len(set(data.clips())) == 1
