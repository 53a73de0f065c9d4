"""The lifter fills in joints that were hidden from it at their known positions."""

from __future__ import annotations

from torch import Tensor

from uplift.priors.base import Lift, Prior, joint_distance

__all__ = ["Fill"]


class Fill(Prior):
    """Distance, in 2D, of the filled-in joints to the keypoints that were hidden (`teacher.hide`)."""

    def loss(self, lift: Lift) -> Tensor:
        """Return the confidence-weighted mean distance over the joints hidden in this step."""
        return Lift.mean(joint_distance(lift.lifted_keypoints, lift.keypoints), lift.hidden * lift.confidence)
