"""Bone lengths relative to the body, compared with constants measured in 3D."""

from __future__ import annotations

import torch
from torch import Tensor

import uplift
from uplift.geometry.normalise import bone_lengths

__all__ = ["BoneRatios"]


class BoneRatios(uplift.Prior):
    """Squared difference between each bone's length, relative to the body's mean bone, and a constant ratio.

    After Wandt et al. 2022, ElePose, 3.5 (L_bone), who averaged the ratios over the 3D poses of their training
    data: a fit with ``ratios`` (child joint: length over mean length) measured in 3D is not 2D-only.
    """

    bones: Tensor
    ratios: Tensor

    def __init__(self, skeleton, *, ratios: dict):
        super().__init__(skeleton)
        children = [child for _, child in skeleton.bones]
        if set(ratios) != set(children):
            raise uplift.UserError(f"BoneRatios: ratios of {sorted(ratios)}, expected one for each of {children}.")
        self.register_buffer("bones", torch.as_tensor(skeleton.bone_indices.copy()))
        self.register_buffer("ratios", torch.tensor([float(ratios[child]) for child in children]))

    def loss(self, lift):
        """Return for each frame the sum over the visible bones, relative to their mean."""
        lengths = bone_lengths(lift.pose, self.bones)
        seen = lift.visible[:, self.bones[:, 0]] * lift.visible[:, self.bones[:, 1]]
        size = (lengths * seen).sum(1) / (self.ratios * seen).sum(1).clamp_min(1e-6)
        return ((lengths / size.clamp_min(1e-6)[:, None] - self.ratios).square() * seen).sum(1)
