"""The 2018 generator and discriminator: four linear layers, leaky ReLU, one skip connection."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

__all__ = ["KudoNetwork"]


class KudoNetwork(nn.Module):
    """Four linear layers with one skip connection, no normalisation (Kudo et al. 2018, 3.2).

    The skip connection, from the first layer's output to the third's before its activation, and
    the slope are those of the authors' code, where the paper does not say. ``std`` is that of the
    Gaussian the weights start from; the paper says 0.14, the code 0.02. Biases start at 0.
    """

    def __init__(self, inputs: int, outputs: int, *, units: int = 1024, slope: float = 0.2, std: float = 0.14):
        super().__init__()
        layers = [nn.Linear(inputs, units), nn.Linear(units, units), nn.Linear(units, units), nn.Linear(units, outputs)]
        self.layers = nn.ModuleList(layers)
        self.slope = slope
        for layer in layers:
            nn.init.normal_(layer.weight, std=std)
            nn.init.zeros_(layer.bias)

    def forward(self, features: Float[Tensor, "batch inputs"]) -> Float[Tensor, "batch outputs"]:
        """Return the last layer's values, without activation."""
        first = leaky_relu(self.layers[0](features), self.slope)
        second = leaky_relu(self.layers[1](first), self.slope)
        third = leaky_relu(self.layers[2](second) + first, self.slope)
        return self.layers[3](third)
