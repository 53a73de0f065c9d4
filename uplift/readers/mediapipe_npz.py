"""Read npz files of MediaPipe's landmarks: an array (frames, landmarks, 2 to 5) of x, y, z, visibility and presence."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.archive import read_arrays
from uplift.readers.base import Peek, ReadOptions
from uplift.readers.csv_identity import Identity, bodies_of
from uplift.readers.mediapipe_landmarks import COUNTS, NO_DEPTH, landmark_names, placed, without_flags
from uplift.readers.table_rows import confidence_of, frame_numbers

__all__ = ["looks_like_mediapipe_npz", "read_mediapipe_npz"]

_FRAMES = ("frame", "frames", "frame_number", "frame_numbers", "frame_idx", "frame_index")
_FLAGS = ("visibility", "visibilities", "confidence", "scores")


def looks_like_mediapipe_npz(peek: Peek) -> bool:
    """Return whether an npz has an array that is called landmarks."""
    return "joint_names" not in peek.npz_names and _chosen(peek.npz_names) is not None


def read_mediapipe_npz(path: Path, options: ReadOptions) -> PoseData:
    """Read landmarks of one or several bodies.

    Raises:
        UserError: no such array, pickled objects, or another shape.
    """
    arrays = read_arrays(path)
    name = _chosen(tuple(arrays))
    if name is None:
        shown = ", ".join(sorted(arrays)) or "nothing"
        raise UserError(f"{path}: no array of landmarks (found: {shown}), expected 'landmarks' (frames, 33, 4).")
    values = _landmarks(path, name, arrays[name])
    frames, bodies, joints = values.shape[:3]
    notes = [NO_DEPTH] if values.shape[3] > 2 else []
    flags = next((arrays[key] for key in _FLAGS if key in arrays), None)
    scores = values[..., 3] if values.shape[3] > 3 else None
    if scores is None and flags is not None and flags.dtype.kind in "fiub" and flags.size == frames * bodies * joints:
        scores = flags.reshape(frames, bodies, joints).astype(np.float32)
    numbers = next((arrays[key] for key in _FRAMES if key in arrays), np.arange(frames))
    if numbers.shape != (frames,) or numbers.dtype.kind not in "fiu":
        raise UserError(f"{path}: frame numbers are {numbers.dtype} of shape {numbers.shape}, expected ({frames},).")
    frame = frame_numbers(path, numbers.astype(np.float64), once=True)
    keypoints = np.ascontiguousarray(values[..., :2]).reshape(-1, joints, 2)
    scores = without_flags(None if scores is None else scores.reshape(-1, joints), keypoints)
    found = Identity({"sequence": np.full(frames * bodies, path.stem), "frame": np.repeat(frame, bodies)}, notes=notes)
    names, told = landmark_names(path, [str(number) for number in range(joints)], options)
    found.fps, found.image_size = _number(arrays, "fps"), _size(arrays)
    seen = (confidence_of(path, keypoints, scores) > 0).any(1)  # places for bodies that a frame does not have
    found.values = {key: value[seen] for key, value in found.values.items()}
    data = bodies_of(path, found, keypoints[seen], None if scores is None else scores[seen], names, told)
    return placed(data, options)


def _chosen(names: tuple[str, ...]) -> str | None:
    """Return the array of landmarks, those of the image rather than the world's."""
    fitting = [name for name in names if "landmark" in name.casefold() and "name" not in name.casefold()]
    return min(fitting, key=lambda name: ("world" in name.casefold(), "pose" not in name.casefold()), default=None)


def _landmarks(path: Path, name: str, array: np.ndarray) -> np.ndarray:
    """Return (frames bodies landmarks numbers) float32; rows of 132 numbers are 33 landmarks of four."""
    if array.dtype.kind not in "fiu":
        raise UserError(f"{path}: '{name}' is {array.dtype}, expected numbers (frames, 33, 4).")
    if array.ndim == 2 and array.shape[1] not in (2, 3, 4, 5):
        four = next((n for n in (4, 3, 5, 2) if array.shape[1] % n == 0 and array.shape[1] // n in COUNTS), None)
        array = array if four is None else array.reshape(len(array), -1, four)
    elif array.ndim == 2:
        array = array[None]  # one image
    array = array[:, None] if array.ndim == 3 else array
    if array.ndim != 4 or array.shape[3] not in (2, 3, 4, 5) or not array.size:
        raise UserError(f"{path}: '{name}' has shape {array.shape}, expected (frames, landmarks, 2 to 5).")
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(np.float32)


def _number(arrays: dict[str, np.ndarray], name: str) -> float | None:
    array = arrays.get(name)
    if array is None or array.size != 1 or array.dtype.kind not in "fiu" or not 0 < float(array.reshape(())) < 1e5:
        return None
    return float(array.reshape(()))


def _size(arrays: dict[str, np.ndarray]) -> tuple[int, int] | None:
    """Return width and height where the file has them."""
    both = arrays.get("image_size")
    sides = list(both.ravel()) if both is not None else [_number(arrays, side) or 0 for side in ("width", "height")]
    if len(sides) != 2 or not all(isinstance(n, int | float | np.number) and 1 <= n < 1e6 for n in sides):
        return None
    return int(sides[0]), int(sides[1])
