"""Read the csv files of DeepLabCut and Lightning Pose: three or four header rows, then a row per frame or image."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.base import Peek
from uplift.readers.deeplabcut_columns import LEVELS, layout_of, pose_data
from uplift.readers.table import Table
from uplift.readers.table_lines import first_lines, header_of

__all__ = ["looks_like_deeplabcut_csv", "read_deeplabcut_csv"]


def looks_like_deeplabcut_csv(peek: Peek) -> bool:
    """Return whether the first lines are DeepLabCut's header."""
    return _levels(peek) is not None


def read_deeplabcut_csv(path: Path) -> PoseData:
    """Read predictions (frames of a video) or labels (images) of one or several individuals.

    Raises:
        UserError: another header, rows of different lengths, text where numbers must be, 3D.
    """
    peek = Peek(path)
    levels = _levels(peek)
    if levels is None:
        raise UserError(
            f"{path} begins {peek.text[:60]!r}, expected the header rows of DeepLabCut: {', '.join(LEVELS[0])} "
            f"({', '.join(LEVELS[1])} for several individuals)."
        )
    rows = len(levels)
    header, _ = header_of(path, rows)
    indices = next((at for at in range(1, len(header[0])) if any(row[at] for row in header)), len(header[0]))
    layout = layout_of(path, list(zip(*(row[indices:] for row in header), strict=True)))
    below = header_of(path, rows + 1)[0][-1]
    if not any(below[indices:]):  # the name of the index, or an image without labels: no keypoints either way
        rows += 1
        below = header_of(path, rows + 1)[0][-1]
    by_image = indices > 1 or not _is_number(below[0])
    table = Table.read(
        path,
        rows,
        (layout.columns + indices).tolist(),
        exact=() if by_image else (0,),
        words=range(indices) if by_image else (),
    )
    index = _images(table, indices) if by_image else table.exact[0]
    return pose_data(path, layout, table.numbers, index, table.lines)


def _levels(peek: Peek) -> tuple[str, ...] | None:
    """Return the rows of the header; None where it is none of DeepLabCut."""
    if not peek.text.lstrip('\r\n "').startswith(LEVELS[0][0]):
        return None
    for levels in LEVELS:
        try:
            lines = first_lines(peek.path, len(levels))
        except (UserError, OSError):
            return None
        if tuple(re.split("[,;\t]", line, maxsplit=1)[0].strip(' "') for line in lines) == levels:
            return levels
    return None


def _is_number(text: str) -> bool:
    return text.replace(".", "", 1).isdecimal()


def _images(table: Table, columns: int) -> np.ndarray:
    """Return (rows,) paths of images, whose folders may stand in columns of their own."""
    values = [table.words[place].values().tolist() for place in range(columns)]
    paths = ["/".join(part for part in parts if part).replace("\\", "/") for parts in zip(*values, strict=True)]
    if not all(paths):
        raise UserError(f"{table.path}, line {table.lines[paths.index('')]}: no name of an image.")
    return np.array(paths, np.str_)
