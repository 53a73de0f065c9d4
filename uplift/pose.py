"""What every part of the model does to 2D and 3D poses: measure, mirror."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

__all__ = ["bone_lengths", "mean_radius", "mirror"]

_TINY = 1e-8


def mean_radius(
    keypoints: Float[Tensor, "frames joints 2"],
    confidence: Float[Tensor, "frames joints"],
    root: int,
    *,
    count_root: bool = True,
) -> Float[Tensor, " frames"]:
    """Return the confidence-weighted mean distance of the joints to the origin, never 0."""
    weight = confidence
    if not count_root:
        weight = weight.clone()
        weight[:, root] = 0
    # The square root has no gradient at 0, where the root joint always is.
    radius = (keypoints.square().sum(-1) + _TINY**2).sqrt()
    return (radius * weight).sum(1).div(weight.sum(1).clamp_min(_TINY)).clamp_min(1e-6)


def mirror(points: Float[Tensor, "frames joints axes"], permutation: Int[Tensor, " joints"]):
    """Return 2D or 3D points seen in a mirror: x negated, left and right joints exchanged."""
    flipped = points[:, permutation]
    return torch.cat([-flipped[..., :1], flipped[..., 1:]], -1)


def bone_lengths(
    pose: Float[Tensor, "frames joints 3"], bones: Int[Tensor, "bones 2"]
) -> Float[Tensor, "frames bones"]:
    """Return the length of each bone; its gradient is finite at length 0."""
    difference = pose[:, bones[:, 1]] - pose[:, bones[:, 0]]
    return (difference.square().sum(-1) + _TINY).sqrt()
