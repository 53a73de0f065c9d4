"""Read csv files of MediaPipe's landmarks: a row per frame, or a row per landmark."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.base import Peek, ReadOptions
from uplift.readers.csv import check, columns_in, read_columns
from uplift.readers.csv_columns import Columns, is_nameless
from uplift.readers.mediapipe_landmarks import COUNTS, NO_DEPTH, is_mediapipe, landmark_names, placed, without_flags

__all__ = ["looks_like_mediapipe_csv", "read_mediapipe_csv"]


def looks_like_mediapipe_csv(peek: Peek) -> bool:
    """Return whether a csv has landmarks of MediaPipe, by name, or by number with as many as MediaPipe has."""
    columns = columns_in(peek)
    if columns is None:
        return False
    if columns.name is None:
        names = [name for name in columns.joints if not _is_world(name)] or list(columns.joints)
        deep = all(joint.z is not None for joint in columns.joints.values())
        return is_mediapipe(names) or (is_nameless(names) and len(names) in COUNTS and deep)
    head = peek.lines[0].replace(";", ",").replace("\t", ",").split(",")[columns.name]
    cells = [line.replace(";", ",").replace("\t", ",").split(",") for line in peek.lines[1:600]]
    names = [row[columns.name].strip(' "') for row in cells if len(row) > columns.name]
    numbered = is_nameless(names) and columns.joints[""].z is not None and bool(names)
    return is_mediapipe(names) or (numbered and ("landmark" in head.casefold() or head.strip(' "').casefold() == "id"))


def read_mediapipe_csv(path: Path, options: ReadOptions) -> PoseData:
    """Read landmarks of the image, in pixels where its size is known, or of the world, in metres.

    Raises:
        UserError: no columns of landmarks, rows of different lengths, text where numbers must be.
    """
    columns = columns_in(Peek(path))
    if columns is None:
        raise UserError(
            f"{path} has no columns of landmarks; expected frame, landmark, x, y, z, or x1, y1, z1, v1, x2, ... "
            "of MediaPipe."
        )
    check(path, columns)
    columns, notes = _of_the_image(columns)
    if any(joint.z is not None for joint in columns.joints.values()):
        notes = (*notes, NO_DEPTH)
    data = read_columns(path, columns, lambda names: landmark_names(path, names, options), without_flags)
    return placed(replace(data, notes=(*data.notes, *notes)), options)


def _of_the_image(columns: Columns) -> tuple[Columns, tuple[str, ...]]:
    """Return the columns without world landmarks, where there are others."""
    image = {name: joint for name, joint in columns.joints.items() if not _is_world(name)}
    if not image or len(image) == len(columns.joints):
        return columns, ()
    return replace(columns, joints=image), ("world landmarks are left out, those of the image are taken",)


def _is_world(name: str) -> bool:
    return "world" in name.casefold()
