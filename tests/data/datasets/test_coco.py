"""COCO's keypoint annotations become frames to train on, and nothing else passes for them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from uplift.config.loading import load_settings
from uplift.data.datasets.coco import Coco
from uplift.data.formats.layouts import COCO_JOINTS
from uplift.data.load import in_joints_of, load_data
from uplift.data.parsers.json import JsonText, objects, records
from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

SKELETON = load_skeleton("coco17")
NAME = "person_keypoints_val2017.json"
PERSON = {"supercategory": "person", "id": 1, "name": "person", "keypoints": list(COCO_JOINTS), "skeleton": [[16, 14]]}


@pytest.fixture(scope="module")
def flat() -> np.ndarray:
    """Six people, (people 17 3): x, y, v."""
    data = simulate(SKELETON, 6, seed=1)
    seen = np.round(data.keypoints[:, [SKELETON.index(joint) for joint in COCO_JOINTS]], 2)
    return np.concatenate([seen, np.full((6, 17, 1), 2.0)], -1)


def annotations(flat: np.ndarray) -> dict:
    """Return a file as published: images, annotations, and the categories behind them."""
    people = [
        {
            "segmentation": [[1.5, 2.5, 3.5, 4.5, 5.5, 6.5]],
            "num_keypoints": int((person[:, 2] > 0).sum()),
            "area": 10.5,
            "iscrowd": 0,
            "keypoints": person.ravel().tolist(),
            "image_id": 785 + number // 2,
            "bbox": [1.0, 2.0, 3.0, 4.0],
            "category_id": 1,
            "id": 442619 + number,
        }
        for number, person in enumerate(flat)
    ]
    images = [{"file_name": f"{785 + n:012d}.jpg", "height": 425, "width": 640, "id": 785 + n} for n in range(3)]
    return {
        "info": {"year": 2017},
        "licenses": [{"id": 1}],
        "images": images,
        "annotations": people,
        "categories": [PERSON],
    }


def write(folder: Path, content, name: str = NAME) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return folder


def test_everyone_annotated_is_read(tmp_path: Path, flat: np.ndarray) -> None:
    data = Coco(write(tmp_path, annotations(flat), f"annotations/{NAME}")).read("val")
    np.testing.assert_allclose(data.keypoints, flat[..., :2], atol=1e-3)
    assert data.joint_names == COCO_JOINTS
    assert data.identity["image"].tolist() == [f"{n:012d}.jpg" for n in (785, 785, 786, 786, 787, 787)]
    assert data.identity["instance"].tolist() == list(range(442619, 442625))
    assert len(set(data.clips())) == 6
    built = in_joints_of(data, SKELETON)
    np.testing.assert_allclose(
        built.keypoints[:, SKELETON.index("pelvis")],
        flat[:, [COCO_JOINTS.index("left_hip"), COCO_JOINTS.index("right_hip")], :2].mean(1),
        atol=1e-3,
    )


def test_visibility_becomes_confidence(tmp_path: Path, flat: np.ndarray) -> None:
    changed = flat.copy()
    changed[0, 9] = 0
    changed[0, 10, 2] = 1
    write(tmp_path, annotations(changed))
    for occluded in (0.5, 0.0, 1.0):
        data = Coco(tmp_path, occluded=occluded).read("val")
        assert data.confidence[0, [8, 9, 10]].tolist() == [1, 0, occluded]
        assert data.keypoints[0, 9].tolist() == [0, 0]
        assert (data.confidence[1:] == 1).all()


def test_crowds_and_people_with_few_keypoints_are_left_out(tmp_path: Path, flat: np.ndarray) -> None:
    changed = flat.copy()
    changed[0] = 0
    changed[1, :10] = 0  # 7 keypoints
    changed[2, 11] = 0  # no left hip
    content = annotations(changed)
    content["annotations"][3]["iscrowd"] = 1
    content["annotations"][3]["segmentation"] = {"counts": [1, 2], "size": [425, 640]}
    write(tmp_path, content)
    kept = Coco(tmp_path).read("val").identity["instance"] - 442619
    assert kept.tolist() == [4, 5]
    kept = Coco(tmp_path, torso=False).read("val").identity["instance"] - 442619
    assert kept.tolist() == [2, 4, 5]
    kept = Coco(tmp_path, torso=False, min_keypoints=1).read("val").identity["instance"] - 442619
    assert kept.tolist() == [1, 2, 4, 5]


def test_other_categories_are_left_out(tmp_path: Path, flat: np.ndarray) -> None:
    content = annotations(flat)
    content["annotations"][0].update(category_id=7, keypoints=[1, 2, 2] * 30)
    content["annotations"][1].update(category_id=8)
    content["categories"] += [{"id": 7, "name": "fly", "keypoints": []}, {"id": 8, "name": "ape"}]
    assert len(Coco(write(tmp_path, content)).read("val")) == 4


def refused(folder: Path, content=None, **options) -> str:
    if content is not None:
        write(folder, content)
    with pytest.raises(UserError) as error:
        Coco(folder, **options).read("val")
    return str(error.value)


def test_other_files_are_refused(tmp_path: Path, flat: np.ndarray) -> None:
    results = [{"image_id": 785, "category_id": 1, "keypoints": flat[0].ravel().tolist(), "score": 0.9}]
    assert "results of a detector" in refused(tmp_path, results)
    content = annotations(flat)
    assert "no category 'person' in it (found: cow)" in refused(
        tmp_path, {**content, "categories": [{"id": 1, "name": "cow"}]}
    )
    other = {**PERSON, "keypoints": ["nose", *COCO_JOINTS[:16]]}
    assert "the keypoints of 'person' are nose, nose" in refused(tmp_path, {**content, "categories": [other]})
    instances = {
        **content,
        "annotations": [{"segmentation": [], "iscrowd": 0, "image_id": 785, "category_id": 1, "id": 3}],
    }
    assert "annotation 3 has no 'keypoints': these are instances" in refused(tmp_path, instances)
    assert "no annotations, categories in it" in refused(tmp_path, {"images": []})
    assert "is not a complete JSON file" in refused(tmp_path, "hello")
    assert "is empty" in refused(tmp_path, "  \n")


def test_wrong_annotations_are_refused(tmp_path: Path, flat: np.ndarray) -> None:
    def changed(**changes) -> str:
        content = annotations(flat)
        content["annotations"][2].update(changes)
        return refused(tmp_path, content)

    assert "annotation 442621 has 48 numbers in 'keypoints', expected 51" in changed(keypoints=[1, 2, 2] * 16)
    assert "visibilities other than 0, 1, 2" in changed(keypoints=[1, 2, 0.7] * 17)
    assert "visibilities other than 0, 1, 2" in changed(keypoints=[float("nan"), 2, 2] * 17)
    assert "is damaged" in changed(keypoints=["a", 2, 2] * 17)
    assert "is damaged" in changed(image_id=None)
    assert "name image 999, which is not among its images" in changed(image_id=999)
    content = annotations(flat * [1, 1, 0.5])
    assert "of a person with 17 keypoints" in refused(
        tmp_path, {**content, "annotations": content["annotations"][:0]}, min_keypoints=17
    )
    assert "entry 1 of 'annotations'" in refused(tmp_path, {**content, "annotations": [{"iscrowd": 1}, 5]})
    assert "'images' is not a list" in refused(tmp_path, {**content, "images": {"a": 1}})
    assert "an image has id None" in refused(tmp_path, {**content, "images": [{"file_name": "a.jpg"}]})


def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path: Path, flat: np.ndarray) -> None:
    text = json.dumps(annotations(flat))
    for end in [*range(1, len(text) - 1, 97), len(text) - 1]:
        message = refused(tmp_path, text[:end])
        assert NAME in message
        assert "damaged" in message
    (tmp_path / NAME).write_bytes(b"\xff\xff{}")
    assert "cannot be read as JSON" in refused(tmp_path)


def test_records_are_those_of_json(tmp_path: Path, flat: np.ndarray) -> None:
    content = {"a": [], "skipped": {"deep": [[{}]]}, "annotations": annotations(flat)["annotations"], "b": [{"x": [1]}]}
    for indent in (None, 2):
        path = tmp_path / "x.json"
        path.write_text("\ufeff" + json.dumps(content, indent=indent), encoding="utf-8")
        found = list(records(path, ("a", "annotations", "b")))
        assert found == [("annotations", each) for each in content["annotations"]] + [("b", {"x": [1]})]
    path.write_text("[{}, {}] ")
    assert list(objects(JsonText(path), "x")) == [{}, {}]


def test_options_and_missing_files(tmp_path: Path, here: Path) -> None:
    assert Coco(tmp_path, year=2014).missing("train")[0].path.name == "person_keypoints_train2014.json"
    for options, said in (({"occluded": 1.5}, "occluded=1.5"), ({"min_keypoints": 0}, "expected 1 to 17")):
        with pytest.raises(UserError, match=said):
            Coco(tmp_path, **options)
    with pytest.raises(UserError) as error:
        load_data(load_settings("coco"), SKELETON)
    for part in ("person_keypoints_train2017.json", "cocodataset.org", str(here / "data/coco")):
        assert part in str(error.value)


def test_the_task_loads_it(here: Path, flat: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UPLIFT_CACHE", str(here / "cache"))
    write(here / "data/coco", annotations(flat), "person_keypoints_train2017.json")
    for _ in range(2):  # from the file, and from the cache
        found = load_data(load_settings("coco"), SKELETON)
        assert len(found.train) == 6
        assert found.test is None
        assert (found.train.confidence == 1).all()


def test_real_files(benchmark_data, tmp_path: Path) -> None:
    folder = benchmark_data("trackers/coco/test_coco.json").parent
    write(tmp_path, (folder / "test_coco.json").read_text())
    data = Coco(tmp_path, min_keypoints=1, torso=False).read("val")
    assert len(data) == 12  # two of the 14 have no keypoint
    first = np.flatnonzero(data.identity["instance"] == 442619)[0]
    assert data.keypoints[first, 0].tolist() == [367, 81]
    assert data.identity["image"][first] == "000000000785.jpg"
    for name, said in (
        ("test_fly.json", "found: fly"),
        ("person_keypoints_val2014_fakekeypoints100_results.json", "results of a detector"),
        ("../ap10k/test_ap10k.json", "no category 'person'"),
        ("../mpii/test_mpii.json", "is a list"),
    ):
        assert said in refused(tmp_path, (folder / name).read_text())
