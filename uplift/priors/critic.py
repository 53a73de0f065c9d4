"""The 2018 discriminator: rotated views should be indistinguishable from real keypoints."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.nn.functional import softplus

from uplift.config import ranks
from uplift.errors import UserError, did_you_mean
from uplift.models.networks import build_network
from uplift.priors.base import Lift, Prior
from uplift.skeleton import Skeleton

__all__ = ["Critic"]


class Critic(Prior):
    """A network that distinguishes real keypoints from rotated views (Kudo et al. 2018, 3.1 and 4.2).

    Args:
        skeleton: of the poses.
        objective: ``minimax``, log(1 - D) as printed, or ``non_saturating``, -log D as in the authors' code.
        gate: (low, high): below an accuracy of low the lifter is not updated, above high the critic is not;
            None always updates both.
        network: name of the network, or file.py:Class.
        units: width of its layers.
        options: its other options.
    """

    ranges: ClassVar = {"units": (1, 16_384)}
    accuracy: Tensor
    """Of the last batch."""

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        objective: str = "non_saturating",
        gate: Any = None,
        network: str = "residual",
        units: int = 256,
        **options: Any,
    ):
        super().__init__(skeleton)
        objectives = ("minimax", "non_saturating")
        if objective not in objectives:
            raise UserError(f"priors.critic.objective={objective!r}.{did_you_mean(objective, objectives)}")
        self.objective = objective
        self.gate = None if gate is None else _accuracies(gate)
        self.register_buffer("accuracy", torch.tensor(0.5), persistent=False)
        self.network = build_network(network, 2 * len(skeleton.joints), 1, {"units": units, **options}, "priors.critic")

    def judge(self, keypoints: Tensor) -> Tensor:
        """Return (batch,) logits: above 0 where the keypoints look real."""
        return self.network(keypoints.flatten(1))[:, 0]

    def loss(self, lift: Lift) -> Tensor:
        """Return the loss of rotated views under the critic: low where they look real."""
        logits = self.judge(lift.reprojected * lift.visible.unsqueeze(-1))
        return -softplus(logits) if self.objective == "minimax" else softplus(-logits)

    def critic_loss(self, real: Tensor, reprojected: Tensor) -> Tensor:
        """Return the cross-entropy of classifying ``real`` and ``reprojected``."""
        on_real, on_reprojected = self.judge(real), self.judge(reprojected)
        share = ((on_real > 0).sum() + (on_reprojected < 0).sum()) / (2 * len(on_real))
        # All ranks open and close the gates together, or their weights would drift apart.
        (share,) = ranks.mean(share.detach())
        self.accuracy.copy_(share)
        if self.gate is not None:  # with it a GPU waits in each step, as what is updated depends on the number
            accuracy = float(share)
            self.gate_lifter = accuracy < self.gate[0]
            self.gate_itself = accuracy > self.gate[1]
        return softplus(-on_real).mean() + softplus(on_reprojected).mean()

    def metrics(self, lift: Lift) -> dict[str, float]:
        """Return the accuracy on the batch: 0.5 if the two are indistinguishable."""
        return {"accuracy": float(self.accuracy)}


def _accuracies(gate: Any) -> tuple[float, float]:
    try:
        low, high = (float(value) for value in gate)
        if 0 <= low < high <= 1:
            return low, high
    except (TypeError, ValueError):
        pass
    raise UserError(f"priors.critic.gate={gate!r}: expected two accuracies, low and high, between 0 and 1.")
