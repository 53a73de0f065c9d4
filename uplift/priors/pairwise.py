"""Pairwise deformation: the difference of two poses stays the same when their rotated views are lifted again."""

from __future__ import annotations

from torch import Tensor

from uplift.priors.base import Lift, Prior

__all__ = ["Pairwise"]


class Pairwise(Prior):
    """How much the difference of a pair changes when both are rotated, lifted again and rotated back.

    After ElePose (Wandt et al. 2022, 3.4, L_def): what the two poses have in common cancels, and the deformation
    between them remains. Neighbours in the batch, which are random frames, make pairs.
    """

    def loss(self, lift: Lift) -> Tensor:
        """Return the mean over pairs of the norm of the change over all joints."""
        change = lift.pose - lift.returned
        pairs = len(change) // 2 * 2
        one, other = change[:pairs].unflatten(0, (-1, 2)).unbind(1)
        difference = one - other
        difference = difference - difference[:, self.skeleton.root_index, None]
        seen = lift.visible[:pairs].unflatten(0, (-1, 2)).prod(1).unsqueeze(-1)
        off = ((difference.square() * seen).sum((1, 2)) + 1e-12).sqrt()
        return Lift.mean(off, off.new_ones(()))
