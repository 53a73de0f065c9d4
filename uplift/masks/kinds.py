"""What a picture is: a mask of one object, labels of several, a photo, or nothing at all."""

from __future__ import annotations

import numpy as np

from uplift.masks.picture import Picture

__all__ = ["kind_of", "object_of"]

_FLAT = 0.5
"""Share of a mask's or label image's pixels that are as their four neighbours; a photo has fewer."""
_NEAR = 0.0625
"""Of the span of grey levels: as near as that to black or white is black or white."""
_EXTREME, _EXTREME_LOSSY = 0.85, 0.95
"""Share of a mask's pixels that are black or white; where that is meant more widely, more of them."""
_RINGING = 32
"""Grey levels that a lossy picture may be off by, of 255."""
_CONTRAST = 32
"""Grey levels between black and white, at least, of what a lossy picture shows."""
_REGION = 0.0005
"""Share of the picture that a label covers at least, apart from its edge."""


def kind_of(picture: Picture) -> str:
    """Return ``mask``, ``labels``, ``photo``, or ``blank`` where all pixels are equal."""
    values = picture.values
    if values.size == 0:
        return "blank"
    low, high = values.min(), values.max()
    if low == high or (picture.lossy and float(high) - float(low) < _CONTRAST):
        return "blank"
    if picture.alpha or ((values == low) | (values == high)).all():
        return "mask"
    inner = _inner(values)
    regions = _regions(inner, values.size)
    flat = inner.size / values.size
    if not picture.lossy and len(regions) > 2 and flat >= _FLAT and not _ringing(regions):
        return "labels"
    grey = values if picture.shades is None else picture.shades
    low, high = float(grey.min()), float(grey.max())
    near = min(_RINGING, (high - low) / 4) if picture.lossy else _NEAR * (high - low)
    if ((grey <= low + near) | (grey >= high - near)).mean() >= (_EXTREME_LOSSY if picture.lossy else _EXTREME):
        return "mask"
    return "mask" if picture.shades is not None and len(regions) == 2 and flat >= _FLAT else "photo"


def object_of(picture: Picture) -> tuple[np.ndarray, bool]:
    """Return which pixels of a mask's picture are the object, and whether that is black on white.

    The object is white, or the brighter colour, or what is not transparent; it is black where the picture's
    border is white nearly all around.
    """
    grey = picture.values if picture.shades is None else picture.shades
    if picture.alpha:
        return grey >= 128, False
    low, high = grey.min(), grey.max()
    if low == high:  # of a palette that shows two ids alike, or a blank picture
        grey = picture.values
        low, high = grey.min(), grey.max()
    if low == high:
        return np.full(grey.shape, bool(high)), False
    if picture.lossy and float(high) - float(low) < _CONTRAST:
        return np.full(grey.shape, float(high) >= 128), False
    white = grey >= (float(low) + float(high)) / 2
    rim = np.concatenate([white[0], white[-1], white[1:-1, 0], white[1:-1, -1]])
    black_on_white = bool(rim.mean() >= 0.9 and white.mean() <= 0.995)
    return white != black_on_white, black_on_white


def _inner(values: np.ndarray) -> np.ndarray:
    """Return the values of the pixels that are as their four neighbours."""
    middle = values[1:-1, 1:-1]
    same = (middle == values[:-2, 1:-1]) & (middle == values[2:, 1:-1])
    same &= (middle == values[1:-1, :-2]) & (middle == values[1:-1, 2:])
    return middle[same]


def _regions(inner: np.ndarray, size: int) -> np.ndarray:
    """Return the values that cover more than specks."""
    if inner.dtype in (np.uint8, np.uint16):
        counts = np.bincount(inner)
        return np.flatnonzero(counts >= max(4, _REGION * size))
    found, counts = np.unique(inner, return_counts=True)
    return found[counts >= max(4, _REGION * size)]


def _ringing(regions: np.ndarray) -> bool:
    """Return whether these are a JPEG's black and white, saved as another format: near 0 or near 255, some beside it."""
    near_white = (regions >= 240) & (regions < 255)
    return bool(((regions <= 15) | ((regions >= 240) & (regions <= 255))).all() and near_white.any())
