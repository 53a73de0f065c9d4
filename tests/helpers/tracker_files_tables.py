"""Files in the layouts of DeepLabCut, MediaPipe tables and VideoPose3D."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from uplift.skeleton import load_skeleton

SCORER = "DLC_resnet50_testJan1shuffle1_1000"
POSE33 = tuple(joint.upper() for joint in load_skeleton("mediapipe33").joints if joint not in ("pelvis", "neck"))
COCO_METADATA = {
    "layout_name": "coco",
    "num_joints": 17,
    "keypoints_symmetry": [[1, 3, 5, 7, 9, 11, 13, 15], [2, 4, 6, 8, 10, 12, 14, 16]],
}


def tracked(frames: int, joints: int, seed: int = 0, missing: float = 0.1) -> np.ndarray:
    """Return (frames joints 3): x, y, likelihood as networks output them; some NaN."""
    rng = np.random.default_rng(seed)
    values = rng.random((frames, joints, 3), np.float32) * np.array([640, 480, 1], np.float32)
    values[rng.random((frames, joints)) < missing] = np.nan
    return values.astype(np.float64)


def deeplabcut_frame(
    values: np.ndarray, bodyparts: Sequence[str], individuals: Sequence[str] = (), index: object = None
) -> pd.DataFrame:
    """Return the DataFrame that DeepLabCut saves, of (frames individuals*bodyparts 2 or 3) numbers."""
    coords = ["x", "y", "likelihood"][: values.shape[-1]]
    levels = [[SCORER], *([list(individuals)] if individuals else []), list(bodyparts), coords]
    names = ["scorer", *(["individuals"] if individuals else []), "bodyparts", "coords"]
    columns = pd.MultiIndex.from_product(levels, names=names)
    return pd.DataFrame(values.reshape(len(values), -1), columns=columns, index=index)  # type: ignore[arg-type]


def mediapipe_marks(values: np.ndarray) -> list[list[dict[str, float]]]:
    """Return (frames landmarks 4) numbers as dictionaries of each frame's landmarks."""
    keys = ("x", "y", "z", "visibility")
    return [[dict(zip(keys, map(float, mark), strict=True)) for mark in frame] for frame in values]


def mediapipe_long(path: Path, values: np.ndarray, head: str = "frame_number,landmark,x,y,z,visibility") -> Path:
    """Write a row per landmark."""
    lines = [head]
    for number, frame in enumerate(values):
        lines += [
            f"{number},{name}," + ",".join(map(repr, row)) for name, row in zip(POSE33, frame.tolist(), strict=True)
        ]
    path.write_text("\n".join(lines) + "\n")
    return path


def mediapipe_wide(path: Path, values: np.ndarray, *, named: bool) -> Path:
    """Write a row per frame: x1, y1, z1, v1, ... or NOSE_x, NOSE_y, ..."""
    names = [f"{name}_{what}" for name in POSE33 for what in ("x", "y", "z", "visibility")]
    if not named:
        names = [f"{what}{number + 1}" for number in range(values.shape[1]) for what in "xyzv"]
    lines = [",".join(names)] + [",".join(map(repr, row)) for row in values.reshape(len(values), -1).tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_json(path: Path, content: object) -> Path:
    """Write JSON."""
    path.write_text(json.dumps(content))
    return path


def videopose3d_custom(path: Path, videos: dict[str, np.ndarray], **metadata: object) -> Path:
    """Write the output of prepare_data_2d_custom.py: pickled dictionaries of the videos' keypoints."""
    told = {**COCO_METADATA, "video_metadata": {name: {"w": 640, "h": 480} for name in videos}, **metadata}
    positions = {name: {"custom": [keypoints]} for name, keypoints in videos.items()}
    np.savez_compressed(path, positions_2d=positions, metadata=told)  # type: ignore[arg-type]
    return path


def videopose3d_detected(path: Path, frames: Sequence[np.ndarray]) -> Path:
    """Write the output of infer_video_d2.py: for each frame a pair of lists of (bodies 4 joints) numbers."""
    pairs = np.empty((len(frames), 2), object)
    boxes = np.empty((len(frames), 2), object)
    for number, bodies in enumerate(frames):
        pairs[number, 0], pairs[number, 1] = [], bodies if len(bodies) else []
        boxes[number, 0], boxes[number, 1] = [], np.ones((len(bodies), 5), np.float32) if len(bodies) else []
    segments = np.array([None] * len(frames))
    np.savez_compressed(path, boxes=boxes, segments=segments, keypoints=pairs, metadata={"w": 640, "h": 480})  # type: ignore[arg-type]
    return path


def damaged(whole: bytes, seed: int, count: int) -> list[bytes]:
    """Return damaged copies of the file: cut short, with flipped bytes, with malicious content."""
    rng = np.random.default_rng(seed)
    words = [
        b"nan",
        b"inf",
        b"1e300",
        b"-5",
        b'"',
        b"\0",
        b"\xff\xfe",
        b",",
        b"\n",
        b"abc",
        b"",
        b"9" * 400,
        b"\t",
        b"{",
    ]
    found = []
    for place in rng.integers(0, len(whole), count).tolist():
        found.append(whole[: max(place, 1)])
        found.append(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        end = place + int(rng.choice([0, 1, 3, 30]))
        found.append(whole[:place] + words[int(rng.integers(len(words)))] + whole[end:])
    return [one for one in found if one]
