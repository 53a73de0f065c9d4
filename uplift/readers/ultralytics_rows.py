"""The rows of Ultralytics' label files, and what their numbers are."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.readers.number_lists import Numbers
from uplift.readers.ultralytics_set import Description

__all__ = ["Labels", "RowLayout", "read_rows", "row_layout"]


@dataclass
class Labels:
    """The rows of all label files."""

    file: list[int] = field(default_factory=list)
    line: list[int] = field(default_factory=list)
    length: np.ndarray = field(default_factory=lambda: np.empty(0, int))
    """(rows,) numbers in a row."""
    values: np.ndarray = field(default_factory=lambda: np.empty((0, 0), np.float32))
    """(rows, longest), NaN behind the end of a row."""
    boxes: np.ndarray = field(default_factory=lambda: np.empty((0, 5), np.float32))
    """(rows, 5): class, centre and size."""


@dataclass
class RowLayout:
    """What the numbers of a row are."""

    count: int
    values: np.ndarray
    """(rows, keypoints, 2 or 3)."""
    predicted: bool
    """Whether a network made them, not a person."""
    track: np.ndarray | None
    """(rows,) text, empty where a row has none."""


def row_layout(path: Path, labels: Labels, told: Description, notes: list[str]) -> RowLayout:
    """Return how the rows divide: as data.yaml says, or so that keypoints lie in their boxes.

    Raises:
        UserError: no division fits, or not that of data.yaml.
    """
    shortest, longest = int(labels.length.min()), int(labels.length.max())
    if told.shape is not None:
        count, size = told.shape
        if not 0 <= shortest - 5 - count * size <= longest - 5 - count * size <= 2:
            raise UserError(
                f"{path}: rows have {shortest} numbers, but {told.path} says kpt_shape [{count}, {size}]: expected "
                f"{5 + count * size}, and up to two more (confidence, track)."
            )
    else:
        count, size = _divided(path, labels, shortest, longest)
        parts = "x, y, v" if size == 3 else "x, y"
        notes.append(
            f"no data.yaml with kpt_shape beside the labels or above: rows of {shortest} numbers are read as {count} "
            f"keypoints of {parts}"
        )
    end = 5 + count * size
    values = labels.values[:, 5:end].reshape(len(labels.values), count, size)
    flags = size == 2 or bool(np.isin(values[..., 2], (0, 1, 2)).all())
    return RowLayout(count, values, longest > end or not flags, _tracks(labels.values[:, end:]))


def _divided(path: Path, labels: Labels, shortest: int, longest: int) -> tuple[int, int]:
    """Return the number of keypoints and of their numbers for which most keypoints lie in their boxes."""
    best: tuple[float, int, int] = (0.0, 0, 0)
    for extra in (0, 1, 2):
        for size in (3, 2):
            count, rest = divmod(shortest - 5 - extra, size)
            if rest or count < 1 or longest - 5 - count * size > 2:
                continue
            inside = _share_inside(labels, count, size)
            if inside > best[0] + 0.02:
                best = (inside, count, size)
    if best[0] < 0.5:
        raise UserError(
            f"{path}: rows of {shortest} numbers do not divide into keypoints that lie in their boxes (outlines of "
            "objects?). Put the data.yaml with kpt_shape beside the labels or above them."
        )
    return best[1], best[2]


def _share_inside(labels: Labels, count: int, size: int) -> float:
    values = labels.values[:10_000, 5 : 5 + count * size].reshape(-1, count, size)
    if size == 3 and not ((values[..., 2] >= 0) & ((values[..., 2] <= 1) | (values[..., 2] == 2))).all():
        return 0.0
    centre, side = labels.boxes[:10_000, None, 1:3], labels.boxes[:10_000, None, 3:5]
    inside = np.all(np.abs(values[..., :2] - centre) <= 0.6 * side + 0.01, axis=-1)
    given = np.any(values[..., :2] != 0, axis=-1)
    return float(inside[given].mean()) if given.any() else 0.0


def _tracks(extra: np.ndarray) -> np.ndarray | None:
    """Return the tracks among the up to two columns behind the keypoints; the other is the box's confidence."""
    if extra.shape[1] == 0:
        return None
    last = extra[:, -1]
    known = np.isfinite(last)
    if not known.any() or (last[known] != np.floor(last[known])).any() or (last[known] < 0).any():
        return None
    return np.where(known, np.where(known, last, 0).astype(np.int64).astype(str), "")


def read_rows(path: Path, files: list[Path]) -> Labels:
    """Return the rows of all files; they may differ in what follows the keypoints.

    Raises:
        UserError: text that is no row of a label, or rows with different numbers of keypoints.
    """
    labels = Labels()
    by_length: dict[int, Numbers] = {}
    lengths: list[int] = []
    for number, file in enumerate(files):
        for line, text in enumerate(_text(file).splitlines()):
            if text.strip():
                where = f"{file}, line {line + 1}"
                values = _numbers(text, where)
                by_length.setdefault(len(values), Numbers("keypoints")).add(values, where)
                lengths.append(len(values))
                labels.file.append(number)
                labels.line.append(line)
    if not lengths:
        raise UserError(f"{path}: all {len(files):,} label files are empty.")
    labels.length = np.array(lengths)
    if max(by_length) - min(by_length) > 2:
        few = min(by_length, key=lambda length: by_length[length].rows)
        others = ", ".join(str(length) for length in sorted(by_length)[:10] if length != few)
        raise UserError(
            f"{_place(files, labels, labels.length == few)} has {few} numbers, other rows {others}. Expected the "
            "same keypoints in every row."
        )
    labels.values = np.full((len(lengths), max(by_length)), np.nan, np.float32)
    for length, table in by_length.items():
        labels.values[labels.length == length, :length] = table.array()
    labels.boxes = labels.values[:, :5]
    kind = labels.boxes[:, 0]
    wrong = ~np.all(np.isfinite(labels.boxes), axis=1) | (kind < 0) | (kind != np.floor(kind))
    if wrong.any():
        raise UserError(
            f"{_place(files, labels, wrong)} begins {labels.boxes[wrong][0].tolist()}, expected a class (a whole "
            "number from 0 up) and a box of four shares of the image."
        )
    return labels


def _place(files: list[Path], labels: Labels, rows: np.ndarray) -> str:
    first = int(np.flatnonzero(rows)[0])
    return f"{files[labels.file[first]]}, line {labels.line[first] + 1}"


def _numbers(text: str, where: str) -> list[float]:
    try:
        values = list(map(float, text.split()))
    except ValueError:
        raise UserError(f"{where}: {text[:40]!r} are not numbers, expected class, box, keypoints.") from None
    if len(values) < 7:
        raise UserError(f"{where} has {len(values)} numbers: no keypoints after class and box, only an object?")
    return values


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{file} cannot be read as text: {error}") from None
