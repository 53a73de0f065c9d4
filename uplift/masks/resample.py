"""A mask at another scale, with anti-aliasing: how much of each pixel of the crop the object covers."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8

__all__ = ["resample"]

_EVEN = 1e-6
"""Above a half: what is exactly between two numbers goes up, whatever the last bits of a sum say."""


def resample(
    cover: Bool[np.ndarray, "height width"] | UInt8[np.ndarray, "height width"],
    centre_px: tuple[float, float],
    scale_px: float,
    side: int,
) -> UInt8[np.ndarray, "side side"]:
    """Return a square crop of a mask: `centre_px` is its middle, `scale_px` half its side, 0 beyond the mask.

    The mask's top left corner is (0, 0), and its first pixel reaches to (1, 1). A crop pixel is the mean of what
    it sees. Where the crop is finer than the mask, the mask is interpolated, and its edges made as sharp as the
    crop allows: about half way between a pixel that is covered and one that is not.
    """
    down, first, last = _weights(cover.shape[0], centre_px[1], scale_px, side)
    across, _, _ = _weights(cover.shape[1], centre_px[0], scale_px, side)
    seen = np.zeros((side, cover.shape[1]))
    for row, (start, stop) in enumerate(zip(first, last, strict=True)):
        if start < stop:  # the mask's rows are many, those that one row of the crop sees are few
            seen[row] = down[row, start:stop] @ cover[start:stop]
    value = seen @ across.T / (1 if cover.dtype == bool else 255)
    finer = max(1.0, side / (2 * scale_px))
    value = np.clip((value - 0.5) * finer + 0.5, 0, 1)
    return np.floor(value * 255 + 0.5 + _EVEN).astype(np.uint8)


def _weights(
    length: int, centre_px: float, scale_px: float, side: int
) -> tuple[Float[np.ndarray, "side length"], np.ndarray, np.ndarray]:
    """Return the share of each of a mask's pixels in each of the crop's along one axis, and the first and the end of those it sees."""
    middle = centre_px + (2 * np.arange(side) + 1 - side) / side * scale_px
    width = max(1.0, 2 * scale_px / side)
    low, high = (middle - width / 2)[:, None], (middle + width / 2)[:, None]
    pixel = np.arange(length)
    weights = np.maximum(np.minimum(high, pixel + 1) - np.maximum(low, pixel), 0) / width
    first = np.clip(np.floor(low[:, 0]), 0, length).astype(int)
    last = np.clip(np.ceil(high[:, 0]), 0, length).astype(int)
    return weights, first, last
