"""Read tables whose joints stand side by side: one row a frame, or a frame and an individual."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.readers.csv_columns import Columns, Joint
from uplift.readers.csv_identity import identity_of, told_apart
from uplift.readers.table_rows import confidence_of, rows_of
from uplift.readers.table import Table

__all__ = ["as_scores", "read_wide"]


def read_wide(path: Path, columns: Columns, notes: tuple[str, ...] = ()) -> PoseData:
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
    scores = as_scores(scores, joints)
    found = identity_of(table, columns)
    names = tuple(columns.joints)
    told_apart(found, keypoints, confidence_of(path, keypoints, scores), table, table.lines)
    return rows_of(
        path,
        keypoints[:, None],
        None if scores is None else scores[:, None],
        names,
        found.values,
        fps=found.fps,
        image_size=found.image_size,
        notes=(*notes, *found.notes),
    )


def as_scores(scores: np.ndarray | None, joints: list[Joint]) -> np.ndarray | None:
    """Return COCO's visibility (2 visible, 1 hidden but labelled, 0 missing) as scores, others as they are."""
    if scores is None or not all(joint.visibility for joint in joints):
        return scores
    if scores.max(initial=0, where=~np.isnan(scores)) == 2 and np.isin(scores[~np.isnan(scores)], (0, 1, 2)).all():
        return scores / 2
    return scores
