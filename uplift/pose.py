"""What every part of the model does to 2D and 3D poses: normalise, mirror, measure bones."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

__all__ = ["Normalised", "bone_lengths", "mirror", "normalise", "renormalise"]

_TINY = 1e-8


class Normalised(NamedTuple):
    """2D keypoints about their root at mean radius 1, and the way back to pixels."""

    keypoints: Float[Tensor, "frames joints 2"]
    """Root at 0, mean distance of the visible joints to it 1; missing joints are 0."""
    scale_px: Float[Tensor, " frames"]
    """Pixels per unit."""
    centre_px: Float[Tensor, "frames 2"]
    """The root's pixel."""


def normalise(
    keypoints: Float[Tensor, "frames joints 2"],
    confidence: Float[Tensor, "frames joints"],
    root: int,
    *,
    count_root: bool = True,
) -> Normalised:
    """Centre 2D keypoints on the root and divide by their mean distance to it (Kudo et al. 2018, 3.3).

    Distances are weighted by confidence, so a joint that is missing does not count and a doubtful
    one counts little. ``count_root`` says whether the root, at distance 0, is one of the joints
    the mean runs over: yes in the paper, no in its authors' code.
    """
    centre = keypoints[:, root]
    seen = (keypoints - centre[:, None]) * (confidence > 0).unsqueeze(-1)
    scale = mean_radius(seen, confidence, root, count_root=count_root)
    return Normalised(seen / scale[:, None, None], scale, centre)


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


def renormalise(
    keypoints: Float[Tensor, "frames joints 2"],
    confidence: Float[Tensor, "frames joints"],
    root: int,
    *,
    count_root: bool = True,
) -> Float[Tensor, "frames joints 2"]:
    """Bring a turned, projected pose to the root and mean radius 1, as real keypoints are.

    Without it a discriminator tells turned poses by their radius alone.
    """
    centred = keypoints - keypoints[:, root : root + 1]
    return centred / mean_radius(centred, confidence, root, count_root=count_root)[:, None, None]


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
