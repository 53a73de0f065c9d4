"""MMPose's predictions of images, videos and folders, with and without names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_files_json import mmpose, mmpose_instance, people, write_json

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.layouts import COCO_JOINTS, HALPE26, HAND21, WHOLEBODY133
from uplift.errors import UserError

NAMES = tuple(f"point {n}" for n in range(5))


def refused(path: Path, content=None) -> str:
    if content is not None:
        write_json(path, content)
    with pytest.raises(UserError) as error:
        read(path, ReadOptions(format="mmpose"))
    return str(error.value)


def same(data, values: np.ndarray) -> None:
    np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32))
    np.testing.assert_array_equal(data.confidence, values[..., 2].astype(np.float32))


def test_a_video_with_meta_info(tmp_path: Path) -> None:
    values = people(6, 5)
    path = write_json(tmp_path / "run.json", mmpose([[one] for one in values], NAMES))
    assert KEYPOINT_FORMATS.guess(path).name == "mmpose"
    data = read(path)
    same(data, values)
    assert data.joint_names == NAMES
    assert data.bones == (("point 0", "point 1"), ("point 1", "point 2"))
    assert data.mirror == (("point 1", "point 2"),)
    assert data.identity["frame"].tolist() == [1, 2, 3, 4, 5, 6]
    assert set(data.identity["sequence"]) == {"run"}
    assert "instance" not in data.identity


def test_partners_by_flip_indices(tmp_path: Path) -> None:
    content = mmpose([[one] for one in people(3, 5)], NAMES)
    content["meta_info"].pop("flip_pairs")
    data = read(write_json(tmp_path / "run.json", content))
    assert data.mirror == (("point 1", "point 2"), ("point 3", "point 4"))


def test_tracks_are_kept_and_nameless_bodies_linked(tmp_path: Path) -> None:
    still = people(2, 5, seed=4)
    frames = [[still[0], still[1]], [], [still[1], still[0]]]
    data = read(write_json(tmp_path / "a.json", mmpose(frames, NAMES)))
    assert data.identity["instance"].tolist() == ["0", "0", "1", "1"]
    same(data, still[[0, 0, 1, 1]])
    data = read(write_json(tmp_path / "a.json", mmpose(frames, NAMES, tracks=True)))
    assert data.identity["instance"].tolist() == ["7", "7", "8", "8"]
    same(data, still[[0, 1, 1, 0]])
    content = mmpose(frames, NAMES, tracks=True)
    content["instance_info"][0]["instances"][0]["track_id"] = -1
    data = read(write_json(tmp_path / "a.json", content))
    assert sorted(data.identity["instance"].tolist()) == ["7", "8", "8", "untracked 0"]
    content["instance_info"][0]["instances"][0]["track_id"] = 8
    data = read(write_json(tmp_path / "a.json", content))
    assert data.identity["instance"].tolist() == ["0", "0", "1", "1"]
    assert any("occurs twice" in note for note in data.notes)


@pytest.mark.parametrize("names", [COCO_JOINTS, HALPE26, WHOLEBODY133, HAND21])
def test_names_by_number(tmp_path: Path, names: tuple[str, ...]) -> None:
    values = people(3, len(names))
    content = [mmpose_instance(one) for one in values]
    path = write_json(tmp_path / "photo.json", content)
    assert KEYPOINT_FORMATS.guess(path).name == "mmpose"
    data = read(path)
    same(data, values)
    assert data.joint_names == names
    assert data.identity["image"].tolist() == ["photo"] * 3
    assert data.identity["instance"].tolist() == ["0", "1", "2"]


def test_frames_as_objects_and_as_lists(tmp_path: Path) -> None:
    values = people(4, 17)
    instances = [[mmpose_instance(one)] for one in values]
    listed = write_json(tmp_path / "a.json", [[], *instances])
    objects = [{"frame_id": n, "instances": each} for n, each in enumerate(instances)]
    named = write_json(tmp_path / "b.json", objects)
    for path, start in ((listed, 1), (named, 0)):
        assert KEYPOINT_FORMATS.guess(path).name == "mmpose"
        data = read(path)
        same(data, values)
        assert data.identity["frame"].tolist() == [start + n for n in range(4)]


def test_a_folder_is_a_video_where_its_numbers_are_close(tmp_path: Path) -> None:
    values = people(12, 17)
    for n, one in enumerate(values):
        write_json(tmp_path / f"walk/{n}.json", [mmpose_instance(one)] if n else [])
        write_json(tmp_path / f"photos/{1000 * n}.json", [mmpose_instance(one)])
    assert KEYPOINT_FORMATS.guess(tmp_path / "walk").name == "mmpose"
    data = read(tmp_path / "walk")
    assert data.identity["frame"].tolist() == list(range(1, 12))
    assert set(data.identity["sequence"]) == {"walk"}
    same(data, values[1:])
    data = read(tmp_path / "photos")
    assert data.identity["image"].tolist() == [str(1000 * n) for n in range(12)]
    same(data, values)


def test_without_scores_all_are_seen(tmp_path: Path) -> None:
    content = mmpose([[one] for one in people(2, 5)], NAMES)
    for frame in content["instance_info"]:
        frame["instances"][0].pop("keypoint_scores")
    assert (read(write_json(tmp_path / "a.json", content)).confidence == 1).all()


def test_wrong_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    good = mmpose([[one] for one in people(3, 5)], NAMES)

    def changed(**changes) -> str:
        content = mmpose([[one] for one in people(3, 5)], NAMES)
        content["instance_info"][1]["instances"][0].update(changes)
        return refused(path, content)

    assert "frame 1, instance 0: 'keypoints' has 8 numbers, but 10" in changed(keypoints=[[1, 2]] * 4)
    assert "'keypoints' has 15 numbers, but 10" in changed(keypoints=[[1, 2, 3]] * 5)
    assert "'keypoint_scores' has 4 numbers" in changed(keypoint_scores=[1] * 4)
    assert "track_id [3]" in changed(track_id=[3])
    assert "expected a list of [x, y]" in changed(keypoints=[1, 2] * 5)
    poses = [{"keypoints": [[1, 2, 3]] * 17, "keypoint_scores": [1] * 17}]
    assert "three coordinates" in refused(path, poses)
    assert "follows entries of another kind" in refused(path, [[], mmpose_instance(people(1, 5)[0])])
    assert "has no 'instance_info'" in refused(path, {"meta_info": {}})
    good["meta_info"]["keypoint_id2name"].pop("3")
    assert "names 4 keypoints, but instances have 5" in refused(path, good)
    good["meta_info"]["keypoint_id2name"]["7"] = "far"
    assert "expected 0 to n with names" in refused(path, good)
    good = mmpose([[one] for one in people(3, 5)], NAMES)
    good["instance_info"][0]["frame_id"] = -4
    assert "'frame_id' is -4" in refused(path, good)


def test_real_file(benchmark_data) -> None:
    path = benchmark_data("trackers/mmpose/test.json")
    assert KEYPOINT_FORMATS.guess(path).name == "mmpose"
    data = read(path)
    assert data.keypoints.shape == (1, 5, 2)
    np.testing.assert_allclose(data.keypoints[0, [0, 4]], [[2789.5673, 1124.1346], [1517.4519, 1221.4904]], rtol=1e-7)
    np.testing.assert_allclose(data.confidence[0, [0, 4]], [0.111427, 0.251419], atol=1e-6)
    assert data.joint_names == tuple(f"keypoint_{n}" for n in range(5))
