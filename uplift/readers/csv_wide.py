"""Read tables whose joints stand side by side: one row a frame, or a frame and an individual."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.readers.csv_columns import Columns
from uplift.readers.csv_identity import identity_of, told_apart
from uplift.readers.rows import seen_by_flag
from uplift.readers.table import Table
from uplift.readers.table_rows import confidence_of, rows_of

__all__ = ["Named", "read_wide"]

Named = Callable[[Sequence[str]], tuple[Sequence[str], Sequence[str]]]
"""Makes joint names of those that a file has, and notes that say how."""


def read_wide(path: Path, columns: Columns, named: Named, notes: tuple[str, ...] = ()) -> PoseData:
    """Read a table of the ``columns``; ``notes`` come first in those of the result.

    Raises:
        UserError: as `Table.read`, `identity_of`, `told_apart` and `rows_of`.
    """
    joints = list(columns.joints.values())
    scored = all(joint.score is not None for joint in joints)
    some = any(joint.score is not None for joint in joints)
    places = [place for joint in joints for place in (joint.x, joint.y, *((joint.score,) if scored else ()))]
    extra = [joint.score for joint in joints if joint.score is not None] if some and not scored else []
    exact = [place for place in (columns.frame, columns.time, *columns.size.values()) if place is not None]
    table = Table.read(path, 1, [*places, *extra], exact, list(columns.identity.values()))
    values = table.numbers[:, : len(places)].reshape(len(table), len(joints), -1)
    keypoints = np.ascontiguousarray(values[..., :2])
    scores = values[..., 2] if scored else None
    if extra:  # joints without a score are as sure as they are there
        scores = np.ones(keypoints.shape[:2], np.float32)
        scores[:, [at for at, joint in enumerate(joints) if joint.score is not None]] = table.numbers[:, len(places) :]
    found = identity_of(table, columns)
    if scores is not None and all(joint.visibility for joint in joints):
        scores = seen_by_flag(scores, found.notes)
    names, told = named(list(columns.joints))
    told_apart(found, keypoints, confidence_of(path, keypoints, scores), table, table.lines)
    return rows_of(
        path,
        keypoints[:, None],
        None if scores is None else scores[:, None],
        names,
        found.values,
        fps=found.fps,
        image_size=found.image_size,
        notes=(*notes, *told, *found.notes),
    )
