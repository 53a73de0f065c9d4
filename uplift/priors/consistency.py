"""Lift, rotate, project, lift again: the second lift should equal the rotated first one."""

from __future__ import annotations

from torch import Tensor

from uplift.geometry.rotation import turn
from uplift.priors.base import Lift, Prior
from uplift.skeleton import Skeleton

__all__ = ["Consistency"]


class Consistency(Prior):
    """The rotated view, lifted again, gives the rotated pose, and rotated back the keypoints.

    After Chen et al. 2019 (self-consistency) and ElePose (Wandt et al. 2022, L_3D and L_2D).
    ``detach`` fixes the rotated pose, so that only the second lift learns; ``back`` weighs the keypoints.
    """

    def __init__(self, skeleton: Skeleton, *, detach: bool = False, back: float = 1.0):
        super().__init__(skeleton)
        self.detach, self.back = detach, back

    def loss(self, lift: Lift) -> Tensor:
        """Return the mean joint error in 3D plus ``back`` times that of the keypoints after turning back."""
        scale = lift.seen_scale[:, None, None]
        target = lift.turned / scale
        if self.detach:
            target = target.detach()
        again = lift.relifted.pose
        root = self.skeleton.root_index
        error = _distance(again - again[:, root, None], target - target[:, root, None])
        total = Lift.mean(error, lift.visible)
        if self.back:
            # In units of the first lift again, so that turning back ends where it began.
            returned = turn(again * scale, lift.view.mT)
            projected = lift.lifter.camera.project(returned, lift.distance)
            projected = projected - projected[:, root, None]
            total = total + self.back * Lift.mean(_distance(projected, lift.keypoints), lift.visible)
        return total


def _distance(first: Tensor, second: Tensor) -> Tensor:
    return ((first - second).square().sum(-1) + 1e-12).sqrt()
