"""Who is who from frame to frame, where a tracker lists bodies without naming them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["link_bodies"]

_FAR = 1.0
"""Mean distance of joints, in sizes of the body, beyond which two frames show different bodies."""
_LONGEST_GAP = 10
_ALIKE = 1e-6
_BLOCK = 20_000


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
    body[order] = _followed(bodies, order, starts, frame[order[starts]])
    return body


def _followed(bodies: _Bodies, order: np.ndarray, starts: np.ndarray, times: np.ndarray) -> list[int]:
    """Return the number of the body of each row of ``order``, whose frames begin at ``starts``, at ``times``."""
    obvious, same = bodies.obvious(order, starts, times)
    bounds, whens, sames = [*starts.tolist(), len(order)], times.tolist(), same.tolist()
    found: list[int] = []
    here: list[int] = []  # the bodies of the frame before
    gone: dict[int, tuple[int, int]] = {}  # others of the last frames -> row and time when last seen
    count = 0
    for number, clear in enumerate(obvious.tolist()):
        start, end, now = bounds[number], bounds[number + 1], whens[number]
        if gone:
            gone = {one: last for one, last in gone.items() if now - last[1] <= _LONGEST_GAP}
        if clear and not gone:
            here = [here[place] for place in sames[start:end]]
            found += here
            continue
        if number and now - whens[number - 1] <= _LONGEST_GAP:
            before = order[start - len(here) : start].tolist()
            gone |= {one: (row, whens[number - 1]) for one, row in zip(here, before, strict=True)}
        known = sorted(gone)
        pairs = bodies.paired(order[start:end], np.array([gone[one][0] for one in known], np.int64))
        new = [place for place in range(end - start) if place not in pairs]
        fresh = dict(zip(new, range(count, count + len(new)), strict=True))
        here = [fresh[place] if place in fresh else known[pairs[place]] for place in range(end - start)]
        count += len(new)
        gone = {one: last for one, last in gone.items() if one not in here}
        found += here
    return found


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

    def obvious(self, order: np.ndarray, starts: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (frames,) which frames have the bodies of the frame before, each nearest to its own, and whose each row is.

        Where the nearest of all are different bodies, no other assignment can cost as little. The
        second has for each row of ``order`` the place of its body in the frame before.
        """
        size = np.diff(np.append(starts, len(order)))
        found, same = np.zeros(len(starts), bool), np.zeros(len(order), np.int64)
        alike = (size[1:] == size[:-1]) & (np.diff(times) <= _LONGEST_GAP)
        for count in np.unique(size[1:][alike]).tolist():
            frames = np.flatnonzero(alike & (size[1:] == count)) + 1
            for part in np.array_split(frames, -(-len(frames) * count**2 // _BLOCK)):
                rows = starts[part, None] + np.arange(count)
                before = np.broadcast_to(order[rows - count][:, None], (len(part), count, count))
                now = np.broadcast_to(order[rows][:, :, None], before.shape)
                cost = self.apart(now.ravel(), before.ravel()).reshape(before.shape)
                nearest = cost.argmin(2)
                least = np.sort(cost, 2)
                clear = (least[..., 0] <= _FAR).all(1) & (np.sort(nearest, 1) == np.arange(count)).all(1)
                if count > 1:  # of two as near as each other, neither is obvious
                    clear &= (least[..., 1] - least[..., 0] > _ALIKE).all(1)
                found[part], same[rows] = clear, nearest
        return found, same

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
