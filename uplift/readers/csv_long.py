"""Read tables with one row for each joint of each frame."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.csv_columns import Columns
from uplift.readers.csv_identity import bodies_of, identity_of
from uplift.readers.csv_wide import Named, Rated
from uplift.readers.rows import seen_by_flag
from uplift.readers.table import Table
from uplift.readers.table_rows import by_appearance

__all__ = ["read_long"]


def read_long(
    path: Path, columns: Columns, named: Named, notes: Sequence[str] = (), rated: Rated | None = None
) -> PoseData:
    """Read a table of the ``columns``; ``notes`` come first in those of the result.

    Raises:
        UserError: a joint twice in one frame; as `Table.read`, `identity_of` and `bodies_of`.
    """
    assert columns.name is not None
    joint = columns.joints[""]
    places = [place for place in (joint.x, joint.y, joint.score) if place is not None]
    exact = [place for place in (columns.frame, columns.time, *columns.facts.values()) if place is not None]
    table = Table.read(path, 1, places, exact, [columns.name, *columns.identity.values()])
    found = identity_of(table, columns)
    keys = [found.values[key] for key in found.values if key not in ("action", "category")]
    group, first = by_appearance(keys, len(table))
    names, of = _joints(table, columns.name)
    place = group * len(names) + of
    if len(place) > 1 and np.bincount(place).max() > 1:
        _say_twice(table, place, names, of, found.values.get("frame"))
    values = np.full((len(first) * len(names), len(places)), np.nan, np.float32)
    values[place] = table.numbers
    values = values.reshape(len(first), len(names), -1)
    keypoints = np.ascontiguousarray(values[..., :2])
    scores = values[..., 2] if joint.score is not None else None
    if scores is not None and joint.visibility:
        scores = seen_by_flag(scores, found.notes)
    if rated is not None:
        scores = rated(scores, keypoints)
    found.values = {key: value[first] for key, value in found.values.items()}
    joints, told = named(names)
    return bodies_of(path, found, keypoints, scores, joints, (*notes, *told), table.lines[first])


def _joints(table: Table, column: int) -> tuple[list[str], np.ndarray]:
    """Return joint names in the file's order, numbers in their own, and (rows,) which is whose."""
    words = table.words[column]
    names = words.names
    if "" in names:
        line = table.lines[int(np.argmax(words.codes == names.index("")))]
        raise UserError(f"{table.path}, line {line}: no name of a joint.")
    if all(re.fullmatch(r"\d{1,9}", name) for name in names):
        order = sorted(range(len(names)), key=lambda at: int(names[at]))
        rank = np.empty(len(names), np.int64)
        rank[order] = np.arange(len(names))
        return [names[at] for at in order], rank[words.codes]
    return names, words.codes.astype(np.int64)


def _say_twice(table: Table, place: np.ndarray, names: list[str], of: np.ndarray, frame: np.ndarray | None) -> None:
    order = np.argsort(place, kind="stable")
    at = int(np.flatnonzero(np.diff(place[order]) == 0)[0])
    one, two = int(order[at]), int(order[at + 1])
    where = "" if frame is None else f" of frame {frame[two]}"
    raise UserError(
        f"{table.path}, line {table.lines[two]}: '{names[of[two]]}'{where} is there twice (first on line "
        f"{table.lines[one]}). Several bodies need a column 'individual' that tells them apart, frames one 'frame'."
    )
