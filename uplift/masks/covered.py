"""Which pixels of an array are the object: a threshold at half of what its numbers span."""

from __future__ import annotations

import numpy as np

from uplift.errors import UserError

__all__ = ["covered"]


def covered(mask: np.ndarray) -> np.ndarray:
    """Return (height width) bool of a mask of any type: true or false, 0 and 1, 0 to 255, a coverage from 0 to 1.

    An array of two numbers is covered where it has the larger one. Others are cut at half of 1, 255 or 65535,
    whichever is the first that they do not pass. NaN is not covered.

    Raises:
        UserError: no array of height and width, or none of numbers.
    """
    if mask.ndim != 2 or mask.dtype.kind not in "buif":
        raise UserError(f"A mask is {mask.dtype} of shape {mask.shape}, expected numbers of shape (height, width).")
    if mask.dtype == bool or mask.size == 0:
        return mask.astype(bool)
    if mask.dtype.kind == "f":
        mask = np.nan_to_num(mask, nan=0.0, posinf=0.0, neginf=0.0)
    low, high = mask.min(), mask.max()
    if low < high and ((mask == low) | (mask == high)).all():
        return mask == high
    whole = next((most for most in (1, 255, 65535) if high <= most), high)
    return mask >= whole / 2
