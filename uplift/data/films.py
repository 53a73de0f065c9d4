"""Whether the frames of a sequence are a film: whether each is much like the one before it."""

from __future__ import annotations

import numpy as np

from uplift.data.container import PoseData

__all__ = ["JUMP", "jump_of"]

JUMP = 0.3
"""Frames that mostly move by more than this, in sizes of the body, are no film: each was seen by a camera of its own."""
_MOST_ROWS, _MOST_PAIRS = 200_000, 20_000


def jump_of(data: PoseData) -> float:
    """Return the median over neighbours in time of how far joints move about the body's middle, in sizes of the body; 0 without any."""
    data = data.select(slice(0, _MOST_ROWS)) if len(data) > _MOST_ROWS else data
    order = data.in_order()
    ordered = data if (np.diff(order) > 0).all() else data.select(order)
    later = np.flatnonzero(ordered.follows())
    if "frame" not in ordered.identity or not len(later):
        same = ordered.clips()
        later = np.flatnonzero(same[1:] == same[:-1]) + 1
    later = later[:: max(1, len(later) // _MOST_PAIRS)]
    if not len(later):
        return 0.0
    one, other = (ordered.keypoints[rows].astype(np.float64) for rows in (later - 1, later))
    both = (ordered.confidence[later - 1] > 0) & (ordered.confidence[later] > 0)
    weight = (both / np.maximum(both.sum(1, keepdims=True), 1))[..., None]
    one, other = (points - (points * weight).sum(1, keepdims=True) for points in (one, other))
    size = np.sqrt((weight[..., 0] * (one**2).sum(-1)).sum(1))
    moved = (weight[..., 0] * np.linalg.norm(other - one, axis=-1)).sum(1)
    usable = (both.sum(1) >= 3) & (size > 0)
    return float(np.median(moved[usable] / size[usable])) if usable.any() else 0.0
