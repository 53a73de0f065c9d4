"""Where the surface of lifted shapes is: where it is expected to overlap best with the shape, and covers its mask."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.shapes.lifter import LiftedShapes, image_points

__all__ = ["choose_level"]

_LEVELS = (0.04, 0.06, 0.08, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2, 0.23, 0.26, 0.3, 0.35, 0.4, 0.5)


def choose_level(lifted: LiftedShapes, masks: Float[Tensor, "items side side"]) -> float:
    """Return the level of occupancy above which voxels count as inside; no true shape is looked at.

    The product of two things is largest there. If occupancy is the chance that a voxel is full, what a
    level keeps can be expected to overlap with the shape by kept chance over (kept voxels + all chance -
    kept chance). And the silhouette of what it keeps overlaps with ``masks``, 0..1, that were lifted.
    """
    flat = lifted.occupancy.flatten(1)
    all_of_it = flat.sum(1)
    side = masks.shape[-1] // 2
    real = torch.nn.functional.avg_pool2d(masks[:, None], 2).flatten(1) > 0.5
    at = ((image_points(lifted) + 1) / 2 * side).long().clamp(0, side - 1)
    pixel = at[..., 1] * side + at[..., 0]
    worth = []
    for level in _LEVELS:
        kept = flat > level
        chance = (flat * kept).sum(1)
        expected = chance / (kept.sum(1) + all_of_it - chance).clamp_min(1e-9)
        seen = flat.new_zeros(len(flat), side * side).scatter_reduce(1, pixel, kept.to(flat.dtype), "amax") > 0.5
        covered = (seen & real).sum(1) / (seen | real).sum(1).clamp_min(1)
        worth.append(float(expected.mean() * covered.mean()))
    return _LEVELS[max(range(len(_LEVELS)), key=worth.__getitem__)]
