"""A normalising flow over real 2D keypoints: how likely is a turned view?"""

from __future__ import annotations

import math
import time

import torch
from jaxtyping import Float
from torch import Tensor, nn

import uplift
from uplift.pose import mirror

__all__ = ["Flow", "FlowPrior"]

_CLAMP = 2.0  # of a block's log scale, so that no block can blow up


class Flow(nn.Module):
    """Affine coupling blocks, a fixed rotation after each (Dinh et al. 2017; Kingma & Dhariwal 2018).

    ``forward`` returns the latent vector and the log-determinant of its Jacobian; ``inverse`` goes back.
    """

    rotations: Tensor

    def __init__(self, size: int, *, blocks: int = 8, units: int = 1024, seed: int = 0):
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
        return _CLAMP * torch.tanh(log_scale / _CLAMP), shift

    def forward(self, x: Float[Tensor, "batch size"]) -> tuple[Float[Tensor, "batch size"], Float[Tensor, " batch"]]:
        """Return the latent vectors and the log-determinants of the Jacobian."""
        volume = x.new_zeros(len(x))
        for net, rotation in zip(self.nets, self.rotations, strict=True):
            kept, changed = x[:, : self.kept], x[:, self.kept :]
            log_scale, shift = self._affine(net, kept)
            volume = volume + log_scale.sum(1)
            x = torch.cat([kept, changed * log_scale.exp() + shift], 1) @ rotation
        return x, volume

    def inverse(self, z: Float[Tensor, "batch size"]) -> Float[Tensor, "batch size"]:
        """Return the vectors that `forward` takes to ``z``."""
        for net, rotation in zip(reversed(self.nets), self.rotations.flip(0), strict=True):  # type: ignore[call-overload]
            z = z @ rotation.mT
            kept, changed = z[:, : self.kept], z[:, self.kept :]
            log_scale, shift = self._affine(net, kept)
            z = torch.cat([kept, (changed - shift) * (-log_scale).exp()], 1)
        return z

    def surprise(self, x: Float[Tensor, "batch size"]) -> Float[Tensor, " batch"]:
        """Return the negative log-likelihood of ``x`` in nats, without its constant."""
        z, volume = self(x)
        return 0.5 * z.square().sum(1) - volume


class FlowPrior(uplift.Prior):
    """Negative log-likelihood of turned views under a flow that was fitted to real 2D first and then frozen.

    After Wandt et al. 2022, ElePose, 3.2: principal components of the normalised keypoints, affine coupling
    blocks. The flow is fitted in the first step of the training, so its ``seconds`` (or ``steps``, what is
    over first) are spent from the fit's own time. ``joints`` names the joints it looks at; all if empty.
    ``noise`` is added to the real keypoints in the fit: normalised keypoints lie on a surface (mean radius
    1), on which a density has no bound.
    """

    mean: Tensor
    whiten: Tensor
    fitted: Tensor

    def __init__(self, skeleton, *, joints: tuple = (), axes: int = 26, blocks: int = 8, units: int = 256,
                 noise: float = 0.02, seconds: float = 60.0, steps: int = 1_000_000, batch_size: int = 512,
                 learning_rate: float = 1e-3):  # fmt: skip
        super().__init__(skeleton)
        chosen = [name for name in joints or skeleton.joints if name != skeleton.root]
        self.joints = [skeleton.index(name) for name in chosen]
        size = min(axes, 2 * len(self.joints))
        self.noise, self.seconds, self.steps = noise, seconds, steps
        self.batch_size, self.learning_rate = batch_size, learning_rate
        self.register_buffer("mean", torch.zeros(2 * len(self.joints)))
        self.register_buffer("whiten", torch.zeros(2 * len(self.joints), size))
        self.register_buffer("fitted", torch.zeros((), dtype=torch.bool))
        self.flow = Flow(size, blocks=blocks, units=units).requires_grad_(False)

    def prepare(self, data) -> None:
        """Keep the frames on which all the joints are seen; the principal components are theirs."""
        whole = (data.confidence[:, self.joints] > 0).all(1)
        if int(whole.sum()) <= len(self.mean):
            raise uplift.UserError(f"FlowPrior: {int(whole.sum())} frames with all its joints are too few.")
        real = data.keypoints[whole]
        if self.skeleton.mirror:
            swap = torch.as_tensor(self.skeleton.mirror_permutation.copy(), device=real.device)
            both_ways = (data.confidence[whole][:, swap] > 0)[:, self.joints].all(1)
            real = torch.cat([real, mirror(real[both_ways], swap)])
        self.real = real[:, self.joints].flatten(1)

    def _fit(self) -> None:
        """Fit the flow to the kept frames and freeze it."""
        start, real = time.monotonic(), self.real.to(self.mean)
        self.mean.copy_(real.mean(0))
        offset = real - self.mean
        variance, axes = torch.linalg.eigh(offset.mT @ offset / len(offset))
        size = self.whiten.shape[1]
        self.whiten.copy_(axes[:, -size:] / (variance[-size:].clamp_min(0) + self.noise**2).sqrt())
        self.flow.requires_grad_(True)
        adam = torch.optim.Adam(self.flow.parameters(), lr=self.learning_rate)
        for step in range(self.steps):
            done = max(step / self.steps, (time.monotonic() - start) / max(self.seconds, 1e-9))
            if done >= 1:
                break
            for group in adam.param_groups:
                group["lr"] = self.learning_rate * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * done)))
            rows = torch.randint(len(real), (self.batch_size,), device=real.device)
            seen = real[rows] + self.noise * torch.randn(self.batch_size, real.shape[1], device=real.device)
            loss = self.flow.surprise((seen - self.mean) @ self.whiten).mean()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.flow.parameters(), 5.0)
            adam.step()
        self.flow.requires_grad_(False)
        self.flow.zero_grad()
        self.fitted.fill_(True)
        del self.real

    def loss(self, lift):
        """Return the surprise at each turned view whose joints were all seen in the real one."""
        if not self.fitted:
            with torch.enable_grad():
                self._fit()
        seen = lift.seen[:, self.joints].flatten(1)
        return self.flow.surprise((seen - self.mean) @ self.whiten) * lift.visible[:, self.joints].prod(1)
