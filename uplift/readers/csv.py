"""Plain csv files: a row per frame (NAME_x, NAME_y, NAME_confidence), or a row per joint (frame, joint, x, y)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.base import Format, Peek, ReadOptions
from uplift.readers.csv_columns import Columns, columns_of, is_nameless
from uplift.readers.csv_long import read_long
from uplift.readers.csv_wide import Named, Rated, read_wide
from uplift.readers.layouts import names_for
from uplift.readers.table_lines import header_of

__all__ = ["FORMAT", "check", "columns_in", "read_columns"]


def columns_in(peek: Peek) -> Columns | None:
    """Return the columns of a file of text that begins like a csv of keypoints; None for any other."""
    if peek.is_folder or peek.json_sign or not peek.text:
        return None
    try:
        header, separator = header_of(peek.path, 1)
    except (UserError, OSError):
        return None
    return columns_of(header[0]) if separator in peek.text else None


def left_out(columns: Columns) -> tuple[str, ...]:
    """Return what to say of columns that are not read."""
    shown = ", ".join(columns.others[:8]) + (", ..." if len(columns.others) > 8 else "")
    return (f"columns left out: {shown}",) if columns.others else ()


def _read(path: Path, options: ReadOptions) -> PoseData:
    peek = Peek(path)
    columns = columns_in(peek)
    if peek.is_folder:
        raise UserError(f"{path} is a folder, expected a csv file.")
    if columns is None:
        shown = ", ".join(header_of(path, 1)[0][0])[:120]
        raise UserError(f"{path} has the columns {shown}; expected NAME_x and NAME_y of each joint, or joint, x and y.")
    check(path, columns)
    deep = next((name for name, joint in columns.joints.items() if joint.z is not None), None)
    if deep is not None:
        what = f"'{deep}' has" if deep else "it has"
        raise UserError(
            f"{path}: {what} x, y and z: 3D points, no 2D keypoints. Give the tracker's 2D output; for landmarks of "
            "MediaPipe, whose z is left out, say format=mediapipe."
        )
    return read_columns(path, columns, lambda names: _named(path, names, options))


def read_columns(path: Path, columns: Columns, named: Named, rated: Rated | None = None) -> PoseData:
    """Read a csv of the ``columns``, wide or long; ``named`` makes joint names, and notes, of what the file has, ``rated`` scores.

    Raises:
        UserError: as `read_wide` and `read_long`.
    """
    if columns.name is not None:
        return read_long(path, columns, named, left_out(columns), rated)
    if is_nameless(list(columns.joints)):
        joints = dict(sorted(columns.joints.items(), key=lambda one: int(re.sub(r"\D", "", one[0]))))
        columns = replace(columns, joints=joints)
    return read_wide(path, columns, named, left_out(columns), rated)


def check(path: Path, columns: Columns) -> None:
    """Raise UserError where a column is there twice."""
    if columns.twice:
        raise UserError(f"{path}: the column '{columns.twice[0]}' is there twice; joint names must differ.")


def _named(path: Path, names: Sequence[str], options: ReadOptions) -> tuple[Sequence[str], Sequence[str]]:
    return names_for(path, len(names), {}, options) if is_nameless(names) else (names, ())


FORMAT = Format("csv", "plain csv", lambda peek: columns_in(peek) is not None, _read)
