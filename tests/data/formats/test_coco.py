"""COCO annotations of any category, and lists of results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tracker_files_json import coco_annotations, coco_results, people, write_json

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.layouts import COCO_JOINTS, HALPE26, WHOLEBODY133
from uplift.data.poses import PoseData
from uplift.errors import UserError


@pytest.fixture
def flat() -> np.ndarray:
    """Return seven people, (7, 17, 3): x, y, v of all three kinds."""
    found = people(7, 17, seed=3)
    found[..., 2] = np.random.default_rng(1).integers(0, 3, (7, 17))
    found[:, 0, 2] = 2
    return found


def read_back(path: Path, content: Any, options: ReadOptions | None = None, format: str = "coco") -> PoseData:
    write_json(path, content)
    assert KEYPOINT_FORMATS.guess(path).name == format
    return read(path, options)


def refused(path: Path, content: Any, format: str = "coco", **options: Any) -> str:
    write_json(path, content)
    with pytest.raises(UserError) as error:
        read(path, ReadOptions(format=format, **options))
    assert str(path) in str(error.value)
    return str(error.value)


def test_annotations_come_back(tmp_path: Path, flat: np.ndarray) -> None:
    data = read_back(tmp_path / "a.json", coco_annotations(flat))
    np.testing.assert_array_equal(data.keypoints, flat[..., :2].astype(np.float32))
    np.testing.assert_array_equal(data.confidence, flat[..., 2].astype(np.float32) / 2)
    assert data.joint_names == COCO_JOINTS
    assert data.identity["image"].tolist() == [f"{1 + n // 2:012d}.jpg" for n in range(7)]
    assert data.identity["instance"].tolist() == [str(100 + n) for n in range(7)]
    assert "category" not in data.identity
    assert "frame" not in data.identity
    assert data.image_size == (640, 480)
    assert data.bones == (("nose", "left_eye"), ("left_eye", "right_eye"))
    assert len(set(data.clips())) == 7


def test_keys_in_any_order_and_images_after_annotations(tmp_path: Path, flat: np.ndarray) -> None:
    content = coco_annotations(flat)
    for order in (sorted(content), sorted(content, reverse=True)):
        data = read_back(tmp_path / "a.json", {key: content[key] for key in order})
        np.testing.assert_array_equal(data.keypoints, flat[..., :2].astype(np.float32))


def test_crowds_and_people_without_keypoints_give_no_row(tmp_path: Path, flat: np.ndarray) -> None:
    content = coco_annotations(flat)
    content["annotations"][0]["iscrowd"] = 1
    content["annotations"][1]["keypoints"] = [0] * 51
    content["annotations"][2].pop("keypoints")
    assert read_back(tmp_path / "a.json", content).identity["instance"].tolist() == ["103", "104", "105", "106"]


def test_flags_of_zero_and_one_alone_mean_visible(tmp_path: Path, flat: np.ndarray) -> None:
    flat[..., 2] = np.minimum(flat[..., 2], 1)
    data = read_back(tmp_path / "a.json", coco_annotations(flat))
    np.testing.assert_array_equal(data.confidence, flat[..., 2])
    assert any("1 is taken as visible" in note for note in data.notes)


def test_any_joints_of_any_category(tmp_path: Path, flat: np.ndarray) -> None:
    names = ("head", "eyeL", "tip")
    content = coco_annotations(flat[:, :3], names, "fly")
    content["categories"].append({"id": 9, "name": "wasp", "keypoints": list(names), "skeleton": []})
    content["annotations"][4]["category_id"] = 9
    data = read_back(tmp_path / "a.json", content)
    assert data.joint_names == names
    assert data.identity["category"].tolist() == ["fly"] * 4 + ["wasp"] + ["fly"] * 2


def test_categories_without_keypoints_do_not_count(tmp_path: Path, flat: np.ndarray) -> None:
    content = coco_annotations(flat)
    content["categories"].insert(0, {"id": 0, "name": "people", "supercategory": "none"})
    assert "category" not in read_back(tmp_path / "a.json", content).identity


def test_the_layout_with_most_annotations_is_read(tmp_path: Path, flat: np.ndarray) -> None:
    content, other = coco_annotations(flat), coco_annotations(flat[:2, :5], tuple("abcde"), "chair", start=50)
    for key in ("images", "annotations", "categories"):
        content[key] = other[key] + content[key]
    data = read_back(tmp_path / "a.json", content)
    assert data.joint_names == COCO_JOINTS
    assert len(data) == 7
    assert any("2 layouts" in note and "left out the 2" in note for note in data.notes)
    assert data.bones[0] == ("nose", "left_eye")


def test_whole_bodies(tmp_path: Path) -> None:
    whole = people(3, 133, seed=5)
    whole[..., 2] = 2
    content = coco_annotations(whole[:, :17])
    spans = {"foot_kpts": (17, 23), "face_kpts": (23, 91), "lefthand_kpts": (91, 112), "righthand_kpts": (112, 133)}
    for row, record in enumerate(content["annotations"]):
        for key, (start, end) in spans.items():
            record[key] = whole[row, start:end].ravel().tolist()
    data = read_back(tmp_path / "a.json", content)
    assert data.joint_names == WHOLEBODY133
    np.testing.assert_array_equal(data.keypoints, whole[..., :2].astype(np.float32))
    content["annotations"][1]["face_kpts"] = [1, 2]
    assert "annotation 101" in refused(tmp_path / "b.json", content)


def test_videos_have_frames_and_tracks(tmp_path: Path, flat: np.ndarray) -> None:
    content = coco_annotations(flat)
    for n, image in enumerate(content["images"]):
        image.update(vid_id="000342", frame_id=10003420000 + n)
    for n, record in enumerate(content["annotations"]):
        record["track_id"] = n % 2
    data = read_back(tmp_path / "a.json", content)
    assert set(data.identity) == {"sequence", "frame", "instance"}
    assert data.identity["instance"].tolist() == ["0"] * 4 + ["1"] * 3
    assert data.identity["frame"].tolist() == [10003420000 + n for n in (0, 1, 2, 3, 0, 1, 2)]
    assert data.follows().sum() == 5
    content["videos"] = [{"id": "000342", "name": "jump.mp4"}]
    assert set(read_back(tmp_path / "a.json", content).identity["sequence"]) == {"jump.mp4"}
    content["images"][0]["frame_id"] = -1
    assert "'frame_id' is -1" in refused(tmp_path / "b.json", content)


def test_layout_names_the_keypoints(tmp_path: Path, flat: np.ndarray) -> None:
    content = coco_annotations(flat)
    content["categories"] = []
    assert read_back(tmp_path / "a.json", content).joint_names == COCO_JOINTS
    content = coco_annotations(flat[:, :16], tuple("abcdefghijklmnop"))
    data = read_back(tmp_path / "a.json", content, ReadOptions(layout="mpii16"))
    assert data.joint_names[0] == "rankle"
    assert "layout=rat23 has 23" in refused(tmp_path / "a.json", content, layout="rat23")
    content["categories"] = []
    data = read_back(tmp_path / "a.json", content)
    assert data.joint_names[15] == "keypoint_15"
    assert any("layout=" in note for note in data.notes)


def test_wrong_annotations_are_refused(tmp_path: Path, flat: np.ndarray) -> None:
    def changed(**changes: Any) -> str:
        content = coco_annotations(flat)
        content["annotations"][2].update(changes)
        return refused(tmp_path / "a.json", content)

    assert "annotation 102 has 50 numbers" in changed(keypoints=[1] * 50)
    assert "has 16 keypoints, but its category 'person' names 17" in refused(
        tmp_path / "a.json", coco_annotations(flat[:, :16])
    )
    assert "annotation 102: 'keypoints' is" in changed(keypoints=["x"] * 51)
    assert "annotation 102: 'keypoints' is" in changed(keypoints=[[1, 2], [3]])
    assert "more digits than a pixel" in changed(keypoints=[10**400] * 51)
    assert "has image_id None" in changed(image_id=None)
    assert "image 999, which is not among its 4 images" in changed(image_id=999)
    content = coco_annotations(flat)
    content["categories"][0]["keypoints"][3] = "nose"
    assert "names 'nose' twice" in refused(tmp_path / "a.json", content)
    content["categories"][0]["keypoints"][3] = 5
    assert "expected a list of names" in refused(tmp_path / "a.json", content)
    for key, said in (("caption", "these are captions"), ("segmentation", "outlines")):
        content = coco_annotations(flat)
        content["annotations"] = [{"id": 1, "image_id": 1, key: []}]
        assert said in refused(tmp_path / "a.json", content)
    assert "no visible keypoint" in refused(tmp_path / "a.json", coco_annotations(flat * [1, 1, 0]))
    (tmp_path / "b.json").write_text(json.dumps(coco_annotations(flat)) + "{}")
    with pytest.raises(UserError, match="more follows"):
        read(tmp_path / "b.json")


def test_results_come_back(tmp_path: Path) -> None:
    for joints, names in ((17, COCO_JOINTS), (26, HALPE26), (133, WHOLEBODY133)):
        flat = people(5, joints)
        data = read_back(tmp_path / "a.json", coco_results(flat), format="coco_results")
        np.testing.assert_array_equal(data.keypoints, flat[..., :2].astype(np.float32))
        np.testing.assert_array_equal(data.confidence, flat[..., 2].astype(np.float32))
        assert data.joint_names == names
        assert data.identity["image"].tolist() == ["139", "139", "140", "140", "141"]
        assert data.identity["instance"].tolist() == ["0", "1", "2", "3", "4"]
    flat[:, :, 2] = 1.03
    assert (read_back(tmp_path / "a.json", coco_results(flat), format="coco_results").confidence == 1).all()


def test_wrong_results_are_refused(tmp_path: Path) -> None:
    content = coco_results(people(5, 17))
    content[3]["keypoints"].pop()
    said = refused(tmp_path / "a.json", content, "coco_results")
    assert "entry 3: 'keypoints' has 50 numbers, but 51 in" in said
    content[3] = {"image_id": [1], "keypoints": []}
    assert "entry 3 has image_id [1]" in refused(tmp_path / "a.json", content, "coco_results")
    assert "is an empty list" in refused(tmp_path / "a.json", [], "coco_results")
    assert "is not a list" in refused(tmp_path / "a.json", {"image_id": 1}, "coco_results")


def test_real_files(benchmark_data) -> None:
    data = read(benchmark_data("trackers/coco/test_coco.json"))
    assert len(data) == 12
    for number, image, joint in (("442619", "000000000785.jpg", (367, 81)), ("543117", "000000197388.jpg", (36, 79))):
        row = np.flatnonzero(data.identity["instance"] == number)[0]
        assert data.identity["image"][row] == image
        assert tuple(data.keypoints[row, data.joint_names.index("nose")]) == joint
        assert data.confidence[row, data.joint_names.index("nose")] == 1
    assert data.image_size is None


def test_real_animals(benchmark_data) -> None:
    data = read(benchmark_data("trackers/coco/test_fly.json"))
    assert (len(data), len(data.joint_names), data.image_size) == (2, 32, (192, 192))
    head = data.keypoints[:, data.joint_names.index("head")]
    np.testing.assert_allclose(head, [[146, 95], [147.43, 96.9496]], atol=1e-3)
    assert data.identity["instance"].tolist() == ["1400", "1450"]
    data = read(benchmark_data("trackers/ap10k/test_ap10k.json"))
    assert data.identity["category"].tolist() == ["jaguar", "antelope"]
    eye = data.keypoints[:, data.joint_names.index("left_eye")]
    np.testing.assert_array_equal(eye, np.float32([[134, 415], [488, 443]]))
    assert data.identity["instance"].tolist() == ["9284", "6"]
    assert ("root_of_tail", "left_hip") in data.bones


def test_real_results(benchmark_data) -> None:
    path = benchmark_data("trackers/coco/person_keypoints_val2014_fakekeypoints100_results.json")
    data = read(path)
    assert KEYPOINT_FORMATS.guess(path).name == "coco_results"
    assert (len(data), len(set(data.identity["image"]))) == (125, 47)
    assert data.identity["image"][[0, -1]].tolist() == ["136", "1292"]
    np.testing.assert_array_equal(data.keypoints[0, 0], np.float32([36, 181]))
    np.testing.assert_array_equal(data.keypoints[124, 5], np.float32([8, 288]))
    assert data.confidence[0, 0] == 1
    assert data.confidence[124, 5] == 0
