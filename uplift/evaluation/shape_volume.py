"""Occupied volume that two shapes share, and whether a shape is nearer to the truth than to its mirror image."""

from __future__ import annotations

import functools

import numpy as np

from uplift.evaluation.shape_standing import Standing, voxel_centres

__all__ = ["OWN_MIRROR", "TIE", "handedness", "volume_iou"]

OWN_MIRROR = 0.9
"""Truths whose volume IoU with their own mirror image in depth is above this have no handedness."""
TIE = 1e-6
"""IoUs that differ by less are equal."""


def volume_iou(found: Standing, truth: Standing) -> float:
    """Return the volume of both, of the volume of either, after ``found`` is moved to the truth's depth.

    Both are read at the voxel centres of the box of the truth in its own grid, ``found`` between its
    voxels linearly; the voxels that ``found`` has outside that box add to the union.
    """
    if found.empty or truth.empty:
        return 0.0
    found = found.moved(truth.depth - found.depth)
    side = truth.occupancy.shape[0]
    inside = found.inside_at(voxel_centres(side)[truth.span], truth.matrix, truth.origin)
    low, high = (np.array([2 * end / side - 1 for end in ends[::-1]]) for ends in _ends(truth))
    own = truth.to_own(found.occupied)
    outside = int(((own < low) | (own > high)).any(1).sum()) * found.voxel**3
    shared, either = (
        int(both.sum()) for both in (inside & truth.inside[truth.span], inside | truth.inside[truth.span])
    )
    return shared * truth.voxel**3 / (either * truth.voxel**3 + outside)


def _ends(shape: Standing) -> list[tuple[int, ...]]:
    return list(zip(*((s.start, s.stop) for s in shape.span), strict=True))


def handedness(found: Standing, truth: Standing, iou: float) -> float:
    """Return 1 where ``found`` shares more with the truth (``iou``) than with its mirror image in depth.

    A tie is 0.5, an empty shape 0, and a truth that is its own mirror NaN.
    """
    mirror, is_own = _mirror(truth)
    if is_own:
        return float("nan")
    other = volume_iou(found, mirror)
    if abs(iou - other) < TIE and not found.empty:
        return 0.5
    return float(iou > other)


@functools.lru_cache(1)
def _mirror(truth: Standing) -> tuple[Standing, bool]:
    """Return the mirror image in depth of the truth that was asked for last, and whether the truth is its own."""
    mirror = truth.mirrored()
    return mirror, volume_iou(mirror, truth) > OWN_MIRROR
