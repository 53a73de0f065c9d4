"""Bone lengths keep one proportion over the batch, learned from the batch itself."""

from __future__ import annotations

import torch
from torch import Tensor

from uplift.data.tensors import TrainingSet
from uplift.geometry.normalise import bone_lengths
from uplift.priors.base import Lift, Prior
from uplift.skeleton import Skeleton

__all__ = ["Bones"]

_FREE = 0.05


class Bones(Prior):
    """Variance over the batch of each bone's share of the body's mean bone length.

    No ratio comes from 3D data (the constants of Wandt et al. 2022 do): bodies differ little, so
    the share of a bone should not depend on the pose. ``slack`` is the coefficient of variation that
    costs nothing, for bodies that do differ.

    Where frames are labelled and ``labels`` is on, the mean shares are held near those of the labels:
    within 5 % of them they are free, as a few labelled bodies are not all bodies.
    """

    bones: Tensor

    def __init__(self, skeleton: Skeleton, *, slack: float = 0.0, labels: bool = True):
        super().__init__(skeleton)
        self.slack = slack
        self.labels = labels
        self.true_share: Tensor | None = None
        self.register_buffer("bones", torch.as_tensor(skeleton.bone_indices.copy()), persistent=False)

    def prepare(self, data: TrainingSet) -> None:
        """Measure the shares of labelled bodies, where there are any."""
        if not self.labels or data.labels is None:
            return
        lengths = bone_lengths(data.labels[data.labelled], self.bones)
        lengths = lengths[lengths.isfinite().all(1)]
        if len(lengths):
            self.true_share = (lengths / lengths.mean(1, keepdim=True).clamp_min(1e-6)).mean(0)

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
        if self.true_share is None:
            return variance.mean()
        told = self.true_share.to(mean)
        off = ((mean - told).abs() - _FREE * told).clamp_min(0)
        return (variance + off.square()).mean()
