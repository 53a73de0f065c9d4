"""A normalising flow of affine coupling blocks: how likely is a vector?"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

__all__ = ["CouplingFlow"]

_LARGEST = 2.0
"""Of a block's log scale, so that no block can blow up."""


class CouplingFlow(nn.Module):
    """Affine coupling blocks, a fixed rotation after each (Dinh et al. 2017; Kingma and Dhariwal 2018).

    ``forward`` returns the latent vector and the log-determinant of its Jacobian; ``inverse`` goes back.
    """

    rotations: Tensor

    def __init__(self, size: int, *, blocks: int = 8, units: int = 64, seed: int = 0):
        super().__init__()
        self.kept = size // 2
        changed = size - self.kept
        self.nets = nn.ModuleList(
            nn.Sequential(nn.Linear(self.kept, units), nn.ReLU(), nn.Linear(units, 2 * changed)) for _ in range(blocks)
        )
        for net in self.nets:
            nn.init.zeros_(net[2].weight)  # type: ignore[index]
            nn.init.zeros_(net[2].bias)  # type: ignore[index]
        random = torch.randn(blocks, size, size, generator=torch.Generator().manual_seed(seed))
        self.register_buffer("rotations", torch.linalg.qr(random).Q)

    def _affine(self, net: nn.Module, kept: Tensor) -> tuple[Tensor, Tensor]:
        log_scale, shift = net(kept).chunk(2, 1)
        return _LARGEST * torch.tanh(log_scale / _LARGEST), shift

    def forward(
        self, vector: Float[Tensor, "batch size"]
    ) -> tuple[Float[Tensor, "batch size"], Float[Tensor, " batch"]]:
        """Return the latent vectors and the log-determinants of the Jacobian."""
        volume = vector.new_zeros(len(vector))
        for net, rotation in zip(self.nets, self.rotations, strict=True):
            kept, changed = vector[:, : self.kept], vector[:, self.kept :]
            log_scale, shift = self._affine(net, kept)
            volume = volume + log_scale.sum(1)
            vector = torch.cat([kept, changed * log_scale.exp() + shift], 1) @ rotation
        return vector, volume

    def inverse(self, latent: Float[Tensor, "batch size"]) -> Float[Tensor, "batch size"]:
        """Return the vectors that `forward` takes to ``latent``."""
        for place in reversed(range(len(self.nets))):
            latent = latent @ self.rotations[place].mT
            kept, changed = latent[:, : self.kept], latent[:, self.kept :]
            log_scale, shift = self._affine(self.nets[place], kept)
            latent = torch.cat([kept, (changed - shift) * (-log_scale).exp()], 1)
        return latent

    def surprise(self, vector: Float[Tensor, "batch size"]) -> Float[Tensor, " batch"]:
        """Return the negative log-likelihood in nats, without its constant."""
        latent, volume = self(vector)
        return 0.5 * latent.square().sum(1) - volume
