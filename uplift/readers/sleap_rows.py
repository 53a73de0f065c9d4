"""Which instances of a SLEAP project count: those of its frames, one a track, labels before predictions."""

from __future__ import annotations

import numpy as np

from uplift.errors import UserError
from uplift.readers.hdf5 import Hdf5

__all__ = ["PREDICTED", "USER", "first_of_each", "keys_of", "rows_of", "without_replaced"]

USER, PREDICTED = 0, 1
"""Kinds of instances, as SLEAP numbers them."""


def rows_of(file: Hdf5, bodies: int, tracks: int) -> dict[str, np.ndarray]:
    """Return columns of whole numbers, a row for each instance that a frame has."""
    frames = _whole(file, "frames", ("video", "frame_idx", "instance_id_start", "instance_id_end"))
    columns = ("instance_id", "instance_type", "skeleton", "track", "from_predicted", "point_id_start", "point_id_end")
    instances = _whole(file, "instances", columns)
    start, count = frames["instance_id_start"], frames["instance_id_end"] - frames["instance_id_start"]
    there = len(instances["track"])
    if ((start < 0) | (count < 0) | (start + count > there)).any() or count.sum() > there:
        raise UserError(f"{file.path}: 'frames' names instances that are not among the {there:,} of 'instances'.")
    which = np.repeat(start - np.append(0, np.cumsum(count)[:-1]), count) + np.arange(count.sum())
    rows = {name: column[which] for name, column in instances.items()}
    rows["video"], rows["frame"] = np.repeat(frames["video"], count), np.repeat(frames["frame_idx"], count)
    for name, low, high in (
        ("instance_type", USER, PREDICTED + 1),
        ("skeleton", 0, bodies),
        ("track", -1, tracks),
        ("frame", 0, 2**40),
    ):
        if len(rows[name]) and (rows[name].min() < low or rows[name].max() >= high):
            raise UserError(
                f"{file.path}: column '{name}' goes from {rows[name].min()} to {rows[name].max()}, "
                f"expected {low} to {high - 1}."
            )
    return rows


def _whole(file: Hdf5, name: str, columns: tuple[str, ...]) -> dict[str, np.ndarray]:
    found = file.table(name, columns)
    for column, values in found.items():
        if values.dtype.kind == "f":
            right = np.isfinite(values) & (np.abs(values) < 2**53) & (values == np.rint(values))
        else:
            right = values <= 2**62
        if not right.all():
            raise UserError(
                f"{file.path}: column '{column}' of '{name}' holds {values[~right][0]}, expected whole numbers."
            )
        found[column] = values.astype(np.int64)
    return found


def keys_of(rows: dict[str, np.ndarray]) -> np.ndarray:
    """Return (rows,) numbers, the same for rows of one video, frame and track."""
    key = np.zeros(len(rows["track"]), np.int64)
    for name in ("video", "frame", "track"):
        code = np.unique(rows[name], return_inverse=True)[1]
        key = np.unique(key * (code.max(initial=0) + 1) + code, return_inverse=True)[1]
    return key


def without_replaced(rows: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the rows without predictions that a labelled instance stands for, and a note where there were any."""
    user, tracked = rows["instance_type"] == USER, rows["track"] >= 0
    key = keys_of(rows)
    replaced = np.isin(rows["instance_id"], rows["from_predicted"][user & (rows["from_predicted"] >= 0)])
    replaced |= tracked & np.isin(key, key[user & tracked])
    replaced &= ~user
    told = f"{int(replaced.sum()):,} predicted instances are left out, as labelled ones stand in their place"
    return {name: column[~replaced] for name, column in rows.items()}, [told] if replaced.any() else []


def first_of_each(rows: dict[str, np.ndarray], seen: np.ndarray) -> np.ndarray:
    """Return the indices, in the order of time, of rows that show something, one for each video, frame and track."""
    where = np.flatnonzero(seen)
    key = keys_of({name: rows[name][where] for name in ("video", "frame", "track")})
    first = np.zeros(len(where), bool)
    first[np.unique(key, return_index=True)[1]] = True
    where = where[first | (rows["track"][where] < 0)]
    return where[np.lexsort((rows["frame"][where], rows["video"][where]))]
