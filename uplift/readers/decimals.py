"""Numbers out of text, all cells of a table at once: as exact as Python's own, in a tenth of the time."""

from __future__ import annotations

import re

import numpy as np

__all__ = ["PADDING", "parse_numbers"]

PADDING = 24
"""Bytes that stand before the text, so that what comes before a number can be looked at."""
_ZEROS, _BYTES = np.uint64(0x3030303030303030), np.uint64(0x000000FF000000FF)
_TENS = 10.0 ** np.arange(23)
_WHOLE_TENS = 10 ** np.arange(19, dtype=np.int64)
_MISSING = {b"", b"nan", b"na", b"n/a", b"#n/a", b"null", b"none", b"nil", b"-", b"--", b"-nan", b"<na>"}
_NUMBER = re.compile(rb"[+-]?(\d+[.]?\d*|[.]\d+)([eE][+-]?\d{1,6})?")


def parse_numbers(text: np.ndarray, starts: np.ndarray, ends: np.ndarray, point: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells' numbers as float64, NaN for empty ones and the usual words, and the places of what is none.

    ``text`` is bytes (uint8) that begin with `PADDING`; ``point`` is the sign before decimals. Each number,
    rounded to float32, is the one that ``float`` gives; as float64 it may be the neighbour of it.
    """
    starts, ends = _without_spaces(text, starts, ends)
    first = text[starts]
    negative = first == ord("-")
    from_ = starts + (negative | (first == ord("+")))
    value, plain = _plain(text, from_, ends, point)
    np.negative(value, where=negative, out=value)
    empty = starts == ends
    value[empty] = np.nan
    bad = []
    for place in np.flatnonzero(~(plain | empty)).tolist():
        cell = text[starts[place] : ends[place]].tobytes()
        number = _one(cell, point)
        if number is None:
            bad.append(place)
        else:
            value[place] = number
    return value, np.array(bad, np.int64)


def _without_spaces(text: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not (text == 32).any():
        return starts, ends
    starts, ends = starts.copy(), ends.copy()
    while (space := (text[starts] == 32) & (starts < ends)).any():
        starts += space
    while (space := (text[ends - 1] == 32) & (starts < ends)).any():
        ends -= space
    return starts, ends


def _plain(text: np.ndarray, starts: np.ndarray, ends: np.ndarray, point: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers that are digits and at most one point, and which cells are such."""
    dot, once = _points(text, starts, ends, point)
    before = dot - starts
    after = np.maximum(ends - dot - 1, 0)
    plain = once & (before >= 0) & (before <= 8) & (after <= 22) & (before + after > 0)
    before, after = np.where(plain, before, 0), np.where(plain, after, 0)
    whole, good = _eight(text, dot, before)
    plain &= good
    share, good = _digits(text, ends, after)
    plain &= good
    # More digits than 64 bits hold are left to Python, which is right and slow.
    plain &= (after <= 18) | (whole == 0)
    plain &= whole.astype(np.float64) * _TENS[after] < 4e18
    mantissa = whole * _WHOLE_TENS[np.minimum(after, 18)] + share
    value = mantissa / _TENS[after]
    return value, plain & ~_between(value, mantissa)


def _points(text: np.ndarray, starts: np.ndarray, ends: np.ndarray, point: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where each cell's first point is, or its end where it has none, and which have no second."""
    dots = np.flatnonzero(text == point)
    if len(dots) == len(starts) and (dots >= starts).all() and (dots < ends).all():
        return dots, np.ones(len(dots), bool)
    first = np.searchsorted(dots, starts)
    dots = np.append(dots, [len(text), len(text)])
    return np.minimum(dots[first], ends), dots[np.minimum(first + 1, len(dots) - 1)] >= ends


def _between(value: np.ndarray, mantissa: np.ndarray) -> np.ndarray:
    """Return where float64 is not exact, and so near the middle of two float32 that rounding could go wrong."""
    tail = value.view(np.int64) & 0x1FFFFFFF
    return (mantissa >= 2**53) & (np.abs(tail - 0x10000000) < 8)


def _digits(text: np.ndarray, ends: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number that so many digits before ``ends`` make, and which were digits and not too many."""
    value, plain = _eight(text, ends, np.minimum(count, 8))
    factor, done, most = 10**8, 8, int(count.max(initial=0))
    while done < most:
        more, good = _eight(text, ends - done, np.clip(count - done, 0, 8))
        plain &= good
        if done == 16:
            plain &= more < 100
            more = np.where(more < 100, more, 0)
        value = value + more * factor
        factor, done = factor * 10**8, done + 8
    return value, plain


def _eight(text: np.ndarray, ends: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number that up to eight digits before ``ends`` make, and which were digits.

    Eight bytes are one integer of 64 bits, whose digits are added up in pairs, fours and eight
    (Lemire 2018, https://lemire.me/blog/2018/10/03/quickly-parsing-eight-digits).
    """
    words = np.ndarray((len(text) - 7,), "<u8", text, 0, (1,))
    others = (64 - 8 * count).view(np.uint64)
    eight = words[ends - 8]
    eight ^= _ZEROS
    eight >>= others  # by 64, NumPy makes it 0
    eight <<= others
    other = eight + np.uint64(0x7676767676767676)  # in place from here on: new arrays cost more than the sums
    other |= eight
    other &= np.uint64(0x8080808080808080)
    digits = other == 0
    np.right_shift(eight, np.uint64(8), out=other)
    eight *= np.uint64(10)
    eight += other
    np.right_shift(eight, np.uint64(16), out=other)
    eight &= _BYTES
    eight *= np.uint64(0x000F424000000064)
    other &= _BYTES
    other *= np.uint64(0x0000271000000001)
    eight += other
    eight >>= np.uint64(32)
    return eight.view(np.int64), digits


def _one(cell: bytes, point: int) -> float | None:
    """Return the number of one cell, NaN for the words that stand for a missing one, None for anything else."""
    if point != ord("."):
        cell = cell.replace(b".", b"x").replace(bytes([point]), b".")
    if _NUMBER.fullmatch(cell):
        return float(cell)
    return np.nan if cell.lower() in _MISSING else None
