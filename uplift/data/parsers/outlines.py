"""Masks from run lengths, which COCO writes as lists of counts or packed into text, and from polygons."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int64

__all__ = [
    "MAX_PIXELS", "counts_of_text", "pixels_of_polygons", "pixels_of_runs", "window_of_polygons", "window_of_runs",
]  # fmt: skip

MAX_PIXELS = 100_000_000
_MOST_DIGITS = 6
"""Of 5 bits each: more than any picture has pixels."""


def counts_of_text(text: str) -> Int64[np.ndarray, " runs"]:
    """Return the run lengths in a text of COCO's compressed form.

    Each number is in digits of 5 bits, the lowest first, a character each: its code less 48 has the digit, and in
    bit 5 whether more follow; bit 4 of the last digit is the sign. From the fourth number on they are differences
    to the number two before (COCO API, maskApi.c, rleToString).

    Raises:
        ValueError: not such a text.
    """
    codes = np.frombuffer(text.encode("ascii"), np.uint8).astype(np.int64) - 48
    if codes.size == 0 or codes.min() < 0 or codes.max() > 63:
        raise ValueError("characters that are not of run lengths")
    ends = np.flatnonzero(codes & 32 == 0)
    if len(ends) == 0 or ends[-1] != len(codes) - 1:
        raise ValueError("cut short")
    starts = np.concatenate([[0], ends[:-1] + 1])
    digits = ends - starts + 1
    if digits.max() > _MOST_DIGITS:
        raise ValueError("a run longer than any picture")
    place = np.arange(len(codes)) - np.repeat(starts, digits)
    counts = np.add.reduceat((codes & 31) << 5 * place, starts)
    counts -= np.where(codes[ends] & 16, 1 << 5 * digits, 0)
    counts[1::2] = np.cumsum(counts[1::2])
    counts[2::2] = np.cumsum(counts[2::2])
    return counts


def window_of_runs(
    counts: Any, size: Any
) -> tuple[Bool[np.ndarray, "height width"], tuple[int, int], tuple[int, int]] | None:
    """Return the columns of a mask that have something in them, the window's corner (x, y), and the image's size (width, height); None where it is empty.

    Runs go down the columns, from left to right, and take turns, those that are not covered first. ``counts`` is a
    list or text, ``size`` [height, width]. No more memory is taken than the image has pixels.

    Raises:
        ValueError: not run lengths, or more than the image has pixels.
        OverflowError: an image of more than `MAX_PIXELS`.
    """
    starts, stops, first, last = _columns_of_runs(counts, size)
    if first == last:
        return None
    height, width = size
    full = starts < stops
    marks = np.zeros((last - first) * height + 1, np.int8)
    np.add.at(marks, starts[full] - first * height, 1)
    np.add.at(marks, stops[full] - first * height, -1)
    mask = np.cumsum(marks[:-1], dtype=np.int8).reshape(last - first, height).T.astype(bool)
    return mask, (first, 0), (width, height)


def _columns_of_runs(counts: Any, size: Any) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Return where covered runs start and stop, and the first and the end of the columns that they are in."""
    if not (isinstance(size, list | tuple) and len(size) == 2 and all(type(one) is int and one > 0 for one in size)):
        raise ValueError("size is not a height and width")
    height, width = size
    if height * width > MAX_PIXELS:
        raise OverflowError("too many pixels")
    runs = counts_of_text(counts) if isinstance(counts, str) else _whole_numbers(counts)
    if len(runs) and (runs.min() < 0 or runs.max() > MAX_PIXELS):
        raise ValueError("a run of no length")
    if runs.sum() > height * width:
        raise ValueError("longer than the image")
    ends = np.cumsum(runs)
    starts, stops = ends[:-1:2], ends[1::2]  # those that are covered
    full = starts < stops
    if not full.any():
        return starts, stops, 0, 0
    return starts, stops, int(starts[full][0]) // height, (int(stops[full][-1]) - 1) // height + 1


def pixels_of_runs(counts: Any, size: Any) -> int:
    """Return how many pixels `window_of_runs` looks at; raises as it does."""
    _, _, first, last = _columns_of_runs(counts, size)
    return (last - first) * size[0]


def _whole_numbers(counts: Any) -> np.ndarray:
    if not isinstance(counts, list) or not all(type(one) is int and 0 <= one <= MAX_PIXELS for one in counts):
        raise ValueError("counts are not a list of whole numbers")
    return np.array(counts, np.int64)


# Polygons as masks: a pixel is covered where its centre is inside.

_MAX_CROSSINGS = 4_000_000
"""Of outlines and rows of pixels; an outline along every pixel of a photo has fewer."""
_CROSSING = 10
"""Pixels that take as long as one crossing."""


def window_of_polygons(
    polygons: list[Float[np.ndarray, "_ 2"]], image_size: tuple[int, int] | None
) -> tuple[Bool[np.ndarray, "height width"], tuple[int, int]] | None:
    """Return what polygons (px, x right, y down from the image's corner) cover together, in a window around them, and that window's corner (x, y); None where they cover no pixel.

    Raises:
        OverflowError: windows, or outlines, that are too large.
    """
    pixels_of_polygons(polygons, image_size)
    low, high = _box(np.concatenate(polygons), image_size)
    if (high <= low).any():
        return None
    width, height = (int(one) for one in high - low)
    if width * height > MAX_PIXELS:
        raise OverflowError("too many pixels")
    mask = np.zeros((height, width), bool)
    for polygon in polygons:
        corner, end = _box(polygon, image_size)
        if (end > corner).all():
            left, top, right, bottom = (*(corner - low).tolist(), *(end - low).tolist())
            mask[top:bottom, left:right] |= _inside(polygon - corner, bottom - top, right - left)
    return (mask, (int(low[0]), int(low[1]))) if mask.any() else None


def pixels_of_polygons(polygons: list[Float[np.ndarray, "_ 2"]], image_size: tuple[int, int] | None) -> int:
    """Return how many pixels `window_of_polygons` looks at, one polygon after the other; raises as it does."""
    pixels = crossings = 0
    for polygon in polygons:
        low, high = _box(polygon, image_size)
        width, height = (int(one) for one in np.maximum(high - low, 0))
        above, below = _rows_of(polygon - low, height)
        crossings += int(np.maximum(below - above, 0).sum())
        pixels += width * height
    if pixels > MAX_PIXELS:
        raise OverflowError("too many pixels")
    if crossings > _MAX_CROSSINGS:
        raise OverflowError("too long an outline")
    return pixels + _CROSSING * crossings


def _box(corners: Float[np.ndarray, "corners 2"], image_size: tuple[int, int] | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the corner (x, y) of the pixels around points, inside the image, and their other corner."""
    most = np.array(image_size or (2**31, 2**31), np.float64)
    low = np.clip(np.floor(corners.min(0)), 0, most).astype(np.int64)
    return low, np.clip(np.ceil(corners.max(0)), 0, most).astype(np.int64)


def _rows_of(polygon: Float[np.ndarray, "corners 2"], height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first row and the end of the rows whose middles each edge crosses."""
    start, end = polygon[:, 1], np.roll(polygon[:, 1], -1)
    above = np.clip(np.ceil(np.minimum(start, end) - 0.5), 0, height).astype(np.int64)
    return above, np.clip(np.ceil(np.maximum(start, end) - 0.5), 0, height).astype(np.int64)


def _inside(polygon: Float[np.ndarray, "corners 2"], height: int, width: int) -> Bool[np.ndarray, "height width"]:
    """Return the pixels whose centres are inside by the even-odd rule: those with an odd number of edges to their left."""
    start, end = polygon, np.roll(polygon, -1, 0)
    above, below = _rows_of(polygon, height)
    crossed = np.maximum(below - above, 0)
    edge = np.repeat(np.arange(len(start)), crossed)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(crossed) - crossed, crossed) + above[edge]
    (x0, y0), (x1, y1) = start[edge].T, end[edge].T
    x = x0 + (row + 0.5 - y0) / (y1 - y0) * (x1 - x0)
    column = np.clip(np.ceil(x - 0.5), 0, width).astype(np.int64)
    turns = np.zeros((height, width + 1), np.uint8)
    np.bitwise_xor.at(turns, (row, column), 1)
    return np.bitwise_xor.accumulate(turns[:, :-1], axis=1).astype(bool)
