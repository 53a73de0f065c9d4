"""Lift, turn, project, lift again: the second lift should be the turned first one."""

from __future__ import annotations

from torch import Tensor

from uplift.lift import Lift
from uplift.priors.base import Prior
from uplift.skeleton import Skeleton
from uplift.views import turn

__all__ = ["Consistency"]


class Consistency(Prior):
    """The turned view lifted again gives the turned pose, and turned back the keypoints.

    After Chen et al. 2019 (self-consistency) and ElePose (Wandt et al. 2022, L_3D and L_2D).
    ``detach`` holds the turned pose still, so that only the second lift learns.
    """

    def __init__(self, skeleton: Skeleton, *, detach: bool = False, back: float = 1.0):
        super().__init__(skeleton)
        self.detach, self.back = detach, back

    def loss(self, lift: Lift) -> Tensor:
        """Return the mean joint error in 3D plus ``back`` times that of the keypoints after turning back."""
        target = lift.turned_seen
        if self.detach:
            target = target.detach()
        again = lift.relifted.pose
        root = self.skeleton.root_index
        error = _distance(again - again[:, root, None], target - target[:, root, None])
        total = Lift.mean(error, lift.visible)
        if self.back:
            # seen and pose differ by the view's scale: compare after bringing both to radius 1.
            returned = turn(again, lift.view.mT)
            projected = lift.lifter.camera.project(returned)
            projected = projected - projected[:, root, None]
            size = (projected.square().sum(-1) + 1e-12).sqrt()
            size = (size * lift.visible).sum(1) / lift.visible.sum(1).clamp_min(1)
            projected = projected / size.clamp_min(1e-3)[:, None, None]
            total = total + self.back * Lift.mean(_distance(projected, lift.keypoints), lift.visible)
        return total


def _distance(first: Tensor, second: Tensor) -> Tensor:
    return ((first - second).square().sum(-1) + 1e-12).sqrt()
