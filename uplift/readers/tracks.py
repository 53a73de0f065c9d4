"""Who is who from frame to frame, where a tracker lists bodies without naming them."""

from __future__ import annotations

from dataclasses import dataclass

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
    seen = np.isfinite(keypoints).all(-1) & (confidence > 0)
    bodies = _Bodies(keypoints, seen, _sizes(keypoints, seen))
    order = np.argsort(frame, kind="stable")
    starts = np.flatnonzero(np.diff(frame[order], prepend=frame[order][:1] - 1))
    body = np.zeros(len(frame), np.int64)
    if len(starts) == len(order):  # one body a frame: no assignment to solve
        new = np.ones(len(order), bool)
        new[1:] = bodies.apart(order[1:], order[:-1]) > _FAR
        new[1:] |= np.diff(frame[order]) > _LONGEST_GAP
        body[order] = np.cumsum(new) - 1
        return body
    last: dict[int, int] = {}  # body -> the row it was last seen in
    for rows in np.split(order, starts[1:]):
        known = [one for one, row in last.items() if frame[rows[0]] - frame[row] <= _LONGEST_GAP]
        same = bodies.paired(rows, np.array([last[one] for one in known], np.int64))
        for place, row in enumerate(rows.tolist()):
            body[row] = known[same[place]] if place in same else len(last)
            last[int(body[row])] = row
    return body


@dataclass(frozen=True)
class _Bodies:
    """The bodies of all rows."""

    keypoints: np.ndarray
    seen: np.ndarray
    size: np.ndarray

    def paired(self, rows: np.ndarray, before: np.ndarray) -> dict[int, int]:
        """Return which of ``before`` each of ``rows`` is, by their places; those that are new are absent."""
        from scipy.optimize import linear_sum_assignment

        cost = (
            np.stack([self.apart(rows, np.full(len(rows), one)) for one in before], 1)
            if len(before)
            else np.empty((0, 0))
        )
        pairs = zip(*(places.tolist() for places in linear_sum_assignment(cost)), strict=True)
        return {row: one for row, one in pairs if cost[row, one] <= _FAR}

    def apart(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Return mean distances, row by row, of the joints that both show, else of their middles, in sizes."""
        both = self.seen[one] & self.seen[other]
        gap = np.where(both[..., None], self.keypoints[one] - self.keypoints[other], 0)
        mean = np.linalg.norm(gap, axis=-1).sum(-1) / np.maximum(both.sum(-1), 1)
        none = ~both.any(-1)
        if none.any():
            mean[none] = np.linalg.norm(self._middle(one[none]) - self._middle(other[none]), axis=-1)
        return np.minimum(mean / np.maximum(self.size[one], self.size[other]), 10 * _FAR)

    def _middle(self, rows: np.ndarray) -> np.ndarray:
        weight = self.seen[rows][..., None]
        return np.where(weight, self.keypoints[rows], 0).sum(1) / np.maximum(weight.sum(1), 1)


def _sizes(keypoints: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return (rows,) the larger side of the box around each body's visible joints, px; at least half the usual one."""
    low = np.where(seen[..., None], keypoints, np.inf).min(1)
    high = np.where(seen[..., None], keypoints, -np.inf).max(1)
    side = (high - low).max(-1)
    known = side[np.isfinite(side) & (side > 0)]
    least = np.median(known) / 2 if len(known) else 1.0
    return np.fmax(np.where(np.isfinite(side), side, 0), least)
