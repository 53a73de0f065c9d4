"""JSON and text files in the layouts of trackers and annotation tools, with known keypoints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.layouts import COCO_JOINTS

__all__ = [
    "alphapose_list", "alphapose_objects", "alphatracker", "coco_annotations", "coco_results", "kinetics", "mmpose",
    "mpii", "openpose_frame", "people", "ultralytics_list", "ultralytics_row", "write_json",
]  # fmt: skip


def people(rows: int, joints: int, seed: int = 0, size: float = 1000.0) -> np.ndarray:
    """Return (rows, joints, 3): x, y with three decimals that are distinct in float32, and a score; some are missing."""
    rng = np.random.default_rng(seed)
    found = np.concatenate([rng.uniform(1, size, (rows, joints, 2)), rng.uniform(0.05, 1, (rows, joints, 1))], -1)
    found = np.round(found, 3)
    found[rng.random((rows, joints)) < 0.1] = 0
    found[:, 0] = np.maximum(found[:, 0], 0.5)  # nobody without any
    return found


def write_json(path: Path, content: Any) -> Path:
    """Write a file, creating its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def coco_annotations(
    flat: np.ndarray, joints: tuple[str, ...] = COCO_JOINTS, category: str = "person", start: int = 1
) -> dict[str, Any]:
    """Return annotations of (rows, joints, 3) x, y, v, two per image of 640 x 480."""
    return {
        "info": {"year": 2020},
        "licenses": [],
        "images": [
            {"id": start + n, "file_name": f"{start + n:012d}.jpg", "width": 640, "height": 480}
            for n in range((len(flat) + 1) // 2)
        ],
        "annotations": [
            {
                "id": 100 * start + row,
                "image_id": start + row // 2,
                "category_id": start,
                "keypoints": np.asarray(person).ravel().tolist(),
                "num_keypoints": int((np.asarray(person)[:, 2] > 0).sum()),
                "bbox": [1.0, 2.0, 3.0, 4.0],
                "area": 12.0,
                "iscrowd": 0,
            }
            for row, person in enumerate(flat)
        ],
        "categories": [
            {
                "id": start,
                "name": category,
                "supercategory": category,
                "keypoints": list(joints),
                "skeleton": [[1, 2], [2, 3]],
            }
        ],
    }


def coco_results(flat: np.ndarray) -> list[dict[str, Any]]:
    """Return results of (rows, joints, 3), two per image."""
    return [
        {"image_id": 139 + row // 2, "category_id": 1, "keypoints": person.ravel().tolist(), "score": 0.9}
        for row, person in enumerate(flat)
    ]


def alphapose_list(flat: np.ndarray, track: int | None = 1) -> list[dict[str, Any]]:
    """Return AlphaPose's list, one body per video frame."""
    found = []
    for row, person in enumerate(flat):
        entry = {"image_id": f"{row}.jpg", "category_id": 1, "keypoints": person.ravel().tolist(), "score": 2.9}
        found.append({**entry, "box": [0.0, 1.0, 2.0, 3.0], **({} if track is None else {"idx": [float(track)]})})
    return found


def alphapose_objects(flat: np.ndarray, form: str) -> dict[str, Any]:
    """Return the output of ``--format cmu`` and ``--format open``, one body per image."""
    list_name, own = {"cmu": ("bodies", "joints"), "open": ("people", "pose_keypoints_2d")}[form]
    return {
        f"{row}.jpg": {"version": "AlphaPose v0.3", list_name: [{own: person.ravel().tolist()}]}
        for row, person in enumerate(flat)
    }


def openpose_frame(bodies: list[dict[str, np.ndarray]], person: int = -1) -> dict[str, Any]:
    """Return a frame of people, each given by its parts: pose, face, hand_left, hand_right of (points, 3)."""
    parts = ("pose", "face", "hand_left", "hand_right")
    return {
        "version": 1.3,
        "people": [
            {
                "person_id": [person],
                **{f"{part}_keypoints_2d": body.get(part, np.empty(0)).ravel().tolist() for part in parts},
                **{f"{part}_keypoints_3d": [] for part in parts},
            }
            for body in bodies
        ],
    }


def mmpose_instance(person: np.ndarray, track: int | None = None) -> dict[str, Any]:
    """Return one instance of (joints, 3)."""
    return {
        "keypoints": person[:, :2].tolist(),
        "keypoint_scores": person[:, 2].tolist(),
        "bbox": [[0.0, 0.0, 4.0, 5.0]],
        "bbox_score": 0.9,
        **({} if track is None else {"track_id": track}),
    }


def mmpose(frames: list[list[np.ndarray]], names: tuple[str, ...], tracks: bool = False) -> dict[str, Any]:
    """Return a video's predictions with meta_info, frames counted from 1."""
    return {
        "meta_info": {
            "dataset_name": "own",
            "num_keypoints": len(names),
            "keypoint_id2name": {str(n): name for n, name in enumerate(names)},
            "keypoint_name2id": {name: n for n, name in enumerate(names)},
            "upper_body_ids": [0],
            "flip_indices": [n if n == 0 else n - 1 + 2 * (n % 2) for n in range(len(names))],
            "flip_pairs": [[2, 1], [1, 2]],
            "keypoint_colors": {"__ndarray__": [[1, 2, 3]], "dtype": "uint8", "shape": [1, 3]},
            "skeleton_links": [[0, 1], [1, 2]],
        },
        "instance_info": [
            {
                "frame_id": n + 1,
                "instances": [mmpose_instance(one, number + 7 if tracks else None) for number, one in enumerate(frame)],
            }
            for n, frame in enumerate(frames)
        ],
    }


def kinetics(frames: list[list[np.ndarray]], flat: bool = True) -> dict[str, Any]:
    """Return a video's skeletons, frames counted from 1; flat like ST-GCN's, or in pairs with nested scores."""

    def skeleton(person: np.ndarray) -> dict[str, Any]:
        if flat:
            return {"pose": person[:, :2].ravel().tolist(), "score": person[:, 2].tolist()}
        return {"pose": person[:, :2].tolist(), "score": person[:, 2:].tolist(), "bbox": [1, 2, 3, 4]}

    data = [{"frame_index": n + 1, "skeleton": [skeleton(one) for one in frame]} for n, frame in enumerate(frames)]
    return {"data": data, "label": "jumping", "label_index": 3}


def mpii(flat: np.ndarray) -> list[dict[str, Any]]:
    """Return MPII's list of people of (rows, 16, 3)."""
    return [
        {
            "joints_vis": (person[:, 2] > 0).astype(int).tolist(),
            "joints": np.where(person[:, 2:] > 0, person[:, :2], -1.0).tolist(),
            "image": f"{row:09d}.jpg",
            "scale": 4.7,
            "center": [966.0, 340.0],
        }
        for row, person in enumerate(flat)
    ]


def mpii_selves(flat: np.ndarray, size: tuple[int, int] = (1280, 720)) -> list[dict[str, Any]]:
    """Return people of (rows, joints, 3) as Convolutional Pose Machines list them, two in an image."""
    people = [[[*map(float, joint)] for joint in person] for person in flat]
    return [
        {
            "dataset": "MPI", "isValidation": 0.0, "img_paths": f"{row // 2:09d}.jpg", "img_width": float(size[0]),
            "img_height": float(size[1]), "objpos": [594.0, 257.0], "joint_self": person, "scale_provided": 3.021,
            "joint_others": people[row ^ 1] if row ^ 1 < len(people) else [], "numOtherPeople": 1.0,
        }
        for row, person in enumerate(people)
    ]  # fmt: skip


def alphatracker(images: list[list[np.ndarray]]) -> list[dict[str, Any]]:
    """Return AlphaTracker's labels of animals of (points, 2), given by image."""

    def parts(animal: np.ndarray) -> list[dict[str, Any]]:
        box = {"class": "Face", "height": 3.0, "width": 3.0, "x": 1.0, "y": 1.0}
        return [box, *({"class": "point", "x": float(x), "y": float(y)} for x, y in animal)]

    return [
        {
            "annotations": [part for animal in animals for part in parts(animal)],
            "class": "image",
            "filename": f"i{n}.png",
        }
        for n, animals in enumerate(images)
    ]


def ultralytics_row(points: np.ndarray, *extra: float, kind: int = 0) -> str:
    """Return a row of a label file: class, the box around (joints, 2 or 3) fractions, the points, and any further values."""
    given = points[(points[:, :2] != 0).any(1), :2]
    low, high = given.min(0), given.max(0)
    values = [kind, *((low + high) / 2), *(high - low), *points.ravel(), *extra]
    return " ".join(f"{value:g}" if number == 0 else f"{value:.7g}" for number, value in enumerate(values))


def ultralytics_list(flat: np.ndarray, tracks: bool = False) -> list[dict[str, Any]]:
    """Return the output of ``to_json()`` for one image."""
    return [
        {
            "name": "person",
            "class": 0,
            "confidence": 0.9,
            "box": {"x1": 1.0, "y1": 2.0, "x2": 3.0, "y2": 4.0},
            **({"track_id": row + 1} if tracks else {}),
            "keypoints": {axis: person[:, n].tolist() for n, axis in enumerate(("x", "y", "visible"))},
        }
        for row, person in enumerate(flat)
    ]
