"""A residual multilayer perceptron: the default lifter and critic."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

__all__ = ["ResidualNetwork"]


class ResidualNetwork(nn.Module):
    """One linear layer in, ``blocks`` residual pairs, one linear layer out (after Martinez et al. 2017).

    No batch normalisation: statistics of a batch of turned poses are not those of real ones.
    ``norm`` normalises each pair's input over its units (layer normalisation).
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        units: int = 256,
        blocks: int = 2,
        slope: float = 0.2,
        norm: bool = False,
    ):
        super().__init__()
        self.enter = nn.Linear(inputs, units)
        self.blocks = nn.ModuleList(
            nn.ModuleList([nn.Linear(units, units), nn.Linear(units, units)]) for _ in range(blocks)
        )
        self.norms = nn.ModuleList(nn.LayerNorm(units) if norm else nn.Identity() for _ in range(blocks))
        self.leave = nn.Linear(units, outputs)
        self.slope = slope
        with torch.no_grad():
            self.leave.weight.mul_(0.1)  # start near a flat pose and an undecided critic

    def forward(self, features: Float[Tensor, "batch inputs"]) -> Float[Tensor, "batch outputs"]:
        """Return the last layer's values, without activation."""
        hidden = leaky_relu(self.enter(features), self.slope)
        for norm, (first, second) in zip(self.norms, self.blocks, strict=True):  # type: ignore[misc]
            inner = leaky_relu(first(norm(hidden)), self.slope)
            hidden = hidden + leaky_relu(second(inner), self.slope)
        return self.leave(hidden)
