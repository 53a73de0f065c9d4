"""Keypoints without names: every reader asks the same question, and says which layout it took and how to name another."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from uplift.data.formats import read
from uplift.data.formats.base import ReadOptions
from uplift.errors import UserError

COCO = [
    "nose",
    "left_eye",
    "right_eye",
    "left_ear",
    "right_ear",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
]
H36M = [
    "hip",
    "rhip",
    "rknee",
    "rankle",
    "lhip",
    "lknee",
    "lankle",
    "spine",
    "thorax",
    "nose",
    "headtop",
    "lshoulder",
    "lelbow",
    "lwrist",
    "rshoulder",
    "relbow",
    "rwrist",
]
HALPE = [
    "head",
    "neck",
    "hip",
    "left_big_toe",
    "right_big_toe",
    "left_small_toe",
    "right_small_toe",
    "left_heel",
    "right_heel",
]

# A person seen from the front, as one draws it: the person's left is on the right of the picture.
PLACES = {
    "nose": (500, 210), "left_eye": (512, 198), "right_eye": (488, 198), "left_ear": (528, 205),
    "right_ear": (472, 205), "left_shoulder": (570, 300), "right_shoulder": (430, 300), "left_elbow": (600, 420),
    "right_elbow": (400, 420), "left_wrist": (610, 530), "right_wrist": (390, 530), "left_hip": (540, 540),
    "right_hip": (460, 540), "left_knee": (545, 720), "right_knee": (455, 720), "left_ankle": (548, 890),
    "right_ankle": (452, 890), "head": (500, 150), "neck": (500, 290), "hip": (500, 538),
    "left_big_toe": (565, 920), "right_big_toe": (435, 920), "left_small_toe": (580, 915),
    "right_small_toe": (420, 915), "left_heel": (545, 905), "right_heel": (455, 905),
    "spine": (500, 415), "thorax": (500, 300), "headtop": (500, 140),
}  # fmt: skip
FULL = {"r": "right_", "l": "left_"}


def place(joint: str) -> tuple[float, float]:
    return PLACES[joint] if joint in PLACES else PLACES[FULL[joint[0]] + joint[1:]]


def body(joints: list[str], frames: int = 6) -> np.ndarray:
    """Return (frames, joints, 3): a person who stands, and x, y, score of each joint."""
    points = np.array([(*place(joint), 0.9) for joint in joints])
    moved = np.repeat(points[None], frames, 0)
    moved[..., 0] += 2 * np.arange(frames)[:, None]
    return moved


def wholebody() -> np.ndarray:
    """Return (6, 133, 3): COCO's 17, six of the feet, a face and two hands about their roots."""
    people = body([*COCO, *(HALPE[n] for n in (3, 5, 7, 4, 6, 8))])
    turn = np.linspace(0, 2 * np.pi, 68, endpoint=False)
    face = people[:, :1, :2] + 12 * np.stack([np.cos(turn), np.sin(turn)], -1)
    hands = [people[:, [wrist], :2] + np.arange(21)[:, None] * [0.5, 1.0] for wrist in (9, 10)]
    more = np.concatenate([face, *hands], 1)
    return np.concatenate([people, np.dstack([more, np.full(more.shape[:2], 0.8)])], 1)


def openpose(path: Path, people: np.ndarray) -> Path:
    path.mkdir()
    for frame, row in enumerate(people):
        person = {"pose_keypoints_2d": row.ravel().tolist()}
        (path / f"v_{frame:03d}.json").write_text(json.dumps({"people": [person]}))
    return path


def saved(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content))
    return path


def kinetics(path: Path, people: np.ndarray) -> Path:
    data = [
        {"frame_index": n + 1, "skeleton": [{"pose": row[:, :2].ravel().tolist(), "score": row[:, 2].tolist()}]}
        for n, row in enumerate(people)
    ]
    return saved(path, {"data": data, "label": "walk", "label_index": 0})


def alphapose(path: Path, people: np.ndarray) -> Path:
    return saved(
        path, [{"image_id": f"{n}.jpg", "keypoints": r.ravel().tolist(), "idx": 1} for n, r in enumerate(people)]
    )


def coco_results(path: Path, people: np.ndarray) -> Path:
    rows = [
        {"image_id": n, "category_id": 1, "keypoints": r.ravel().tolist(), "score": 1} for n, r in enumerate(people)
    ]
    return saved(path, rows)


def mmpose(path: Path, people: np.ndarray) -> Path:
    frames = [
        {"frame_id": n, "instances": [{"keypoints": r[:, :2].tolist(), "keypoint_scores": r[:, 2].tolist()}]}
        for n, r in enumerate(people)
    ]
    return saved(path, {"meta_info": {}, "instance_info": frames})


def coco(path: Path, people: np.ndarray) -> Path:
    images = [{"id": n, "file_name": f"{n}.jpg", "width": 1000, "height": 1000} for n in range(len(people))]
    marked = [{"id": n, "image_id": n, "category_id": 1, "keypoints": r.ravel().tolist()} for n, r in enumerate(people)]
    return saved(path, {"images": images, "annotations": marked, "categories": [{"id": 1, "name": "person"}]})


def ultralytics(path: Path, people: np.ndarray) -> Path:
    path.mkdir()
    for n, row in enumerate(people):
        xy = row[:, :2] / 1000
        low, high = xy.min(0), xy.max(0)
        numbers = [0, *(low + high) / 2, *(high - low), *np.concatenate([xy, row[:, 2:]], 1).ravel()]
        (path / f"v_{n:03d}.txt").write_text(" ".join(f"{value:.6g}" for value in numbers))
    return path


def ultralytics_json(path: Path, people: np.ndarray) -> Path:
    return saved(
        path,
        [
            [{"name": "person", "class": 0, "confidence": 0.9, "box": {},
              "keypoints": {"x": r[:, 0].tolist(), "y": r[:, 1].tolist(), "visible": r[:, 2].tolist()}}]
            for r in people
        ],
    )  # fmt: skip


def csv(path: Path, people: np.ndarray) -> Path:
    head = "frame," + ",".join(f"keypoint_{n}_{what}" for n in range(people.shape[1]) for what in ("x", "y", "score"))
    rows = [f"{n}," + ",".join(f"{value:.6g}" for value in row.ravel()) for n, row in enumerate(people)]
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


WRITERS = {
    "openpose": openpose, "kinetics_skeleton": kinetics, "alphapose": alphapose, "coco_results": coco_results,
    "mmpose": mmpose, "coco": coco, "ultralytics": ultralytics, "ultralytics_json": ultralytics_json, "csv": csv,
}  # fmt: skip
LAYOUTS = {"COCO": COCO, "Human3.6M": H36M, "Halpe": [*COCO, *HALPE]}
every_reader = pytest.mark.parametrize("format", WRITERS)


def written(folder: Path, format: str, people: np.ndarray) -> Path:
    return WRITERS[format](folder / ("a.csv" if format == "csv" else "a"), people)


def options(format: str, **more: str) -> ReadOptions:
    return ReadOptions(format=format, image_size=(1000, 1000) if format == "ultralytics" else None, **more)


@every_reader
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_reader_takes_the_layout_whose_bones_fit(tmp_path: Path, format: str, layout: str) -> None:
    data = read(written(tmp_path, format, body(LAYOUTS[layout])), options(format))
    assert list(data.joint_names) == LAYOUTS[layout]
    note = next(note for note in data.notes if "no names in the file" in note)
    assert f"taken as {layout}" in note and "layout=" in note and "WARNING" not in note


@every_reader
def test_whole_bodies_have_names(tmp_path: Path, format: str) -> None:
    data = read(written(tmp_path, format, wholebody()), options(format))
    assert data.joint_names[:17] == tuple(COCO) and data.joint_names[91] == "left_hand_root"


@every_reader
def test_what_the_user_says_wins(tmp_path: Path, format: str) -> None:
    data = read(written(tmp_path, format, body(COCO)), options(format, layout="h36m17"))
    assert list(data.joint_names) == H36M
    assert not any("no effect" in note for note in data.notes)


@every_reader
def test_bones_that_fit_no_layout_are_told(tmp_path: Path, format: str) -> None:
    people = body(COCO)[:, np.random.default_rng(0).permutation(17)]
    data = read(written(tmp_path, format, people), options(format))
    note = next(note for note in data.notes if "no names in the file" in note)
    assert "layout=SKELETON" in note and ("WARNING" in note or "keypoint_0" in data.joint_names)


def test_openpose_and_halpe_of_other_models(tmp_path: Path) -> None:
    face = read(openpose(tmp_path / "a", np.concatenate([body([*COCO, *HALPE]), wholebody()[:, 23:]], 1)))
    assert face.joint_names[17:20] == ("head", "neck", "hip") and len(face.joint_names) == 136
    rest = wholebody()
    hands = [rest[:, 92:112], rest[:, 113:133], rest[:, 23:91], rest[:, 23:25]]
    left = read(openpose(tmp_path / "b", np.concatenate([body([*COCO, "neck", "head", *HALPE[3:]]), *hands], 1)))
    assert left.joint_names[17:19] == ("UpperNeck", "HeadTop") and left.joint_names[25] == "left_thumb1"
    assert left.joint_names[45] == "right_thumb1" and left.joint_names[65] == "face-0"
    assert len(left.joint_names) == 135


def test_layouts_that_fit_as_well_are_named(tmp_path: Path) -> None:
    people = body(COCO)
    people[:, :11] = 0  # of legs alone nobody can tell
    few = read(openpose(tmp_path / "a", people))
    assert list(few.joint_names) == COCO
    assert any("Human3.6M (layout=h36m17)" in note and "fit as well" in note for note in few.notes)
    whole = read(openpose(tmp_path / "b", body(COCO)))
    assert not any("fit as well" in note for note in whole.notes)


@pytest.mark.parametrize("count", [15, 16, 17, 18, 21, 25])
def test_points_in_a_ring_or_a_row_are_no_body(tmp_path: Path, count: int) -> None:
    turn = np.arange(count) * 2 * np.pi / count
    ring = np.stack([500 + 400 * np.cos(turn), 500 + 300 * np.sin(turn), np.full(count, 0.9)], -1)
    row = np.stack([10.0 + 20 * np.arange(count), 500 - 3.0 * np.arange(count), np.full(count, 0.9)], -1)
    for number, points in enumerate((ring, row)):
        data = read(csv(tmp_path / f"{number}.csv", np.repeat(points[None], 5, 0)))
        assert data.joint_names[:2] == ("keypoint_0", "keypoint_1")


def test_a_layout_has_no_effect_on_files_with_names(tmp_path: Path) -> None:
    named = tmp_path / "a.csv"
    named.write_text("frame,tip_x,tip_y,end_x,end_y\n0,10,20,30,40\n1,11,20,31,40\n")
    data = read(named, ReadOptions(layout="coco17"))
    assert data.joint_names == ("tip", "end")
    assert "layout=coco17 has no effect: the file names its joints (tip, end)" in data.notes
    with pytest.raises(UserError, match="nosuch"):
        read(named, ReadOptions(layout="nosuch"))


def test_numbers_in_place_of_names_are_named_by_the_layout(tmp_path: Path) -> None:
    names = np.array([str(number) for number in range(17)])
    np.savez(tmp_path / "a.npz", keypoints=body(COCO)[..., :2], joint_names=names)
    assert read(tmp_path / "a.npz").joint_names == tuple(names)
    assert list(read(tmp_path / "a.npz", ReadOptions(layout="coco17")).joint_names) == COCO
    with pytest.raises(UserError, match="has 17 keypoints; layout=hand21 has 21"):
        read(tmp_path / "a.npz", ReadOptions(layout="hand21"))
