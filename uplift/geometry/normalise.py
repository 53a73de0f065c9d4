"""From pixels to the model's units and back: root-centred keypoints of mean radius 1."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from uplift.geometry.rotation import least_rotation

__all__ = ["Intrinsics", "Normalised", "bone_lengths", "mean_radius", "mirror", "normalise", "renormalise"]

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
    start, end = bones.mT
    difference = pose.index_select(1, end) - pose.index_select(1, start)  # faster than pose[:, end], backwards too
    return (difference.square().sum(-1) + _TINY).sqrt()


@dataclass(frozen=True)
class Intrinsics:
    """A known camera: focal length and the pixel of the optical axis."""

    focal_px: float
    centre_px: tuple[float, float]


@dataclass(frozen=True)
class Normalised:
    """2D keypoints about their root at mean radius 1, and what leads back to pixels and the camera."""

    keypoints: Float[Tensor, "frames joints 2"]
    """Root at 0, mean distance of the visible joints to it 1; missing joints are 0."""
    scale_px: Float[Tensor, " frames"]
    """Pixels per unit."""
    distance: Float[Tensor, " frames"]
    """Of the camera to the root, in units."""
    rotation: Float[Tensor, "frames 3 3"] | None
    """From the camera frame to that of a camera turned to look at the root; None where the camera is unknown."""


def normalise(
    keypoints: Float[Tensor, "frames joints 2"],
    confidence: Float[Tensor, "frames joints"],
    root: int,
    *,
    count_root: bool = True,
    intrinsics: Intrinsics | None = None,
    distance: float = 10.0,
) -> Normalised:
    """Centre 2D keypoints on the root and divide by their mean distance to it (Kudo et al. 2018, 3.3).

    Distances are weighted by confidence: a missing joint does not count and a doubtful one counts
    little. With ``count_root`` the mean runs over the root too, at distance 0, as in the paper but not
    in its authors' code. With ``intrinsics`` the camera is first turned to look straight at the root,
    which undoes the distortion of a body seen far from the image's centre, and the true distance
    replaces ``distance``, the guess for all.
    """
    rotation = None
    if intrinsics is not None:
        keypoints, rotation = _look_at_root(keypoints, root, intrinsics)
    seen = (keypoints - keypoints[:, root, None]) * (confidence > 0).unsqueeze(-1)
    scale = mean_radius(seen, confidence, root, count_root=count_root)
    far = torch.full_like(scale, distance) if intrinsics is None else intrinsics.focal_px / scale
    return Normalised(seen / scale[:, None, None], scale, far.clamp(2.0, 1e4), rotation)


def _look_at_root(keypoints: Tensor, root: int, intrinsics: Intrinsics) -> tuple[Tensor, Tensor]:
    """Return the keypoints as a camera turned to the root sees them, in pixels, and its rotation."""
    rays = (keypoints - keypoints.new_tensor(intrinsics.centre_px)) / intrinsics.focal_px
    ahead = torch.cat([rays[:, root], torch.ones_like(rays[:, root, :1])], -1)
    rotation = least_rotation(ahead, keypoints.new_tensor([0.0, 0.0, 1.0]))
    turned = torch.baddbmm(rotation[:, None, :, 2], rays, rotation[..., :2].mT)  # of x, y, 1
    return turned[..., :2] / turned[..., 2:].clamp_min(0.05) * intrinsics.focal_px, rotation


def renormalise(
    keypoints: Float[Tensor, "frames joints 2"],
    confidence: Float[Tensor, "frames joints"],
    root: int,
    *,
    count_root: bool = True,
) -> tuple[Float[Tensor, "frames joints 2"], Float[Tensor, " frames"]]:
    """Bring a turned, projected pose to the root and mean radius 1, as real keypoints are.

    Returns the keypoints and the radius they were divided by. Without it a discriminator recognises
    turned poses by their radius alone.
    """
    centred = keypoints - keypoints[:, root : root + 1]
    radius = mean_radius(centred, confidence, root, count_root=count_root)
    return centred / radius[:, None, None], radius
