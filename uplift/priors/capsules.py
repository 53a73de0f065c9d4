"""Bones as capsules in the image: how far points are from them, and how thick masks show them to be."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from uplift.skeleton import Skeleton

__all__ = ["bone_partners", "bone_thickness", "segment_distances", "soft_gap"]

_EPS = 1e-6
_QUANTILE = 0.8
_FEWEST = 50
_SOFT = 0.05


def segment_distances(
    points: Float[Tensor, "frames points 2"], ends: Float[Tensor, "frames bones 2 2"]
) -> Float[Tensor, "frames points bones"]:
    """Return the distance of each point to each bone, a segment between two points."""
    start, along = ends[:, :, 0], ends[:, :, 1] - ends[:, :, 0]
    # Products of matrices: no tensor of all points, bones and axes.
    ahead = points @ along.mT - (start * along).sum(-1).unsqueeze(1)
    length = along.square().sum(-1).unsqueeze(1)
    away = points.square().sum(-1, keepdim=True) + start.square().sum(-1).unsqueeze(1) - 2 * points @ start.mT
    share = (ahead / (length + _EPS)).clamp(0, 1)
    return (away - share * (2 * ahead - share * length)).clamp_min(_EPS).sqrt()


def soft_gap(
    distances: Float[Tensor, "frames points bones"], thickness: Float[Tensor, " bones"]
) -> Float[Tensor, "frames points"]:
    """Return how far each point is from the soft union of the capsules; 0 inside it."""
    return (-_SOFT * torch.logsumexp((thickness - distances) / _SOFT, -1)).clamp_min(0)


def bone_thickness(
    points: Float[Tensor, "frames points 2"],
    keypoints: Float[Tensor, "frames joints 2"],
    bones: Int[Tensor, "bones 2"],
) -> Float[Tensor, " bones"]:
    """Return the thickness of each bone: how far most of the mask's points that it is the nearest bone of are from it.

    ``points`` are random points of the masks of frames whose joints are all known.
    """
    distance, nearest = segment_distances(points, keypoints[:, bones]).min(-1)
    found = torch.full((len(bones),), torch.nan, dtype=points.dtype, device=points.device)
    for bone in range(len(bones)):
        own = distance[nearest == bone]
        if len(own) >= _FEWEST:
            found[bone] = own.quantile(_QUANTILE)
    usual = found.nanmedian() if found.isfinite().any() else found.new_tensor(0.1)
    return torch.where(found.isfinite(), found, usual)


def bone_partners(skeleton: Skeleton) -> Int[Tensor, " bones"]:
    """Return the bone that each bone is in a mirror; itself where that is none."""
    swap = skeleton.mirror_permutation
    places = {frozenset(map(int, bone)): place for place, bone in enumerate(skeleton.bone_indices)}
    return torch.tensor(
        [places.get(frozenset(map(int, swap[bone])), place) for place, bone in enumerate(skeleton.bone_indices)]
    )
