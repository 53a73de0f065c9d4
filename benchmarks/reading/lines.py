"""Text of many records alike, all of them at once: a template whose gaps are filled with numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["GAP", "decimals", "filled", "whole_numbers", "words"]

GAP = "\x01"
"""What stands in a template where a cell goes."""


def filled(template: str, cells: Sequence[np.ndarray]) -> bytes:
    """Return the template once a row, its gaps filled with (rows, gaps, width) bytes in the order of ``cells``.

    Each array fills as many gaps as it has; bytes of 0 are left out.
    """
    columns = [array[:, gap] for array in cells for gap in range(array.shape[1])]
    parts = template.encode().split(GAP.encode())
    if len(parts) != len(columns) + 1:
        raise ValueError(f"{len(parts) - 1} gaps, {len(columns)} cells")
    width = sum(map(len, parts)) + sum(column.shape[1] for column in columns)
    text = np.empty((len(columns[0]), width), np.uint8)
    at = 0
    for number, part in enumerate(parts):
        text[:, at : at + len(part)] = np.frombuffer(part, np.uint8)
        at += len(part)
        if number < len(columns):
            column = columns[number]
            text[:, at : at + column.shape[1]] = column
            at += column.shape[1]
    flat = text.ravel()
    return flat[flat != 0].tobytes()


def whole_numbers(values: np.ndarray, digits: int | None = None, zeros: bool = False) -> np.ndarray:
    """Return (..., digits) bytes of numbers from 0 up, with zeros in front or nothing."""
    digits = digits or len(str(int(values.max(initial=0))))
    text = np.empty((*values.shape, digits), np.uint8)
    rest = values.astype(np.int64)
    for place in range(digits - 1, -1, -1):
        rest, digit = np.divmod(rest, 10)
        text[..., place] = digit + 48
    if not zeros:
        for place in range(digits - 1):
            text[..., place][values < 10 ** (digits - 1 - place)] = 0
    return text


def decimals(
    values: np.ndarray, count: int, missing: np.ndarray | None = None, instead: str = "0.0", seed: int = 0
) -> np.ndarray:
    """Return (rows, gaps, width) bytes of numbers from 0 up with so many decimals; ``instead`` where ``missing``.

    Values have six decimals; any more are drawn, as networks' numbers go on.
    """
    known = min(count, 6)
    scaled = np.round(values * 10**known).astype(np.int64)
    whole = whole_numbers(scaled // 10**known)
    share = whole_numbers(scaled % 10**known, known, zeros=True)
    drawn = np.random.default_rng(seed).integers(48, 58, (*values.shape, count - known), np.uint8)
    point = np.full((*values.shape, 1), ord("."), np.uint8)
    text = np.concatenate([whole, point, share, drawn], -1)
    if missing is not None:
        word = np.zeros(text.shape[-1], np.uint8)
        word[: len(instead)] = np.frombuffer(instead.encode(), np.uint8)
        text[missing] = word
    return text.reshape(len(values), -1, text.shape[-1])


def words(names: Sequence[str], rows: int) -> np.ndarray:
    """Return (rows, names, width) bytes, the names in each row."""
    width = max(map(len, names))
    text = np.frombuffer(b"".join(name.encode().ljust(width, b"\0") for name in names), np.uint8)
    return np.broadcast_to(text.reshape(1, -1, width), (rows, len(names), width))
