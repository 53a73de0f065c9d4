"""Who is who from frame to frame, where a tracker lists bodies without naming them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

__all__ = ["link_bodies"]

_FAR = 1.0
"""Mean distance of joints, in sizes of the body, beyond which two frames show different bodies."""
_LONGEST_GAP = 10


def link_bodies(
    keypoints: Float[np.ndarray, "rows joints 2"],
    confidence: Float[np.ndarray, "rows joints"],
    frame: np.ndarray,
) -> np.ndarray:
    """Return (rows,) numbers of bodies, the same for one body in all frames of one video.

    Bodies of a frame are paired with those last seen, in the ten frames before it, so that the mean
    distance of their visible joints, in sizes of the body, is least over all of them (the assignment
    of Kuhn 1955); a body farther than its own size from all is a new one. Rows come in any order.
    """
    from scipy.optimize import linear_sum_assignment

    seen = np.isfinite(keypoints).all(-1) & (confidence > 0)
    size = _sizes(keypoints, seen)
    body = np.zeros(len(frame), np.int64)
    order = np.argsort(frame, kind="stable")
    starts = np.flatnonzero(np.diff(frame[order], prepend=frame[order][:1] - 1))
    last: dict[int, int] = {}  # body -> the row it was last seen in
    bodies = 0
    for rows in np.split(order, starts[1:]) if len(order) else []:
        known = [one for one, row in last.items() if frame[rows[0]] - frame[row] <= _LONGEST_GAP]
        if len(known) == len(rows) == 1:  # the usual case, without the price of the general one
            pairs = [(0, 0)]
        elif known:
            cost = _distances(keypoints, seen, size, rows, [last[one] for one in known])
            pairs = list(zip(*linear_sum_assignment(np.minimum(cost, 10 * _FAR)), strict=True))
            pairs = [(row, one) for row, one in pairs if cost[row, one] <= _FAR]
        else:
            pairs = []
        if len(known) == len(rows) == 1 and _distances(keypoints, seen, size, rows, [last[known[0]]])[0, 0] > _FAR:
            pairs = []
        given = dict(pairs)
        for place, row in enumerate(rows.tolist()):
            if place in given:
                body[row] = known[given[place]]
            else:
                body[row], bodies = bodies, bodies + 1
            last[int(body[row])] = row
    return body


def _sizes(keypoints: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return (rows,) the larger side of the box around each body's visible joints, px."""
    low = np.where(seen[..., None], keypoints, np.inf).min(1)
    high = np.where(seen[..., None], keypoints, -np.inf).max(1)
    side = (high - low).max(-1)
    return np.where(np.isfinite(side) & (side > 0), side, 1.0)


def _distances(
    keypoints: np.ndarray, seen: np.ndarray, size: np.ndarray, rows: np.ndarray, before: list[int]
) -> np.ndarray:
    """Return (rows, before) mean distances of the joints that both show, in sizes; far where they share none."""
    both = seen[rows][:, None] & seen[before][None]
    apart = np.where(both[..., None], keypoints[rows][:, None] - keypoints[before][None], 0)
    mean = np.linalg.norm(apart, axis=-1).sum(-1) / np.maximum(both.sum(-1), 1)
    mean = mean / np.maximum(size[rows][:, None], size[before][None])
    return np.where(both.any(-1), mean, 10 * _FAR)
