"""Occupied volume that two shapes share, and whether a shape is nearer to the truth than to its mirror image."""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor

from uplift.evaluation.shape_standing import Standing, voxel_centres

__all__ = ["OWN_MIRROR", "TIE", "handedness", "volume_iou"]

OWN_MIRROR = 0.9
"""Truths whose volume IoU with their own mirror image in depth is above this have no handedness."""
TIE = 1e-6
"""IoUs that differ by less are equal."""


def volume_iou(found: Standing, truth: Standing, mirrored: bool = False) -> float:
    """Return the volume of both, of the volume of either, after ``found`` is moved to the truth's depth.

    Both are read at the voxel centres of the box of the truth in its own grid, ``found`` between its
    voxels linearly; the voxels that ``found`` has outside that box add to the union. ``mirrored``: with the
    mirror image in depth of ``found`` that has the same silhouette, each ray kept.
    """
    if found.empty or truth.empty:
        return 0.0
    found = found.moved(truth.depth - found.depth)
    side = truth.occupancy.shape[0]
    points = voxel_centres(side)[truth.span]
    occupied = found.occupied
    if mirrored:
        points = _other_way(
            points @ torch.from_numpy(truth.matrix.T).float() + torch.from_numpy(truth.origin).float(), truth
        )
        inside = found.inside_at(points, np.eye(3), np.zeros(3))
        occupied = _other_way(torch.from_numpy(occupied), truth).numpy()
    else:
        inside = found.inside_at(points, truth.matrix, truth.origin)
    low, high = (np.array([2 * end / side - 1 for end in ends[::-1]]) for ends in _ends(truth))
    own = truth.to_own(occupied)
    outside = int(((own < low) | (own > high)).any(1).sum()) * found.voxel**3
    shared, either = (
        int(both.sum()) for both in (inside & truth.inside[truth.span], inside | truth.inside[truth.span])
    )
    return shared * truth.voxel**3 / (either * truth.voxel**3 + outside)


def _ends(shape: Standing) -> list[tuple[int, ...]]:
    return list(zip(*((s.start, s.stop) for s in shape.span), strict=True))


def _other_way(points: Tensor, truth: Standing) -> Tensor:
    """Return points of the camera frame mirrored in depth about the truth's centroid, each on its own ray."""
    depth = 2 * truth.depth - points[..., 2:]
    share = (1 + depth / truth.distance) / (1 + points[..., 2:] / truth.distance)
    return torch.cat([points[..., :2] * share, depth], -1)


def handedness(found: Standing, truth: Standing, iou: float) -> float:
    """Return 1 where the truth shares more with ``found`` (``iou``) than with its mirror image in depth.

    A tie is 0.5, an empty shape 0, and a truth that is its own mirror NaN.
    """
    if _is_own_mirror(truth):
        return float("nan")
    other = volume_iou(found, truth, mirrored=True)
    if abs(iou - other) < TIE and not found.empty:
        return 0.5
    return float(iou > other)


@functools.lru_cache(1)
def _is_own_mirror(truth: Standing) -> bool:
    return volume_iou(truth, truth, mirrored=True) > OWN_MIRROR
