"""Where the surface of lifted shapes is: as high as it can be while silhouettes still cover their masks."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.shapes.lifter import LiftedShapes, image_points

__all__ = ["choose_level"]

_LEVELS = (0.04, 0.06, 0.08, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2, 0.23, 0.26, 0.3, 0.35, 0.4, 0.5)
_NEARLY = 0.97
"""Of the best overlap with masks. A lower level thickens shapes where no mask is looking."""


def choose_level(lifted: LiftedShapes, masks: Float[Tensor, "items side side"]) -> float:
    """Return the level of occupancy above which voxels count as inside; no true shape is looked at.

    ``masks``, 0..1, are those that were lifted. It is the highest level at which the silhouettes overlap with
    them nearly as well as at any.
    """
    flat = lifted.occupancy.flatten(1)
    side = masks.shape[-1] // 2
    real = torch.nn.functional.avg_pool2d(masks[:, None], 2).flatten(1) > 0.5
    at = ((image_points(lifted) + 1) / 2 * side).long().clamp(0, side - 1)
    pixel = at[..., 1] * side + at[..., 0]
    overlaps = []
    for level in _LEVELS:
        kept = (flat > level).to(flat.dtype)
        seen = flat.new_zeros(len(flat), side * side).scatter_reduce(1, pixel, kept, "amax") > 0.5
        overlaps.append(float(((seen & real).sum(1) / (seen | real).sum(1).clamp_min(1)).mean()))
    enough = _NEARLY * max(overlaps)
    return max(level for level, overlap in zip(_LEVELS, overlaps, strict=True) if overlap >= enough)
