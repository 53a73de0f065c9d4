"""Masks as run lengths, COCO's two ways: lists of counts, and counts packed into text."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Int64

__all__ = ["MAX_PIXELS", "counts_of_text", "window_of_runs"]

MAX_PIXELS = 100_000_000
_MOST_DIGITS = 6
"""Of 5 bits each: more than any picture has pixels."""


def counts_of_text(text: str) -> Int64[np.ndarray, " runs"]:
    """Return the run lengths in a text of COCO's compressed form.

    Each number is in digits of 5 bits, the lowest first, a character each: its code less 48 has the digit, and in
    bit 5 whether more follow; bit 4 of the last digit is the sign. From the fourth number on they are differences
    to the number two before (COCO API, maskApi.c, rleToString).

    Raises:
        ValueError: no such text.
    """
    codes = np.frombuffer(text.encode("ascii"), np.uint8).astype(np.int64) - 48
    if codes.size == 0 or codes.min() < 0 or codes.max() > 63:
        raise ValueError("characters that no run length has")
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
        ValueError: no run lengths, or more than the image has pixels.
        OverflowError: an image of more than `MAX_PIXELS`.
    """
    if not (isinstance(size, list | tuple) and len(size) == 2 and all(type(one) is int and one > 0 for one in size)):
        raise ValueError("size is no height and width")
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
        return None
    first, last = int(starts[full][0]) // height, (int(stops[full][-1]) - 1) // height + 1
    marks = np.zeros((last - first) * height + 1, np.int8)
    np.add.at(marks, starts[full] - first * height, 1)
    np.add.at(marks, stops[full] - first * height, -1)
    mask = np.cumsum(marks[:-1], dtype=np.int8).reshape(last - first, height).T.astype(bool)
    return mask, (first, 0), (width, height)


def _whole_numbers(counts: Any) -> np.ndarray:
    if not isinstance(counts, list) or not all(type(one) is int and 0 <= one <= MAX_PIXELS for one in counts):
        raise ValueError("counts are no list of whole numbers")
    return np.array(counts, np.int64)
