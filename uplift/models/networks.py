"""Networks: the residual default, the 2018 one, a coupling flow; `build_network` picks one by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

from uplift.config.plugins import build, find_class, options_of
from uplift.errors import UserError, did_you_mean

__all__ = ["CouplingFlow", "KudoNetwork", "ResidualNetwork", "build_network", "fitting_options"]


_MOST_UNITS, _MOST_BLOCKS = 16_384, 256
_MOST_WEIGHTS = 200_000_000
"""Of a built-in network, 3 GB with their optimiser: a hundred times those of the largest recipe."""


class KudoNetwork(nn.Module):
    """Four linear layers with one skip connection, no normalisation (Kudo et al. 2018, 3.2).

    The skip connection, from the first layer's output to the third's before its activation, and the slope are
    those of the authors' code; the paper does not give them. Weights start from a Gaussian, biases at 0.

    Args:
        inputs: numbers in.
        outputs: numbers out.
        units: width of the layers.
        slope: of the leaky ReLU below 0.
        std: standard deviation of the first weights: the code's 0.02; with the 0.14 that the paper prints nothing is learned.
    """

    ranges: ClassVar = {"units": (1, _MOST_UNITS)}

    def __init__(self, inputs: int, outputs: int, *, units: int = 1024, slope: float = 0.2, std: float = 0.02):
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


class ResidualNetwork(nn.Module):
    """One linear layer in, residual pairs of layers, one linear layer out (after Martinez et al. 2017).

    No batch normalisation: the statistics of a batch of rotated poses are not those of real ones.

    Args:
        inputs: numbers in.
        outputs: numbers out.
        units: width of the layers.
        blocks: how many residual pairs.
        slope: of the leaky ReLU below 0.
        norm: whether each pair's input is normalised over its units (layer normalisation).
    """

    ranges: ClassVar = {"units": (1, _MOST_UNITS), "blocks": (1, _MOST_BLOCKS)}

    def __init__(
        self, inputs: int, outputs: int, *, units: int = 256, blocks: int = 2, slope: float = 0.2, norm: bool = False
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


_LARGEST = 2.0
"""Bound of a block's log scale, so that no block can diverge."""


def _bounded(log_scale: Tensor) -> Tensor:
    return _LARGEST * torch.tanh(log_scale / _LARGEST)


class CouplingFlow(nn.Module):
    """Affine coupling blocks, a fixed rotation after each (Dinh et al. 2017; Kingma and Dhariwal 2018)."""

    rotations: Tensor

    def __init__(self, size: int, *, blocks: int = 8, units: int = 64, seed: int = 0):
        super().__init__()
        self.size, self.kept = size, size // 2
        changed = size - self.kept
        self.nets = nn.ModuleList(
            nn.Sequential(nn.Linear(self.kept, units), nn.ReLU(), nn.Linear(units, 2 * changed)) for _ in range(blocks)
        )
        for net in self.nets:
            nn.init.zeros_(net[2].weight)  # type: ignore[index]
            nn.init.zeros_(net[2].bias)  # type: ignore[index]
        random = torch.randn(blocks, size, size, generator=torch.Generator().manual_seed(seed))
        self.register_buffer("rotations", torch.linalg.qr(random).Q)

    def _products(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return what the blocks multiply and add.

        (blocks, size, size + units): the rotation before each block, and with it the first layer, to which only what is
        kept leads. (blocks, 1, size + units): 0, and that layer's bias. (blocks, units, 2 size) and (blocks, 1, 2 size):
        the second layer, with 0 for the log scale and shift of what is kept.
        """
        weights = [torch.stack(parts) for parts in zip(*([*net.parameters()] for net in self.nets), strict=True)]
        enter, enter_bias, leave, leave_bias = weights
        before = torch.cat([torch.eye(self.size, dtype=self.rotations.dtype, device=self.rotations.device)[None], self.rotations[:-1]])
        enter = torch.cat([before, before[..., : self.kept] @ enter.mT], -1)
        enter_bias = nn.functional.pad(enter_bias, (self.size, 0)).unsqueeze(1)
        changed = leave.unflatten(1, (2, -1)), leave_bias.unflatten(1, (2, -1))
        leave = nn.functional.pad(changed[0], (0, 0, self.kept, 0)).flatten(1, 2).mT
        return enter, enter_bias, leave, nn.functional.pad(changed[1], (self.kept, 0)).flatten(1).unsqueeze(1)

    def forward(
        self, vector: Float[Tensor, "batch size"]
    ) -> tuple[Float[Tensor, "batch size"], Float[Tensor, " batch"]]:
        """Return the latent vectors and the log-determinants of the Jacobian."""
        scales = []
        for enter, enter_bias, leave, leave_bias in zip(*(part.unbind() for part in self._products()), strict=True):
            vector, hidden = torch.addmm(enter_bias, vector, enter).split([self.size, enter.shape[1] - self.size], 1)
            scale, shift = torch.addmm(leave_bias, hidden.relu(), leave).chunk(2, 1)
            scales.append(_bounded(scale))
            vector = torch.addcmul(shift, vector, scales[-1].exp())
        return vector @ self.rotations[-1], torch.stack(scales).sum((0, 2))

    def inverse(self, latent: Float[Tensor, "batch size"]) -> Float[Tensor, "batch size"]:
        """Return the vectors that `forward` takes to ``latent``."""
        for net, rotation in zip(reversed(self.nets), reversed(self.rotations), strict=True):
            kept, changed = (latent @ rotation.mT).split([self.kept, self.size - self.kept], 1)
            scale, shift = net(kept).chunk(2, 1)
            latent = torch.cat([kept, (changed - shift) * (-_bounded(scale)).exp()], 1)
        return latent

    def surprise(self, vector: Float[Tensor, "batch size"]) -> Float[Tensor, " batch"]:
        """Return the negative log-likelihood in nats, without its constant."""
        latent, volume = self(vector)
        return 0.5 * latent.square().sum(1) - volume


_SIZES = ("inputs", "outputs")
NETWORKS = {"kudo": "uplift.models.networks:KudoNetwork", "residual": "uplift.models.networks:ResidualNetwork"}


def fitting_options(use: str, options: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return the options for the network ``use``, and the names of those that are left out: of built-in networks alone.

    A recipe's options are those of its own network. Where another is named, what that one does not take and a built-in
    one does is left out; any other option stays, for `build_network` to refuse.
    """
    if use not in NETWORKS and ":" not in use:
        return dict(options), []
    taken = options_of(find_class(use, NETWORKS, "lifter.network"), skip=_SIZES)
    if taken is None:
        return dict(options), []
    builtin = {name for other in NETWORKS for name in options_of(find_class(other, NETWORKS, other), skip=_SIZES) or ()}
    left_out = [name for name in options if name not in taken and name in builtin]
    return {name: value for name, value in options.items() if name not in left_out}, left_out


def build_network(
    use: str, inputs: int, outputs: int, options: Mapping[str, Any], where: str = "lifter.options"
) -> nn.Module:
    """Return the network ``use`` (a name, or ``file.py:Class``) from ``inputs`` to ``outputs`` numbers.

    Raises:
        UserError: no such network or option (a setting below ``where``), invalid sizes.
    """
    setting = f"{where.removesuffix('.options')}.network"
    if use not in NETWORKS and ":" not in use:
        raise UserError(
            f"{setting}={use!r}: no such network.{did_you_mean(use, NETWORKS)} A custom one is named file.py:Class."
        )
    units, blocks = options.get("units", 1), options.get("blocks", 1)
    if use in NETWORKS and isinstance(units, int) and isinstance(blocks, int):
        weights = 2 * units**2 * blocks
        if units <= _MOST_UNITS and blocks <= _MOST_BLOCKS and weights > _MOST_WEIGHTS:
            raise UserError(
                f"{where}: {blocks} blocks of {units:,} units are {weights:,} weights, expected at most "
                f"{_MOST_WEIGHTS:,}. A larger network can be your own, file.py:Class."
            )
    return build(use, NETWORKS, options, where, nn.Module, setting=setting, inputs=inputs, outputs=outputs)
