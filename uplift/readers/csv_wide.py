"""Read tables whose joints stand side by side: one row a frame, or a frame and an individual."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.readers.csv_columns import Columns
from uplift.readers.csv_identity import bodies_of, identity_of
from uplift.readers.rows import seen_by_flag
from uplift.readers.table import Table

__all__ = ["Named", "Rated", "read_wide"]

Named = Callable[[Sequence[str]], tuple[Sequence[str], Sequence[str]]]
"""Makes joint names of those that a file has, and notes that say how."""
Rated = Callable[[np.ndarray | None, np.ndarray], np.ndarray | None]
"""Changes the scores (rows joints) of keypoints (rows joints 2) before they are taken as confidence."""


def read_wide(
    path: Path, columns: Columns, named: Named, notes: Sequence[str] = (), rated: Rated | None = None
) -> PoseData:
    """Read a table of the ``columns``; ``notes`` come first in those of the result.

    Raises:
        UserError: as `Table.read`, `identity_of` and `bodies_of`.
    """
    joints = list(columns.joints.values())
    scored = all(joint.score is not None for joint in joints)
    some = any(joint.score is not None for joint in joints)
    parts = [(joint.x, joint.y, joint.score if scored else None) for joint in joints]
    places = [place for one in parts for place in one if place is not None]
    extra: list[int] = [joint.score for joint in joints if joint.score is not None] if some and not scored else []
    exact = [place for place in (columns.frame, columns.time, *columns.facts.values()) if place is not None]
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
    if rated is not None:
        scores = rated(scores, keypoints)
    names, told = named(list(columns.joints))
    return bodies_of(path, found, keypoints, scores, names, (*notes, *told), table.lines)
