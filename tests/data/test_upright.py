"""Files whose y grows upwards and films that were turned are told, and put upright."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lifts import seen_bodies

from uplift.cli.data_check import check_data
from uplift.cli.inputs import _with_turns
from uplift.cli.skeleton import map_joints
from uplift.config.loading import load_settings
from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.data.human import standing_human
from uplift.data.load import load_data, load_file
from uplift.data.poses import PoseData
from uplift.data.turned import turned
from uplift.data.upright import upright_notes
from uplift.errors import UserError
from uplift.geometry.lens import Lens
from uplift.skeleton import load_skeleton

COCO = load_skeleton("coco17")
WIDTH, HEIGHT = 640, 480
STANDING = {  # px, drawn by hand: a person who faces the camera
    "nose": (320, 60), "left_eye": (328, 50), "right_eye": (312, 50), "left_ear": (338, 55), "right_ear": (302, 55),
    "left_shoulder": (360, 110), "right_shoulder": (280, 110), "left_elbow": (380, 170), "right_elbow": (260, 170),
    "left_wrist": (390, 230), "right_wrist": (250, 230), "left_hip": (345, 230), "right_hip": (295, 230),
    "left_knee": (348, 320), "right_knee": (292, 320), "left_ankle": (350, 410), "right_ankle": (290, 410),
}  # fmt: skip
WAYS = {
    "": lambda x, y: (x, y),
    "flip_y": lambda x, y: (x, HEIGHT - y),
    "180": lambda x, y: (WIDTH - x, HEIGHT - y),
    "90": lambda x, y: (y, WIDTH - x),  # the camera was turned: the film shows the person a quarter turn too far back
    "270": lambda x, y: (HEIGHT - y, x),
}
"""What undoes it -> where a point of the upright image is in the file."""


def film(path: Path, undone_by: str = "", frames: int = 20) -> Path:
    names = list(STANDING)
    rows = ["frame," + ",".join(f"{name}_x,{name}_y,{name}_score" for name in names)]
    for frame in range(frames):
        points = [WAYS[undone_by](x + frame, y) for x, y in STANDING.values()]
        rows.append(f"{frame}," + ",".join(f"{x},{y},0.9" for x, y in points))
    path.write_text("\n".join(rows) + "\n")
    return path


def upright() -> np.ndarray:
    return np.array([[STANDING[joint] for joint in COCO.joints if joint in STANDING]], np.float32)


def options(undone_by: str, **more) -> ReadOptions:
    return ReadOptions(**({"rotate": int(undone_by)} if undone_by.isdigit() else {undone_by: True}), **more)


@pytest.mark.parametrize("way", [way for way in WAYS if way])
def test_what_undoes_it_gives_the_upright_image(tmp_path: Path, way: str) -> None:
    size = (HEIGHT, WIDTH) if way in ("90", "270") else (WIDTH, HEIGHT)
    found = load_file(film(tmp_path / "a.csv", way), COCO, options(way, image_size=size))
    shown = [place for place, joint in enumerate(COCO.joints) if joint in STANDING]
    np.testing.assert_allclose(found.keypoints[0, shown], upright()[0], atol=1e-3)
    assert found.image_size == (WIDTH, HEIGHT)
    assert not [note for note in found.notes if note.startswith("WARNING")]


def test_flip_x_counts_from_the_other_side(tmp_path: Path) -> None:
    found = read(film(tmp_path / "a.csv"), ReadOptions(flip_x=True, image_size=(WIDTH, HEIGHT)))
    assert found.keypoints[0, 0].tolist() == [WIDTH - 320, 60]
    assert "flip_x: x is 640 - x, y is y" in found.notes


@pytest.mark.parametrize(
    ("way", "says"),
    [
        ("flip_y", "in 20 of 20 frames the bodies are upside down, and coco17 stands upright: where y grows upwards in "
                   "the file add flip_y=true, where the film is upside down rotate=180"),
        ("180", "upside down"),
        ("90", "upper end to the left, and coco17 stands upright: where the film is turned add rotate=90"),
        ("270", "upper end to the right, and coco17 stands upright: where the film is turned add rotate=270"),
    ],
)  # fmt: skip
def test_bodies_that_do_not_stand_are_told_wherever_files_are_read(tmp_path: Path, way: str, says: str) -> None:
    path = film(tmp_path / "a.csv", way)
    lines = {
        "fit": load_data(load_settings(None, [f"data.train={path}"]), COCO).notes,
        "predict": load_file(path, COCO).notes,
        "map": map_joints([str(path), "skeleton=coco17"])[0],
        "check": check_data([f"data.train={path}", "skeleton=coco17"])[0],
    }
    for verb, told in lines.items():
        assert len([line for line in "\n".join(told).splitlines() if "WARNING" in line and says in line]) == 1, verb
    fixed = f"rotate={way}" if way.isdigit() else f"{way}=true"
    assert "WARNING" not in "\n".join(map_joints([str(path), "skeleton=coco17", fixed])[0])
    assert "WARNING" not in "\n".join(check_data([f"data.train={path}", "skeleton=coco17", f"data.{fixed}"])[0])


def test_bodies_that_stand_or_have_no_up_are_not_told(tmp_path: Path) -> None:
    assert not [note for note in load_file(film(tmp_path / "a.csv"), COCO).notes if "WARNING" in note]
    hands = load_skeleton("hand21")
    rows = "frame," + ",".join(f"{joint}_x,{joint}_y" for joint in hands.joints) + "\n"
    points = np.stack([np.arange(21) * 3.0, 500 - np.arange(21) * 5.0], 1).ravel()
    (tmp_path / "hand.csv").write_text(rows + "0," + ",".join(map(str, points)) + "\n")
    assert not [note for note in load_file(tmp_path / "hand.csv", hands).notes if "upright" in note]


def test_of_several_files_the_ones_that_are_turned_are_named(tmp_path: Path) -> None:
    film(tmp_path / "good.csv")
    film(tmp_path / "bad.csv", "flip_y")
    told = [note for note in load_file(tmp_path / "*.csv", COCO).notes if "WARNING" in note]
    assert len(told) == 1
    assert "20 of 20 frames of " in told[0]
    assert "bad.csv" in told[0]
    assert "good.csv" not in told[0]


def test_without_an_image_size_the_middle_of_the_keypoints_stays(tmp_path: Path) -> None:
    found = read(film(tmp_path / "a.csv", "flip_y", frames=1), ReadOptions(flip_y=True))
    x, y = WAYS["flip_y"](*np.array(list(STANDING.values())).T)
    middle = sorted(y)[8]
    np.testing.assert_allclose(found.keypoints[0], np.stack([x, 2 * middle - y], 1))
    assert found.image_size is None
    assert "the size of the image is not known" in found.notes[-1]
    assert "image_size=WIDTHxHEIGHT" in found.notes[-1]


# A picture with one bright pixel at the keypoint, turned by NumPy: the keypoint and its crop go along.


@pytest.mark.parametrize(("flip_x", "flip_y", "rotate"), [(0, 1, 0), (1, 0, 0), (0, 0, 90), (0, 0, 180), (0, 1, 270)])
def test_masks_and_keypoints_turn_as_the_picture_does(flip_x: int, flip_y: int, rotate: int) -> None:
    picture = np.zeros((30, 50), np.uint8)
    picture[7, 20] = 255
    data = PoseData(
        np.array([[[20.5, 7.5], [0, 0]]], np.float32), np.array([[1, 0]], np.float32), ("a", "b"),
        image_size=(50, 30), masks=picture[None, 2:18, 12:28], mask_box=np.array([[12, 2, 16]], np.float32),
    )  # fmt: skip
    found = turned(data, flip_x=bool(flip_x), flip_y=bool(flip_y), rotate=rotate)
    picture = picture[:, ::-1] if flip_x else picture
    picture = np.rot90(picture[::-1] if flip_y else picture, -rotate // 90)
    (row,), (column,) = np.nonzero(picture)
    assert found.keypoints.tolist() == [[[column + 0.5, row + 0.5], [0, 0]]]
    assert found.image_size == picture.shape[::-1]
    assert found.masks is not None
    assert found.mask_box is not None
    x, y, side = found.mask_box[0].astype(int)
    np.testing.assert_array_equal(found.masks[0], picture[y : y + side, x : x + side])


def test_a_lens_is_straightened_before_the_turn() -> None:
    points = np.array([[1.0, 0.5, 4.0], [-0.6, 0.2, 3.0]])
    seen = points[:, :2] / points[:, 2:] * (600, 610) + (310, 250)
    lens = Lens((600.0, 610.0), (310.0, 250.0), image_size=(WIDTH, HEIGHT))
    data = PoseData(
        seen[None].astype(np.float32), np.ones((1, 2), np.float32), ("a", "b"), image_size=(WIDTH, HEIGHT),
        lenses=(lens,), lens=np.zeros(1, np.int64),
    )  # fmt: skip
    rays = turned(data, rotate=90).rays()
    assert rays is not None
    np.testing.assert_allclose(rays[0], np.stack([-points[:, 1], points[:, 0]], 1) / points[:, 2:], atol=1e-6)


def test_frames_with_poses_stay_as_they_are() -> None:
    data = PoseData(
        np.ones((1, 2, 2), np.float32), np.ones((1, 2), np.float32), ("a", "b"), pose=np.ones((1, 2, 3), np.float32)
    )
    found = turned(data, rotate=90)
    assert found.keypoints.tolist() == data.keypoints.tolist()
    assert "rotate=90 is not done: the file has poses" in found.notes[0]


def test_predict_says_what_the_training_files_needed(tmp_path: Path) -> None:
    data = read(film(tmp_path / "a.csv", "flip_y"))
    trained = load_settings(None, ["data.flip_y=true", "data.rotate=90"]).data
    said = "the run was trained on files that flip_y=true rotate=90 put upright: add it where this input is like them"
    assert _with_turns(data, trained, ReadOptions()).notes[-1] == said
    assert _with_turns(data, trained, ReadOptions(flip_y=True, rotate=90)).notes == data.notes


def test_other_angles_are_refused() -> None:
    with pytest.raises(UserError, match="rotate=45: expected 0, 90, 180 or 270"):
        ReadOptions(rotate=45)


def test_without_an_image_size_the_turn_is_about_the_middle_of_what_is_visible():
    data = replace(seen_bodies(), pose=None, root=None, image_size=None, focal_px=None)
    hidden = data.confidence * (np.arange(17) > 3).astype(np.float32)
    points = data.keypoints.copy()
    points[:, :4] = -5000
    found = turned(replace(data, keypoints=points, confidence=hidden), rotate=180)
    middle = np.median(data.keypoints[:, 4:].reshape(-1, 2).astype(float), axis=0)
    np.testing.assert_allclose(found.keypoints[:, 4:], 2 * middle - data.keypoints[:, 4:], atol=1e-2)
    np.testing.assert_array_equal(found.keypoints[:, :4], -5000)


def test_frames_that_do_not_stand_are_counted_and_three_files_are_named():
    skeleton = load_skeleton("h36m17")
    line = 900 - 800 * -standing_human(skeleton)[:, 1:2]
    standing = np.concatenate([np.full((17, 1), 500.0), line], 1)
    frames = np.stack([standing * [1, -1] + [0, 1000]] * 8 + [standing] * 2).astype(np.float32)
    parts = [PoseData(frames, np.ones((10, 17), np.float32), skeleton.joints, source=name) for name in "abcde"]
    upright = PoseData(frames[8:], np.ones((2, 17), np.float32), skeleton.joints, source="f")
    (note,) = upright_notes([*parts, upright], skeleton)
    assert "in 40 of 50 frames of a, b, c and 2 more the bodies are upside down" in note
    sideways = [replace(part, keypoints=part.keypoints[:, :, ::-1].copy()) for part in parts]
    (note,) = upright_notes(sideways[:1], skeleton)
    assert "in 8 of 10 frames the bodies are lying, with their upper end to the right" in note
    (note,) = upright_notes([replace(sideways[0], keypoints=sideways[0].keypoints * [-1, 1])], skeleton)
    assert "with their upper end to the left" in note
