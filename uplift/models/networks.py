"""Networks: the residual default, the 2018 one, a coupling flow; `build_network` picks one by name."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

from uplift.config.device import fast_products, mixed_precision
from uplift.config.plugins import build, find_class, options_of
from uplift.errors import UserError, did_you_mean

__all__ = ["CouplingFlow", "KudoNetwork", "ResidualNetwork", "build_network", "fitting_options"]


_MOST_UNITS, _MOST_BLOCKS = 16_384, 256
_MOST_WEIGHTS = 200_000_000
"""Of a built-in network, 3 GB with their optimiser: a hundred times those of the largest recipe."""


# A network of `exact_ends` keeps its first and last layer in full precision under autocast, and with them what poses need.


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
    exact_ends: ClassVar = True

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
        first = leaky_relu(_exact(self.layers[0], features), self.slope)
        second = leaky_relu(self.layers[1](first), self.slope)
        third = leaky_relu(self.layers[2](second) + first, self.slope)
        return _exact(self.layers[3], third)


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
    exact_ends: ClassVar = True

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
        hidden = leaky_relu(_exact(self.enter, features), self.slope)
        for norm, (first, second) in zip(self.norms, self.blocks, strict=True):  # type: ignore[misc]
            inner = leaky_relu(first(norm(hidden)), self.slope)
            hidden = hidden + leaky_relu(second(inner), self.slope)
        return _exact(self.leave, hidden)


def _exact(layer: nn.Module, value: Tensor) -> Tensor:
    """Return what ``layer`` makes of ``value``, in full precision under autocast too: rounded coordinates cost five times as much
    as rounded products between them."""
    if mixed_precision(value.device) is None:
        return layer(value)
    with torch.autocast(value.device.type, enabled=False):
        return layer(value.float())


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

    def _products(self) -> list[tuple[Tensor, ...]]:
        """Return for each block what it multiplies with and adds.

        (size, size + units): the rotation before it, and with it the first layer, to which only what is kept leads.
        (size + units,): 0, and that layer's bias. (units, 2 changed) and (2 changed,): the second layer, with the log
        scale divided by its bound.
        """
        weights = [torch.stack(parts) for parts in zip(*([*net.parameters()] for net in self.nets), strict=True)]
        enter, enter_bias, leave, leave_bias = weights
        like = {"dtype": enter.dtype, "device": enter.device}
        before = torch.cat([torch.eye(self.size, **like)[None], self.rotations[:-1]])
        enter = torch.cat([before, before[..., : self.kept] @ enter.mT], -1)
        bounds = torch.ones(leave.shape[1], **like)
        bounds[: self.size - self.kept] = 1 / _LARGEST
        enter_bias, leave = nn.functional.pad(enter_bias, (self.size, 0)), leave.mT * bounds
        return [*zip(enter, enter_bias, leave, leave_bias * bounds, strict=True)]

    def forward(
        self, vector: Float[Tensor, "batch size"]
    ) -> tuple[Float[Tensor, "batch size"], Float[Tensor, " batch"]]:
        """Return the latent vectors and the log-determinants of the Jacobian."""
        squashed = []
        for products in self._products():
            kept, changed, _, scale, factor, shift = _coupling(vector, self.kept, products)
            squashed.append(scale)
            vector = torch.cat([kept, torch.addcmul(shift, changed, factor)], 1)
        return vector @ self.rotations[-1], _LARGEST * torch.stack(squashed).sum((0, 2))

    def inverse(self, latent: Float[Tensor, "batch size"]) -> Float[Tensor, "batch size"]:
        """Return the vectors that `forward` takes to ``latent``."""
        for net, rotation in zip(reversed(self.nets), reversed(self.rotations), strict=True):
            kept, changed = (latent @ rotation.mT).split([self.kept, self.size - self.kept], 1)
            scale, shift = net(kept).chunk(2, 1)
            latent = torch.cat([kept, (changed - shift) * (-_bounded(scale)).exp()], 1)
        return latent

    def surprise(self, vector: Float[Tensor, "batch size"]) -> Float[Tensor, " batch"]:
        """Return the negative log-likelihood in nats, without its constant."""
        if any(parameter.requires_grad for parameter in self.parameters()):
            latent, volume = self(vector)
            return 0.5 * latent.square().sum(1) - volume
        products = chain.from_iterable(self._products())
        with fast_products("highest"):  # the fast way is for large products
            return _FrozenSurprise.apply(vector, self.rotations[-1], self.kept, *products)[0]  # type: ignore[index]


def _coupling(vector: Tensor, kept: int, products: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """Return a block's numbers: what it keeps and changes, its hidden layer, the log scale over its bound, scale and shift."""
    enter, enter_bias, leave, leave_bias = products
    sizes = [kept, len(enter) - kept, len(enter_bias) - len(enter)]
    same, changed, hidden = torch.addmm(enter_bias, vector, enter).split(sizes, 1)
    hidden = hidden.relu()
    scale, shift = torch.addmm(leave_bias, hidden, leave).chunk(2, 1)
    scale = scale.contiguous().tanh()  # twice as fast as on columns
    return same, changed, hidden, scale, (_LARGEST * scale).exp(), shift


class _FrozenSurprise(torch.autograd.Function):
    """`CouplingFlow.surprise` of a flow that is not trained: its gradient takes half the time of autograd's."""

    generate_vmap_rule = True

    @staticmethod
    def forward(vector: Tensor, rotation: Tensor, kept: int, *products: Tensor) -> tuple[Tensor, Tensor]:
        blocks = [products[place : place + 4] for place in range(0, len(products), 4)]
        steps, one = [], torch.ones_like(rotation[0, 0])
        for block in blocks:
            step = _coupling(vector, kept, block)
            steps.append(step)
            vector = torch.cat([step[0], torch.addcmul(step[5], step[1], step[4])], 1)
        latent = vector @ rotation
        surprise = 0.5 * latent.square().sum(1) - _LARGEST * torch.stack([step[3] for step in steps]).sum((0, 2))
        slope = latent @ rotation.mT
        for (_, changed, hidden, scale, factor, _), (enter, _, leave, _) in zip(
            reversed(steps), reversed(blocks), strict=True
        ):
            of_kept, of_changed = slope.split([kept, len(rotation) - kept], 1)
            scaled = of_changed * factor
            of_scale = torch.addcmul(-one, scaled, changed) * torch.addcmul(one, scale, scale, value=-1) * _LARGEST
            of_hidden = (torch.cat([of_scale, of_changed], 1) @ leave.mT) * hidden.sign()
            slope = torch.cat([of_kept, scaled, of_hidden], 1) @ enter.mT
        return surprise, slope

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: tuple[Tensor, Tensor]) -> None:
        ctx.save_for_backward(output[1])
        ctx.mark_non_differentiable(output[1])
        ctx.count = len(inputs)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        return (gradients[0].unsqueeze(1) * ctx.saved_tensors[0], *[None] * (ctx.count - 1))


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
