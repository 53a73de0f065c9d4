"""What the files of MediaPipe have in common: the landmarks' names, and coordinates that are shares of the image."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.readers.base import ReadOptions
from uplift.readers.csv_columns import is_nameless
from uplift.readers.layouts import HAND21, Layouts, names_for
from uplift.readers.rows import SHARES_NOTE

__all__ = ["COUNTS", "NO_DEPTH", "POSE33", "is_mediapipe", "landmark_names", "placed", "without_flags"]

POSE33 = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index",
    "left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_heel", "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
NO_DEPTH = "z of MediaPipe is left out: it is a guess of the same network, no measurement"
_TELLING = {"lefteyeinner", "mouthleft", "leftfootindex", "leftpinky", "indexfingermcp", "ringfingerpip"}
_WORLD_NOTE = (
    "world landmarks, in metres about the hips and seen straight on, without perspective: x and y are taken as they "
    "are; landmarks of the image are better"
)
_PIXEL_NOTE = "coordinates go beyond any share of an image: taken as pixels"
_LARGEST_SHARE = 5.0
_AT_HIPS = 0.02


def _both(side: str) -> tuple[str, ...]:
    return tuple(f"{side}_hand_{name}" for name in HAND21)


def _face(count: int) -> tuple[str, ...]:
    return tuple(f"face_{number}" for number in range(count))


_BODY = "MediaPipe's pose"
COUNTS: Layouts = {
    33: (_BODY, POSE33),
    21: ("a hand", HAND21),
    468: ("MediaPipe's face", _face(468)),
    478: ("MediaPipe's face", _face(478)),
    75: (f"{_BODY} and both hands", (*POSE33, *_both("left"), *_both("right"))),
    501: (f"{_BODY} and face", (*POSE33, *_face(468))),
    543: (f"{_BODY}, face and both hands", (*POSE33, *_face(468), *_both("left"), *_both("right"))),
}


def is_mediapipe(names: Sequence[str]) -> bool:
    """Return whether some of the names are ones that only MediaPipe gives."""
    return bool(_TELLING & {re.sub(r"[^a-z]", "", name.casefold().split(".")[-1]) for name in names})


def landmark_names(path: Path, names: Sequence[str], options: ReadOptions) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of landmarks that a file names or only numbers, and the notes that say so."""
    if not is_nameless(names):
        return tuple(name.split(".")[-1] for name in names), ()  # PoseLandmark.NOSE, as Python prints it
    numbers = [int(re.sub(r"\D", "", name)) for name in names]
    if len(names) not in COUNTS and options.layout is None and max(numbers, default=99) < len(POSE33):
        told = f"landmarks have no names in the file: numbers are taken as {_BODY}'s"
        return tuple(POSE33[number] for number in numbers), (told,)
    return names_for(path, len(names), COUNTS, options)


def without_flags(scores: np.ndarray | None, keypoints: np.ndarray) -> np.ndarray | None:
    """Return the visibility, with landmarks that never have one (hands, faces) as visible where they are.

    ``scores`` are (rows joints), ``keypoints`` (rows joints 2).
    """
    if scores is None:
        return None
    never = ~(scores > 0).any(0)
    if not never.any():
        return scores
    there = np.isfinite(keypoints).all(-1) & (keypoints != 0).any(-1)
    return np.where(never, there.astype(np.float32), scores)


def placed(data: PoseData, options: ReadOptions) -> PoseData:
    """Return the keypoints in pixels, where they are shares of an image whose size is known; a note says what they are."""
    seen = data.keypoints[data.confidence > 0]
    size = options.image_size or data.image_size
    if np.quantile(np.abs(seen), 0.99) > _LARGEST_SHARE:
        return replace(data, notes=(*data.notes, _PIXEL_NOTE))
    if _is_world(data, seen):
        return replace(data, notes=(*data.notes, _WORLD_NOTE))
    if size is None:
        return replace(data, notes=(*data.notes, SHARES_NOTE))
    return replace(data, keypoints=data.keypoints * np.array(size, np.float32), image_size=size)


def _is_world(data: PoseData, seen: np.ndarray) -> bool:
    """Return whether coordinates are about the hips' middle, or about any middle where there are no hips."""
    names = [name.casefold() for name in data.joint_names]
    if "left_hip" in names and "right_hip" in names:
        hips = [names.index("left_hip"), names.index("right_hip")]
        both = (data.confidence[:, hips] > 0).all(1)
        if both.any():
            middle = data.keypoints[both][:, hips].mean(1)
            return bool((np.median(np.abs(middle), 0) < _AT_HIPS).all())
    return bool(((seen < 0).mean(0) > 0.2).all())
