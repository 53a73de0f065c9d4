"""Joints hidden from the network are filled in where they are known to be."""

from __future__ import annotations

from torch import Tensor

from uplift.priors.base import Lift, Prior

__all__ = ["Fill"]


class Fill(Prior):
    """Distance, in 2D, of the filled-in joints to the keypoints that were hidden (`teacher.hide`)."""

    def loss(self, lift: Lift) -> Tensor:
        """Return the confidence-weighted mean distance over the joints hidden in this step."""
        distance = ((lift.lifted_keypoints - lift.keypoints).square().sum(-1) + 1e-12).sqrt()
        return Lift.mean(distance, lift.hidden * lift.confidence)
