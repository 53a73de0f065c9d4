"""Left and right bones of a pair are equally long."""

from __future__ import annotations

import torch
from torch import Tensor

from uplift.errors import NotForThisSkeleton
from uplift.priors.base import Lift, Prior
from uplift.skeleton import Skeleton
from uplift.skeleton.core import mirrored_bones

__all__ = ["Symmetry"]


class Symmetry(Prior):
    """Difference of mirrored bones, as a share of the body's mean bone length.

    A soft prior: real limbs of one person differ by a few percent.
    """

    left: Tensor
    right: Tensor

    def __init__(self, skeleton: Skeleton):
        super().__init__(skeleton)
        pairs = mirrored_bones(skeleton)
        if not len(pairs):
            raise NotForThisSkeleton(
                f"skeleton '{skeleton.name}' has no mirrored bones (give it `mirror:` pairs, or set "
                "priors.symmetry.weight=0)."
            )
        for name, bones in zip(("left", "right"), pairs.T, strict=True):
            self.register_buffer(name, torch.tensor(bones.copy()), persistent=False)

    def loss(self, lift: Lift) -> Tensor:
        """Return the weighted mean over pairs and frames."""
        left, right = (lift.bone_lengths.index_select(1, bones) for bones in (self.left, self.right))
        seen = lift.visible_bones.index_select(1, self.left) * lift.visible_bones.index_select(1, self.right)
        size = ((left + right) / 2 * seen).sum(1, keepdim=True) / seen.sum(1, keepdim=True).clamp_min(1)
        return Lift.mean((left - right).abs() / size.clamp_min(1e-6), seen)
