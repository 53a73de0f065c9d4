"""Ultralytics' labels, saved predictions and JSON results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tracker_files_json import people, ultralytics_list, ultralytics_row, write_json

from uplift.data.formats import KEYPOINT_FORMATS, read
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.layouts import COCO_JOINTS
from uplift.errors import UserError

BOTH = ((17, 3), (17, 2), (5, 3), (5, 2), (1, 3), (33, 3))


def shares(rows: int, joints: int, flags: bool = False) -> np.ndarray:
    """Return (rows, joints, 3) in shares of the image; scores, or flags of 0, 1 and 2."""
    rng = np.random.default_rng(joints)
    middle = rng.uniform(0.2, 0.8, (rows, 1, 2))
    found = np.concatenate(
        [middle + rng.uniform(-0.15, 0.15, (rows, joints, 2)), rng.uniform(0.05, 1, (rows, joints, 1))], -1
    )
    found = np.round(found, 4)
    found[rng.random((rows, joints)) < 0.1] = 0
    found[:, 0] = np.maximum(found[:, 0], 0.01)  # nobody without any
    if flags:
        found[..., 2] = np.where(found[..., 2] > 0, np.where(found[..., 2] > 0.5, 2, 1), 0)
        found[0, 0, 2] = 2
    return found


def write_labels(folder: Path, rows: list[list[str]], name: str = "img{}.txt") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, lines in enumerate(rows):
        (folder / name.format(number)).write_text("\n".join(lines) + "\n" if lines else "")
    return folder


def describe(path: Path, joints: int, size: int = 3, more: str = "") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"names: [person]\nnc: 1\nkpt_shape: [{joints}, {size}]\n{more}")


def refused(path: Path, **options) -> str:
    with pytest.raises(UserError) as error:
        read(path, ReadOptions(format="ultralytics", **options))
    return str(error.value)


def test_labels_come_back(tmp_path: Path) -> None:
    values = shares(12, 17, flags=True)
    folder = write_labels(tmp_path / "train/labels", [[ultralytics_row(one)] for one in values])
    describe(tmp_path / "data.yaml", 17, more=f"flip_idx: {[0, *(n - 1 + 2 * (n % 2) for n in range(1, 17))]}\n")
    (folder / "classes.txt").write_text("person\n")
    for path in (folder, tmp_path / "train"):
        assert KEYPOINT_FORMATS.guess(path).name == "ultralytics"
        data = read(path, ReadOptions(image_size=(800, 600)))
        np.testing.assert_allclose(data.keypoints, values[..., :2] * (800, 600), rtol=1e-6)
        np.testing.assert_array_equal(data.confidence, values[..., 2] / 2)
        assert data.joint_names == COCO_JOINTS
        assert data.identity["image"].tolist() == [f"img{n}" for n in range(12)]
        assert data.image_size == (800, 600)
        assert data.mirror[0] == ("left_eye", "right_eye")
        assert len(data.mirror) == 8
    np.testing.assert_array_equal(read(folder).keypoints, values[..., :2].astype(np.float32))
    assert any("shares of the image" in note for note in read(folder).notes)


@pytest.mark.parametrize(("joints", "size"), BOTH)
@pytest.mark.parametrize("extra", [(), (0.876,), (0.876, 4), (4,)])
def test_rows_divide_with_and_without_data_yaml(tmp_path: Path, joints: int, size: int, extra: tuple) -> None:
    values = shares(6, joints)[..., :size]
    if joints == 1 and extra:
        pytest.skip("one keypoint and what follows it look alike")
    folder = write_labels(tmp_path / "labels", [[ultralytics_row(one, *extra)] for one in values])
    for told in (False, True):
        if told:
            describe(tmp_path / "data.yaml", joints, size)
        data = read(folder)
        assert data.keypoints.shape == (6, joints, 2)
        np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32))
        expected = values[..., 2] if size == 3 else (values != 0).any(-1)
        np.testing.assert_array_equal(data.confidence, expected.astype(np.float32))
        assert any("no data.yaml" in note for note in data.notes) != told


def test_predictions_of_a_video_are_clips(tmp_path: Path) -> None:
    values = shares(12, 17)
    rows = [[ultralytics_row(one, 0.9, 1), ultralytics_row(one, 0.8, 2)] for one in values]
    rows[3] = [ultralytics_row(values[3], 0.9, 1), ultralytics_row(values[3], 0.8)]
    data = read(write_labels(tmp_path / "labels", rows, "walk_{}.txt"))
    assert set(data.identity) == {"sequence", "frame", "instance"}
    assert data.identity["instance"].tolist() == ["1"] * 12 + ["2"] * 11 + ["untracked 0"]
    assert data.identity["frame"].tolist()[:12] == list(range(12))
    assert set(data.identity["sequence"]) == {"walk"}
    (tmp_path / "labels/walk_3.txt").write_text("")
    assert read(tmp_path / "labels").follows().sum() == 18


def test_weak_keypoints_of_predictions_are_missing(tmp_path: Path) -> None:
    values = shares(2, 17)
    values[0, 3] = (0, 0, 0.31)
    data = read(write_labels(tmp_path / "labels", [[ultralytics_row(one)] for one in values], "{}.txt"))
    assert data.confidence[0, 3] == 0


def test_sizes_come_from_the_pictures(tmp_path: Path) -> None:
    values = shares(3, 17, flags=True)
    folder = write_labels(tmp_path / "labels/train", [[ultralytics_row(one)] for one in values])
    pictures = tmp_path / "images/train"
    pictures.mkdir(parents=True)
    for number, size in enumerate(((640, 480), (320, 240))):
        Image.new("L", size).save(pictures / f"img{number}.jpg")
    assert "img2.txt has no picture" in refused(folder)
    Image.new("L", (100, 50)).save(pictures / "img2.png")
    data = read(folder)
    sizes = np.array([(640, 480), (320, 240), (100, 50)])
    np.testing.assert_allclose(data.keypoints, values[..., :2] * sizes[:, None], rtol=1e-6)
    assert data.identity["image"].tolist() == ["img0.jpg", "img1.jpg", "img2.png"]
    assert data.image_size is None
    (pictures / "img1.jpg").write_bytes(b"no picture")
    assert "img1.jpg cannot be read as a picture" in refused(folder)
    for number in (1, 2):
        (pictures / f"img{number}.jpg").unlink(missing_ok=True)
    (pictures / "img2.png").unlink()
    data = read(folder)
    assert data.image_size == (640, 480)
    assert any("2 labels have no picture" in note for note in data.notes)


def test_names_and_classes_of_data_yaml(tmp_path: Path) -> None:
    values = shares(4, 5, flags=True)
    rows = [[ultralytics_row(one, kind=number % 2)] for number, one in enumerate(values)]
    folder = write_labels(tmp_path / "labels", rows)
    names = "[a, b, c, d, e]"
    (tmp_path / "set.yaml").write_text(f"names: {{0: cat, 1: dog}}\nkpt_shape: [5, 3]\nkpt_names: {{0: {names}}}\n")
    data = read(folder)
    assert data.joint_names == tuple("abcde")
    assert data.identity["category"].tolist() == ["cat", "dog", "cat", "dog"]
    (tmp_path / "set.yaml").write_text("names: [cat]\nkpt_shape: [5, 3]\nkpt_names: [a, b]\n")
    assert "kpt_names are 2" in refused(folder)
    (tmp_path / "set.yaml").unlink()
    assert read(folder).identity["category"].tolist() == ["0", "1", "0", "1"]
    assert read(folder).joint_names[4] == "keypoint_4"


@pytest.mark.parametrize(
    ("labels", "said"),
    [
        ("labels/{}", {"path": "../datasets/mine", "train": "images/train", "val": "images/val"}),
        ("labels/{}", {"path": "/content/datasets/mine", "train": "train.txt", "val": "val.txt"}),
        ("{}/labels", {"train": "../train/images", "val": "../val/images"}),
        ("{}", {"path": "mine", "train": "train", "val": ["val"]}),
        ("labels/{}", {}),
    ],
    ids=["images beside labels", "lists of pictures", "Roboflow", "pictures beside labels", "no splits named"],
)
def test_the_root_of_a_data_set_is_its_training_split(tmp_path: Path, labels: str, said: dict) -> None:
    values, root = shares(6, 5, flags=True), tmp_path / "mine"
    values[:, 1, 2] = 2
    for split, rows in (("train", values[:4]), ("val", values[4:])):
        folder = write_labels(root / labels.format(split), [[ultralytics_row(one)] for one in rows])
        pictures = Path(str(folder).replace("labels", "images"))
        pictures.mkdir(parents=True, exist_ok=True)
        names = [f"./{pictures.relative_to(root)}/img{number}.jpg" for number in range(len(rows))]
        for name in names:
            Image.new("L", (640, 480)).save(root / name)
        (root / f"{split}.txt").write_text("\n".join(names))
    if labels != "labels/{}" or said.get("train") != "train.txt":
        (root / "train.txt").unlink(), (root / "val.txt").unlink()
    more = "".join(f"{key}: {value}\n" for key, value in said.items())
    describe(root / "data.yaml", 5, more=f"{more}test:\nflip_idx: [0, 2, 1, 3, 4]\n")
    for path in (root, root / "data.yaml") if said else (root,):
        assert KEYPOINT_FORMATS.guess(path).name == "ultralytics"
        data = read(path)
        np.testing.assert_allclose(data.keypoints, values[:4, :, :2] * (640, 480), rtol=1e-6)
        assert data.identity["image"].tolist() == [f"img{number}.jpg" for number in range(4)]
        assert data.mirror == (("keypoint_1", "keypoint_2"),)
        where = f"the split 'train' of data.yaml; not read: val ({root / labels.format('val')})"
        assert (where in data.notes) == bool(said)


def test_a_data_set_does_not_reach_out_of_its_folder(tmp_path: Path) -> None:
    write_labels(tmp_path / "other/labels", [[ultralytics_row(one)] for one in shares(3, 5)])
    for said in ("train: ../other/images", f"path: {tmp_path}\ntrain: other/images", f"train: {tmp_path}/other/labels"):
        describe(tmp_path / "mine/data.yaml", 5, more=f"{said}\n")
        assert "no labels are where it says" in refused(tmp_path / "mine/data.yaml")
    (tmp_path / "mine/labels").symlink_to(tmp_path / "other/labels")
    (tmp_path / "mine/list.txt").write_text(
        f"images/img0.jpg\n{tmp_path}/other/images/img0.jpg\n../other/images/img0.jpg\n"
    )
    describe(tmp_path / "mine/data.yaml", 5, more="train: list.txt\n")
    assert "no labels are where it says" in refused(tmp_path / "mine/data.yaml")


def test_one_file(tmp_path: Path) -> None:
    values = shares(3, 17, flags=True)
    path = write_labels(tmp_path, [[ultralytics_row(one) for one in values]]) / "img0.txt"
    assert KEYPOINT_FORMATS.guess(path).name == "ultralytics"
    data = read(path)
    assert data.identity["image"].tolist() == ["img0"] * 3
    assert data.identity["instance"].tolist() == ["0", "1", "2"]


def test_other_files_are_refused(tmp_path: Path) -> None:
    folder = write_labels(tmp_path / "labels", [[ultralytics_row(one)] for one in shares(3, 17)])
    describe(tmp_path / "data.yaml", 17)
    with pytest.raises(UserError, match="describes a data set, and no labels are where it says.*labels"):
        read(tmp_path / "data.yaml")
    describe(tmp_path / "data.yaml", 12)
    assert "rows have 56 numbers, but" in refused(folder)
    describe(tmp_path / "data.yaml", 17, size=5)
    assert "kpt_shape is [17, 5]" in refused(folder)
    (tmp_path / "data.yaml").unlink()

    def second(text: str) -> str:
        (folder / "img1.txt").write_text(text)
        return refused(folder)

    assert "img1.txt, line 2: 'hello there' are not numbers" in second(
        ultralytics_row(shares(1, 17)[0]) + "\nhello there"
    )
    assert "img1.txt, line 1 has 41 numbers, other rows 56" in second(ultralytics_row(shares(1, 12)[0]))
    assert "no keypoints after class and box" in second("0 0.5 0.5 0.1 0.1")
    assert "img1.txt, line 1 begins [1.5" in second("1.5" + ultralytics_row(shares(1, 17)[0])[1:])
    assert "img1.txt, line 1 begins [0.0, nan" in second("0 nan" + ultralytics_row(shares(1, 17)[0])[9:])
    (folder / "img1.txt").write_bytes(b"\xff\xfe")
    assert "img1.txt cannot be read as text" in refused(folder)
    for one in folder.iterdir():
        one.write_text("\n")
    assert "all 3 label files are empty" in refused(folder)
    (tmp_path / "none").mkdir()
    assert "has no *.txt" in refused(tmp_path / "none")


def test_outlines_are_no_keypoints(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    rows = [[" ".join(map(str, [0, *np.round(rng.random(2 * 12), 4)]))] for _ in range(9)]
    assert "do not divide into keypoints" in refused(write_labels(tmp_path / "labels", rows))


def test_json_results_come_back(tmp_path: Path) -> None:
    values = people(3, 17)
    path = write_json(tmp_path / "photo.json", ultralytics_list(values))
    assert KEYPOINT_FORMATS.guess(path).name == "ultralytics_json"
    data = read(path)
    np.testing.assert_array_equal(data.keypoints, values[..., :2].astype(np.float32))
    np.testing.assert_array_equal(data.confidence, values[..., 2].astype(np.float32))
    assert data.joint_names == COCO_JOINTS
    assert data.identity["image"].tolist() == ["photo"] * 3
    video = write_json(tmp_path / "walk.json", [ultralytics_list(values, tracks=True) for _ in range(4)])
    assert KEYPOINT_FORMATS.guess(video).name == "ultralytics_json"
    data = read(video)
    assert data.identity["instance"].tolist() == ["1"] * 4 + ["2"] * 4 + ["3"] * 4
    assert data.identity["frame"].tolist() == [0, 1, 2, 3] * 3
    for number in range(5):
        write_json(tmp_path / f"frames/{number}.json", ultralytics_list(values[:1]) if number else [])
    assert KEYPOINT_FORMATS.guess(tmp_path / "frames").name == "ultralytics_json"
    assert read(tmp_path / "frames").identity["frame"].tolist() == [1, 2, 3, 4]


def test_json_results_in_shares(tmp_path: Path) -> None:
    values = shares(2, 17)
    path = write_json(tmp_path / "photo.json", ultralytics_list(values))
    data = read(path, ReadOptions(image_size=(640, 480)))
    np.testing.assert_allclose(data.keypoints, values[..., :2] * (640, 480), rtol=1e-6)
    assert any("shares of the image" in note for note in read(path).notes)


def test_wrong_json_results_are_refused(tmp_path: Path) -> None:
    def changed(**changes) -> str:
        content = ultralytics_list(people(3, 17))
        content[1].update(changes)
        write_json(tmp_path / "a.json", content)
        with pytest.raises(UserError) as error:
            read(tmp_path / "a.json", ReadOptions(format="ultralytics_json"))
        return str(error.value)

    assert "entry 1 is" in changed(keypoints=None)
    assert "entry 1: 'x' has 3 numbers, but 17" in changed(keypoints={"x": [1] * 3, "y": [1] * 3})
    assert "entry 1: 'y' is None" in changed(keypoints={"x": [1] * 17})
    assert "track_id [1]" in changed(track_id=[1])


def test_real_labels(benchmark_data) -> None:
    folder = benchmark_data("trackers/ultralytics/labels")
    assert KEYPOINT_FORMATS.guess(folder).name == "ultralytics"
    data = read(folder, ReadOptions(image_size=(640, 640)))
    assert data.keypoints.shape == (24, 17, 2)
    first = data.identity["image"] == "1_13_14_mp4-0003_jpg.rf.32646e00c9169450f3d746084bc537b5"
    expected = 640 * np.array([0.41423921874999997, 0.5701388888888889])
    np.testing.assert_allclose(data.keypoints[first][0, 0], expected, rtol=1e-6)
    assert data.confidence[first][0, 0] == 0.5
    last = np.flatnonzero(data.identity["image"] == "1_13_14_mp4-0113_jpg.rf.f5db8a73e671c2cd2a792273f27dd102")[-1]
    np.testing.assert_allclose(data.keypoints[last, 16], 640 * np.array([0.44140625, 0.7972419444444443]), rtol=1e-6)
    assert data.confidence[last, 16] == 1
    assert data.mirror == ()  # flip_idx swaps nothing
    np.testing.assert_allclose(read(folder).keypoints * 640, data.keypoints, rtol=1e-6)
    with pytest.raises(UserError, match="ultralytics/labels"):
        read(benchmark_data("trackers/ultralytics/data.yaml"))
