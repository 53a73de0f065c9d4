"""What the writers of text share: numbers as text, identities as plain values, keypoints that were seen."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.prediction import Prediction

__all__ = ["NUMBER", "filled_in", "numbers", "parts", "plain", "seen_keypoints"]

NUMBER = {"place": "%.7g", "px": "%.6g", "share": "%.4g"}
"""How numbers are rounded: places to the seven digits of a 32-bit number, pixels to six, confidence to four."""
_ROWS = 256


def plain(values: np.ndarray) -> list[Any]:
    """Return numbers and texts as Python has them, None for what is not a number; anything else as its text."""
    return [_plain(value) for value in np.asarray(values).tolist()]


def _plain(value: Any) -> Any:
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def seen_keypoints(prediction: Prediction) -> Float[np.ndarray, "frames joints 2"]:
    """Return the keypoints, px, NaN where a joint was not seen."""
    seen = np.isfinite(prediction.keypoints).all(-1) & (prediction.confidence > 0)
    return np.where(seen[..., None], prediction.keypoints, np.nan)


def parts(prediction: Prediction) -> Iterator[Prediction]:
    """Yield the frames in parts small enough to be held as text."""
    for start in range(0, len(prediction), _ROWS):
        yield prediction.select(np.arange(start, min(start + _ROWS, len(prediction))))


def numbers(*columns: np.ndarray) -> list[tuple[float, ...]]:
    """Return the numbers of each frame out of arrays (frames ...), in their order; what is not finite is NaN."""
    rows = np.concatenate([column.reshape(len(column), -1).astype(np.float64) for column in columns], 1)
    rows = np.where(np.isfinite(rows), rows, np.nan) + 0.0  # + 0.0: -0 is written 0
    return list(map(tuple, rows.tolist()))


def filled_in(template: str, row: tuple[float, ...], missing: str) -> str:
    """Return ``template`` with the numbers of ``row`` in their places, ``missing`` where one is NaN."""
    text = template % row
    return text.replace("nan", missing) if "nan" in text else text
