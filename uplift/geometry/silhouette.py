"""Silhouettes of triangles: which pixels they cover, and how much of each."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

__all__ = ["cover", "draw_mask", "project"]

_FINER = 4
"""Samples along a pixel's side: 16 a pixel."""
_SPANS = 1 << 22
"""Rows of triangles that are in memory at a time."""


def draw_mask(
    points: Float[np.ndarray, "vertices 2"], faces: Int[np.ndarray, "faces 3"], side: int
) -> UInt8[np.ndarray, "side side"]:
    """Return how much of each pixel the triangles cover, 0..255, of 16 samples a pixel.

    Points are in pixels of the mask: x right, y down, pixel i reaches from i to i + 1. Any winding;
    what is outside the mask is cut off.
    """
    covered = cover(np.asarray(points, float) * _FINER, faces, side * _FINER)
    counts = covered.reshape(side, _FINER, side, _FINER).sum((1, 3))
    return (counts * 255 / _FINER**2 + 0.5).astype(np.uint8)


def cover(
    points: Float[np.ndarray, "vertices 2"], faces: Int[np.ndarray, "faces 3"], side: int
) -> Bool[np.ndarray, "side side"]:
    """Return the pixels whose centre a triangle covers; points as `draw_mask` has them."""
    points, width = np.asarray(points, float), side + 1
    change = np.zeros(side * width, np.int64)
    block = max(1, _SPANS // side)  # a triangle has a span in each row at most
    for start in range(0, len(faces), block):
        starts, ends, rows = _spans(points[faces[start : start + block]], side)
        change += np.bincount(rows * width + starts, minlength=side * width)
        change -= np.bincount(rows * width + ends, minlength=side * width)
    # A sample is covered where more spans of its row have begun than have ended.
    return np.cumsum(change.reshape(side, width), 1)[:, :-1] > 0


def _spans(corners: np.ndarray, fine: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return first sample, last + 1 and row of each triangle's spans; samples lie at integers + 1/2."""
    y = corners[..., 1]
    first = np.clip(np.ceil(y.min(1) - 0.5), 0, fine).astype(np.int64)
    count = np.clip(np.ceil(y.max(1) - 0.5), 0, fine).astype(np.int64) - first
    of = np.repeat(np.arange(len(corners)), np.maximum(count, 0))
    rows = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count) + first[of]
    middle = rows + 0.5
    low, high = np.full(len(of), np.inf), np.full(len(of), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start, end = corners[:, a], corners[:, b]
        rise = end[:, 1] - start[:, 1]
        slope = (end[:, 0] - start[:, 0]) / np.where(rise == 0, 1, rise)
        crosses = (start[of, 1] <= middle) != (end[of, 1] <= middle)
        x = start[of, 0] + (middle - start[of, 1]) * slope[of]
        np.minimum(low, x, out=low, where=crosses)
        np.maximum(high, x, out=high, where=crosses)
    begin = np.clip(np.ceil(np.minimum(low, fine) - 0.5), 0, fine).astype(np.int64)
    end = np.clip(np.ceil(np.maximum(high, 0) - 0.5), 0, fine).astype(np.int64)
    return begin, np.maximum(begin, end), rows


def project(
    points: Float[np.ndarray, "vertices 3"], distance: int | float | np.floating
) -> Float[np.ndarray, "vertices 2"]:
    """Return where points of the camera frame (`uplift.data.masks.Placed`: units of the crop, depth 0 at the shape's origin) are seen."""
    return points[:, :2] / (1 + points[:, 2:] / distance)
