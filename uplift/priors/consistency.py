"""Lift, rotate, project, lift again: the second lift should equal the rotated first one."""

from __future__ import annotations

from torch import Tensor

from uplift.priors.base import Lift, Prior, joint_distance
from uplift.skeleton import Skeleton

__all__ = ["Consistency"]


class Consistency(Prior):
    """The rotated view, lifted again, gives the rotated pose, and rotated back the keypoints.

    After Chen et al. 2019 (self-consistency) and ElePose (Wandt et al. 2022, L_3D and L_2D).

    Args:
        skeleton: of the poses.
        detach: whether the rotated pose is fixed, so that only the second lift learns.
        back: weight of the keypoints.
    """

    def __init__(self, skeleton: Skeleton, *, detach: bool = False, back: float = 1.0):
        super().__init__(skeleton)
        self.detach, self.back = detach, back

    def loss(self, lift: Lift) -> Tensor:
        """Return the mean joint error in 3D plus ``back`` times that of the keypoints after the inverse rotation."""
        root = self.skeleton.root_index
        target = lift.rotated / lift.reprojected_scale[:, None, None]
        change = lift.relifted.pose - (target.detach() if self.detach else target)
        total = Lift.mean(joint_distance(change, change[:, root, None]), lift.visible)
        if self.back:
            projected = lift.lifter.camera.project(lift.returned, lift.distance)
            projected = projected - projected[:, root, None]
            total = total + self.back * Lift.mean(joint_distance(projected, lift.keypoints), lift.visible)
        return total
