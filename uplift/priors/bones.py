"""Bone lengths keep the same proportions over the batch, learned from the batch itself."""

from __future__ import annotations

import torch
from torch import Tensor

from uplift.data.tensors import TrainingSet
from uplift.geometry.normalise import bone_lengths
from uplift.priors.base import Lift, Prior
from uplift.skeleton import Skeleton

__all__ = ["Bones"]

_FREE = 0.05
"""Relative difference to the labelled proportions that costs nothing, as a few labelled bodies are not all bodies."""


class Bones(Prior):
    """Variance over the batch of each bone's share of the body's mean bone length.

    Bodies differ little, so the share of a bone should not depend on the pose. No ratio comes from 3D data,
    unlike those of Wandt et al. 2022 (ElePose).

    Args:
        skeleton: of the poses.
        slack: coefficient of variation that costs nothing, for bodies that do differ.
        labels: whether mean shares are kept within 5 % of those of labelled bodies, if there are any.
    """

    bones: Tensor

    def __init__(self, skeleton: Skeleton, *, slack: float = 0.0, labels: bool = True):
        super().__init__(skeleton)
        self.slack = slack
        self.labels = labels
        self.true_share: Tensor | None = None
        self.register_buffer("bones", torch.as_tensor(skeleton.bone_indices.copy()), persistent=False)

    def prepare(self, data: TrainingSet) -> None:
        """Measure the shares of labelled bodies, if there are any."""
        if not self.labels or data.labels is None:
            return
        lengths = bone_lengths(data.labels[data.labelled], self.bones)
        lengths = lengths[lengths.isfinite().all(1)]
        if len(lengths):
            self.true_share = (lengths / lengths.mean(1, keepdim=True).clamp_min(1e-6)).mean(0)

    def loss(self, lift: Lift) -> Tensor:
        """Return the mean over bones of the variance of each bone's share."""
        lengths, weight = lift.bone_lengths, lift.visible_bones
        count, usual = Lift.sums(weight, lengths.detach() * weight)
        count = count.clamp_min(1)
        usual = usual / count
        # Relative to the visible bones: a frame that shows only long bones is not larger.
        size = (lengths * weight).sum(1) / (usual * weight).sum(1).clamp_min(1e-6)
        share = lengths / (size * usual.mean()).clamp_min(1e-6).unsqueeze(1)
        mean = Lift.sums(share * weight)[0] / count
        variance = Lift.sums((share - mean).square() * weight)[0] / count
        if self.slack:
            variance = (variance - (self.slack * mean).square()).clamp_min(0)
        if self.true_share is None:
            return variance.mean()
        target = self.true_share.to(mean)
        difference = ((mean - target).abs() - _FREE * target).clamp_min(0)
        return (variance + difference.square()).mean()
