"""A critic on masks: silhouettes from random views must look like real masks (Kudo et al. 2018, for shapes)."""

from __future__ import annotations

from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.priors.base import ShapeLift, ShapePrior

__all__ = ["MaskCritic"]


class MaskCritic(ShapePrior):
    """A convolutional network that distinguishes real masks from silhouettes of the shapes.

    Both are blurred first, as shapes of a mixture have no sharp edges and must not be recognised by that. The
    gradient of the network at real masks is penalised (Mescheder et al. 2018, R1).

    Args:
        units: channels of the first layer.
        gradient_penalty: weight of that penalty.
    """

    ranges: ClassVar = {"units": (1, 512)}
    blur: Tensor

    def __init__(self, units: int = 24, gradient_penalty: float = 1.0):
        super().__init__()
        self.gradient_penalty = gradient_penalty
        steps = []
        for before, after in ((1, units), (units, 2 * units), (2 * units, 4 * units)):
            steps += [nn.Conv2d(before, after, 4, 2, 1), nn.LeakyReLU(0.2)]
        self.look = nn.Sequential(*steps, nn.AdaptiveAvgPool2d(3), nn.Flatten(), nn.Linear(36 * units, 1))
        kernel = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
        self.register_buffer("blur", (kernel[:, None] * kernel)[None, None], persistent=False)

    def forward(self, image: Float[Tensor, "items side side"]) -> Float[Tensor, " items"]:
        """Return how real each image looks."""
        soft = nn.functional.conv2d(image[:, None], self.blur, padding=2)
        return self.look(soft * 2 - 1)[:, 0]

    def loss(self, lift: ShapeLift) -> Float[Tensor, ""]:
        """Return the loss of silhouettes under the critic: low where they look real."""
        return nn.functional.softplus(-self(lift.reprojected)).mean()

    def critic_loss(
        self, real: Float[Tensor, "items side side"], reprojected: Float[Tensor, "reprojected side side"]
    ) -> Float[Tensor, ""]:
        """Return the cross-entropy of classifying the two, and the gradient penalty."""
        real = real.detach().requires_grad_()
        verdict = self(real)
        slope = torch.autograd.grad(verdict.sum(), real, create_graph=True)[0].square().sum((1, 2)).mean()
        apart = nn.functional.softplus(-verdict).mean() + nn.functional.softplus(self(reprojected)).mean()
        return apart + self.gradient_penalty * slope
