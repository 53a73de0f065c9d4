"""Coordinates and confidences on other scales than pixels and 0..1: recognised, and put right where all readers meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["SHARES_NOTE", "in_pixels", "with_sure_confidence"]

# Coordinates that are shares of the image, 0 to 1.

SHARES_NOTE = (
    "coordinates are shares of the image, whose size is not known: taken as square; say image_size=WIDTHxHEIGHT"
)
_LOW, _HIGH = -0.5, 1.5
"""Shares of the image of what is in it, or not far out of it."""
_WITHIN = 0.99
_NEGATIVE = 0.2
"""Where more coordinates than this are negative, they are measured from the middle of something."""
_ROWS = 2000


def in_pixels(data: PoseData, *, square: bool = False) -> PoseData:
    """Return keypoints that are shares of the image in pixels, and any others as they are; a note says what was done.

    They are shares where they lie between -0.5 and 1.5: a body in pixels is never so small. Where the
    size of the image is not known they are taken as those of a ``square`` one, if that is wanted.

    Raises:
        UserError: shares of an image whose size is not known.
    """
    seen = _some_coordinates(data)
    if not len(seen) or (seen == np.round(seen)).all() or np.quantile(np.abs(seen), _WITHIN) >= 2:
        return data
    low, high = (float(seen.min()), float(seen.max()))
    found = f"coordinates go from {low:.3g} to {high:.3g}"
    inside = ((seen >= _LOW) & (seen <= _HIGH)).mean() >= _WITHIN
    if not inside or (seen < 0).mean() > _NEGATIVE:
        note = f"WARNING: {found}, which are neither pixels nor shares of the image (0 to 1): taken as they are"
        return replace(data, notes=(*data.notes, note))
    if data.image_size is not None:
        width, height = data.image_size
        note = f"{found}: shares of the image, turned into pixels of its {width}x{height}"
        keypoints = data.keypoints * np.array(data.image_size, np.float32)
        return replace(data, keypoints=keypoints, notes=(*data.notes, note))
    if square:
        return replace(data, notes=(*data.notes, SHARES_NOTE))
    if not data.source:  # arrays, given to a model
        raise UserError(f"{found}: shares of the image, expected pixels. Multiply them by its width and height.")
    raise UserError(
        f"{data.source}: {found}: shares of the image, expected pixels. Say how large the image is, "
        "image_size=WIDTHxHEIGHT (data.image_size= in a fit), such as image_size=1920x1080."
    )


def _some_coordinates(data: PoseData) -> np.ndarray:
    """Return the coordinates of visible keypoints, of up to some thousand rows, without those at (0, 0)."""
    rows = np.flatnonzero((data.confidence > 0).any(1))
    rows = rows[:: max(1, len(rows) // _ROWS)]
    points = data.keypoints[rows]
    seen = (data.confidence[rows] > 0) & np.isfinite(points).all(-1) & (points != 0).any(-1)
    return points[seen]


# Confidences that are per cent, or from 0 to 255.

_CLOSE = 2.0
"""Heat maps peak a little over 1."""
_LEAST = 10.0
"""No tracker is so unsure of all it sees, in per cent."""
_SCALES = ((100.0, "per cent"), (255.0, "numbers from 0 to 255"))


def with_sure_confidence(data: PoseData) -> PoseData:
    """Return ``data`` with confidences from 0 to 1; a note says so where they were on another scale.

    Per cent and 0 to 255 are divided, COCO's flags (0, 1 occluded, 2 visible) halved, a little more than 1
    is 1, and -1 is 0.

    Raises:
        UserError: confidences on none of these scales.
    """
    confidence = data.confidence
    finite = np.isfinite(confidence)
    most = float(confidence.max(initial=0, where=finite))
    least = float(confidence.min(initial=0, where=finite))
    if most <= 1 and least >= 0 and not np.isinf(confidence).any():
        return data
    negative = least < -1 or (most > _CLOSE and bool(((confidence < 0) & (confidence != -1) & finite).any()))
    scale, note = _scale_of(confidence[finite], most)
    if negative or scale is None:
        where = f"{data.source}: " if data.source else ""
        hint = "the network's own numbers?" if negative else "divide it by the most that it can be"
        raise UserError(
            f"{where}confidence goes from {least:.3g} to {most:.3g}, expected 0 to 1, per cent, or 0 to 255: {hint}."
        )
    confidence = np.clip(confidence / np.float32(scale), 0, 1).astype(np.float32, copy=False)
    return replace(data, confidence=confidence, notes=(*data.notes, *note))


def _scale_of(values: np.ndarray, most: float) -> tuple[float | None, tuple[str, ...]]:
    """Return what confidences are to be divided by, None where that cannot be told, and what is assumed of them."""
    if most == 2 and np.isin(values, (-1, 0, 1, 2)).all():
        return 2.0, ("confidence is 0, 1 and 2: taken as COCO's flags, 1 occluded and 2 visible",)
    if most <= _CLOSE:
        return 1.0, ()
    for scale, what in _SCALES:
        if _LEAST < most <= scale:
            return scale, (f"confidence goes up to {most:.4g}: taken as {what}, and divided by {scale:g}",)
    return None, ()
