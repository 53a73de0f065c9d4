"""Lift, rotate, project, lift again: the second lift should equal the rotated first one."""

from __future__ import annotations

from torch import Tensor

from uplift.geometry.rotation import turn
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
        scale = lift.reprojected_scale[:, None, None]
        target = (lift.rotated / scale).detach() if self.detach else lift.rotated / scale
        again = lift.relifted.pose
        root = self.skeleton.root_index
        error = joint_distance(again - again[:, root, None], target - target[:, root, None])
        total = Lift.mean(error, lift.visible)
        if self.back:
            # In units of the first lift, so that the inverse rotation leads back to the first pose.
            returned = turn(again * scale, lift.view.mT)
            projected = lift.lifter.camera.project(returned, lift.distance)
            projected = projected - projected[:, root, None]
            total = total + self.back * Lift.mean(joint_distance(projected, lift.keypoints), lift.visible)
        return total
