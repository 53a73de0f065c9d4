"""Pairwise deformation: the difference of two poses stays the same when their rotated views are lifted again."""

from __future__ import annotations

from torch import Tensor

from uplift.geometry.rotation import turn
from uplift.priors.base import Lift, Prior

__all__ = ["Pairwise"]


class Pairwise(Prior):
    """How much the difference of a pair changes when both are rotated, lifted again and rotated back.

    After ElePose (Wandt et al. 2022, 3.4, L_def): what the two poses have in common cancels, and the deformation
    between them remains. Neighbours in the batch, which are random frames, make pairs.
    """

    def loss(self, lift: Lift) -> Tensor:
        """Return the mean over pairs of the norm of the change over all joints."""
        again = turn(lift.relifted.pose * lift.reprojected_scale[:, None, None], lift.view.mT)
        root = self.skeleton.root_index
        change = (lift.pose - lift.pose[:, root, None]) - (again - again[:, root, None])
        pairs = len(change) // 2 * 2
        seen = lift.visible[0:pairs:2] * lift.visible[1:pairs:2]
        off = (change[0:pairs:2] - change[1:pairs:2]).square().sum(-1) * seen
        return Lift.mean((off.sum(1) + 1e-12).sqrt(), off.new_ones(()))
