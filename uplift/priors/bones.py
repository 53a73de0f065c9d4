"""Bone lengths keep one proportion over the batch, learned from the batch itself."""

from __future__ import annotations

import torch
from torch import Tensor

from uplift.lift import Lift
from uplift.pose import bone_lengths
from uplift.priors.base import Prior
from uplift.skeleton import Skeleton

__all__ = ["Bones"]


class Bones(Prior):
    """Variance over the batch of each bone's share of the body's mean bone length.

    No ratio comes from 3D data (the constants of Wandt et al. 2022 do): bodies differ little, so
    the share of a bone should not depend on the pose. ``slack`` is the coefficient of variation that
    costs nothing, for bodies that do differ.
    """

    bones: Tensor

    def __init__(self, skeleton: Skeleton, *, slack: float = 0.0):
        super().__init__(skeleton)
        self.slack = slack
        self.register_buffer("bones", torch.as_tensor(skeleton.bone_indices.copy()), persistent=False)

    def loss(self, lift: Lift) -> Tensor:
        """Return the mean over bones of the variance of each bone's share."""
        lengths = bone_lengths(lift.pose, self.bones)
        weight = lift.visible[:, self.bones[:, 0]] * lift.visible[:, self.bones[:, 1]]
        count = weight.sum(0).clamp_min(1)
        usual = (lengths.detach() * weight).sum(0) / count
        # Of the bones that a frame shows: it is not larger for showing only the long ones.
        size = (lengths * weight).sum(1) / (usual * weight).sum(1).clamp_min(1e-6)
        share = lengths / (size * usual.mean()).clamp_min(1e-6).unsqueeze(1)
        mean = (share * weight).sum(0) / count
        variance = ((share - mean).square() * weight).sum(0) / count
        if self.slack:
            variance = (variance - (self.slack * mean).square()).clamp_min(0)
        return variance.mean()
