"""Write the 2D of a `PoseData` as a plain csv: one row a frame and individual, NAME_x, NAME_y, NAME_confidence."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from uplift.data.container import IDENTITY_KEYS, PoseData
from uplift.errors import UserError
from uplift.readers.csv_columns import columns_of, is_nameless
from uplift.saving import replacing

__all__ = ["as_text", "write_keypoints_csv"]

_BLOCK = 4096


def write_keypoints_csv(data: PoseData, path: str | Path) -> None:
    """Write keypoints, confidence, identity, times and image size; format=csv reads them back the same.

    NaN is an empty cell. What came from 3D is not written.

    Raises:
        UserError: joint names that a header of a csv cannot hold.
    """
    header = [f"{joint}_{what}" for joint in data.joint_names for what in ("x", "y", "confidence")]
    found = columns_of(header)
    if found is None or tuple(found.joints) != data.joint_names or found.twice or is_nameless(data.joint_names):
        read = () if found is None else found.joints
        wrong = next((name for name in data.joint_names if name not in read), data.joint_names[0])
        raise UserError(f"cannot write {path}: the joint name '{wrong}' cannot be told from a column's. Write .npz.")
    beside = _beside(data)
    with replacing(path) as handle:
        text = io.TextIOWrapper(handle, encoding="utf-8", newline="")
        lines = csv.writer(text, lineterminator="\n")
        lines.writerow([*beside, *header])
        for rows in _blocks(len(data)):
            numbers = np.concatenate([data.keypoints[rows], data.confidence[rows][..., None]], -1)
            cells = as_text(numbers.reshape(len(numbers), -1))
            columns = [column[rows].tolist() for column in beside.values()]
            lines.writerows([*own, *row] for *own, row in zip(*columns, cells.tolist(), strict=True))
        text.flush()
        text.detach()


def as_text(numbers: np.ndarray) -> np.ndarray:
    """Return float32 as the shortest text that is read back as the same, and nothing for NaN."""
    numbers = numbers.astype(np.float32)
    texts = numbers.astype(np.str_)
    return np.where(np.isnan(numbers), "", texts)


def _beside(data: PoseData) -> dict[str, np.ndarray]:
    """Return the columns that are no keypoints."""
    keys = [key for key in ("frame", *IDENTITY_KEYS) if key in data.identity]
    columns = {key: data.identity[key] for key in dict.fromkeys(keys)}
    if data.fps is not None and "frame" in columns:
        columns["time_s"] = columns["frame"] / data.fps
    if data.image_size is not None:
        width, height = data.image_size
        columns["image_width"] = np.full(len(data), width)
        columns["image_height"] = np.full(len(data), height)
    return columns


def _blocks(rows: int) -> Iterator[slice]:
    yield from (slice(at, at + _BLOCK) for at in range(0, rows, _BLOCK))
