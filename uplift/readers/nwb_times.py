"""From time stamps of samples to numbers of frames."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

__all__ = ["frame_numbers"]

_NEAR = 0.2
"""Share of the step between frames that time stamps may be off a whole number of steps."""
_DRIFT = 0.02
"""The same of a long gap, a share of its length."""
_EXACT = 1e-3


def frame_numbers(
    stamps: Float[np.ndarray, "stamps"],
) -> tuple[Int[np.ndarray, "stamps"], float | None, bool]:
    """Return (stamps,) frame numbers of rising time stamps, their step in seconds, and whether they are even.

    A wait of several steps is a gap of as many frames. Where the first stamp is a whole number of
    steps after 0, frames are counted from time 0, otherwise from the first stamp. Uneven stamps are
    numbered one after another, and have no step.
    """
    if len(stamps) < 2:
        return np.zeros(len(stamps), np.int64), None, True
    waits = np.diff(stamps)
    step = float(np.sort(waits)[(len(waits) - 1) // 2])
    for _ in range(2):  # the second time by the mean step, which jitter moves less
        with np.errstate(over="ignore"):
            counts = np.rint(np.minimum(waits / step, 2**40))
        if (counts < 1).any() or counts.sum() >= 2**40:
            return np.arange(len(stamps), dtype=np.int64), None, False
        step = float((stamps[-1] - stamps[0]) / counts.sum())
    off = np.abs(waits / step - counts)
    if (off > np.maximum(_NEAR, _DRIFT * counts)).any():
        return np.arange(len(stamps), dtype=np.int64), None, False
    first = stamps[0] / step
    known = 0 <= first < 2**40 and abs(first - np.rint(first)) < _EXACT and (off < _EXACT).all()
    return np.append(0, np.cumsum(counts)).astype(np.int64) + int(np.rint(first) if known else 0), step, True
