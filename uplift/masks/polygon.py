"""Polygons as masks: a pixel is covered where its centre is inside."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from uplift.masks.rle import MAX_PIXELS

__all__ = ["window_of_polygons"]

_MAX_CROSSINGS = 20_000_000


def window_of_polygons(
    polygons: list[Float[np.ndarray, "_ 2"]], image_size: tuple[int, int] | None
) -> tuple[Bool[np.ndarray, "height width"], tuple[int, int]] | None:
    """Return what polygons (px, x right, y down from the image's corner) cover together, in a window around them, and that window's corner (x, y); None where they cover no pixel.

    Raises:
        OverflowError: a window, or an outline, that is too large.
    """
    corners = np.concatenate(polygons)
    most = np.array(image_size or (2**31, 2**31), np.float64)
    low = np.clip(np.floor(corners.min(0)), 0, most).astype(np.int64)
    high = np.clip(np.ceil(corners.max(0)), 0, most).astype(np.int64)
    if (high <= low).any():
        return None
    width, height = (int(one) for one in high - low)
    if width * height > MAX_PIXELS:
        raise OverflowError("too many pixels")
    mask = np.zeros((height, width), bool)
    for polygon in polygons:
        mask |= _inside(polygon - low, height, width)
    return (mask, (int(low[0]), int(low[1]))) if mask.any() else None


def _inside(polygon: Float[np.ndarray, "corners 2"], height: int, width: int) -> Bool[np.ndarray, "height width"]:
    """Return the pixels whose centres are inside by the even-odd rule: those with an odd number of edges to their left."""
    start, end = polygon, np.roll(polygon, -1, 0)
    above = np.clip(np.ceil(np.minimum(start[:, 1], end[:, 1]) - 0.5), 0, height).astype(np.int64)
    below = np.clip(np.ceil(np.maximum(start[:, 1], end[:, 1]) - 0.5), 0, height).astype(np.int64)
    crossed = np.maximum(below - above, 0)
    if crossed.sum() > _MAX_CROSSINGS:
        raise OverflowError("too long an outline")
    edge = np.repeat(np.arange(len(start)), crossed)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(crossed) - crossed, crossed) + above[edge]
    (x0, y0), (x1, y1) = start[edge].T, end[edge].T
    x = x0 + (row + 0.5 - y0) / (y1 - y0) * (x1 - x0)
    column = np.clip(np.ceil(x - 0.5), 0, width).astype(np.int64)
    turns = np.zeros((height, width + 1), np.uint8)
    np.bitwise_xor.at(turns, (row, column), 1)
    return np.bitwise_xor.accumulate(turns[:, :-1], axis=1).astype(bool)
