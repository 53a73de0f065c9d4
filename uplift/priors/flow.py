"""The likelihood of a rotated view under a normalising flow that is first fitted to the real keypoints."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor, nn

from uplift.config.files import cache_folder
from uplift.config.safe_weights import ENDING, read_safe, save_safe
from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.geometry.normalise import mirror
from uplift.models.networks import CouplingFlow
from uplift.priors.base import Lift, Prior
from uplift.priors.imputation import impute_gaussian
from uplift.skeleton import Skeleton

__all__ = ["Flow"]

_FORMAT = 1
"""Of the flows in the cache: one more wherever the fit changes."""
_MOST_KEPT = 200
"""Flows in the cache, of about 0.1 MB each."""


class Flow(Prior):
    """Negative log-likelihood of the rotated view, in nats, under a frozen flow (ElePose, Wandt et al. 2022, 3.2).

    Before the first step the flow is fitted to the real keypoints with Adam. As normalised keypoints lie on a surface
    (their mean radius is 1), on which a density is unbounded, noise is added to them. Missing joints are imputed. A fitted
    flow is kept in the user's cache, for the next fit with the same keypoints, options and seed.

    Args:
        skeleton: of the poses.
        joints: names of the joints that count; all if empty.
        axes: whitened principal components that the flow acts on.
        blocks: affine coupling blocks.
        units: width of the layers of a block.
        noise: standard deviation, in mean 2D radii.
        steps: optimiser steps of the flow's fit.
        batch_size: frames a step of it.
        learning_rate: Adam's.
    """

    ranges: ClassVar = {
        "axes": (1, 10_000), "blocks": (1, 256), "units": (1, 2048), "steps": (1, 10**6), "batch_size": (2, 1 << 17),
    }  # fmt: skip
    mean: Tensor
    whiten: Tensor
    usual: Tensor
    places: Tensor

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        joints: Sequence[str] = (),
        axes: int = 26,
        blocks: int = 8,
        units: int = 64,
        noise: float = 0.05,
        steps: int = 1000,
        batch_size: int = 512,
        learning_rate: float = 2e-3,
    ):
        super().__init__(skeleton)
        places = [skeleton.index(name) for name in (joints or skeleton.joints) if name != skeleton.root]
        size = min(axes, 2 * len(places))
        self.noise, self.steps, self.batch_size, self.learning_rate = noise, steps, batch_size, learning_rate
        self.register_buffer("places", torch.tensor(places), persistent=False)
        self.register_buffer("mean", torch.zeros(2 * len(places)))
        self.register_buffer("whiten", torch.zeros(2 * len(places), size))
        self.register_buffer("usual", torch.zeros(()))
        self.flow = CouplingFlow(size, blocks=blocks, units=units).requires_grad_(False)

    def prepare(self, data: TrainingSet) -> None:
        """Fit the flow to the training keypoints, mirrored ones beside them, and freeze it."""
        kept = cache_folder("flows") / f"{self._key(data)}{ENDING}"
        with contextlib.suppress(UserError, RuntimeError, KeyError):  # not there, or damaged: it is only a cache
            found = read_safe(kept, "flow")
            if _digest(found["state"][name] for name in sorted(found["state"])) == found["digest"]:
                torch.set_rng_state(
                    found["state"].pop("random")
                )  # what comes next draws the numbers it drew after the fit
                self.load_state_dict(found["state"])
                kept.touch()
                return
        real = impute_gaussian(data.keypoints, data.confidence)
        if self.skeleton.has_mirror_image:
            swap = torch.as_tensor(self.skeleton.mirror_permutation.copy(), device=real.device)
            real = torch.cat([real, mirror(real, swap)])
        real = real[:, self.places].flatten(1)
        self._whiten(real)
        self._fit(real)
        self._keep(kept)

    def _key(self, data: TrainingSet) -> str:
        """Return a name for all that the fitted flow depends on: keypoints, options, first weights, random numbers."""
        tensors = [
            torch.get_rng_state(),
            *self.flow.state_dict().values(),
            self.places,
            data.keypoints,
            data.confidence,
        ]
        swap = tuple(self.skeleton.mirror_permutation) if self.skeleton.has_mirror_image else ()
        options = (self.noise, self.steps, self.batch_size, self.learning_rate)
        return _digest(tensors, _FORMAT, torch.__version__, data.keypoints.device, swap, options)

    def _keep(self, path: Path) -> None:
        """Keep the fitted flow in the cache, and of all flows there those that were used last."""
        state = {name: tensor.detach().cpu() for name, tensor in self.state_dict().items()}
        state["random"] = torch.get_rng_state()
        with contextlib.suppress(OSError, UserError):  # no space, no permission
            path.parent.mkdir(parents=True, exist_ok=True)
            save_safe({"state": state, "digest": _digest(state[name] for name in sorted(state))}, path)
            by_use = sorted(path.parent.glob(f"*{ENDING}"), key=lambda one: one.stat().st_mtime)
            for stale in by_use[:-_MOST_KEPT]:
                stale.unlink(missing_ok=True)

    def _whiten(self, real: Tensor) -> None:
        self.mean.copy_(real.mean(0))
        offset = real - self.mean
        variance, axes = torch.linalg.eigh(offset.mT @ offset / len(offset))
        size = self.whiten.shape[1]
        self.whiten.copy_(axes[:, -size:] / (variance[-size:].clamp_min(0) + self.noise**2).sqrt())

    @torch.enable_grad()
    def _fit(self, real: Tensor) -> None:
        self.flow.requires_grad_(True)
        adam = torch.optim.Adam(self.flow.parameters(), lr=self.learning_rate, fused=True)
        for step in range(self.steps):
            for group in adam.param_groups:
                group["lr"] = self.learning_rate * (0.02 + 0.49 * (1 + math.cos(math.pi * step / self.steps)))
            rows = torch.randint(len(real), (self.batch_size,), device=real.device)
            seen = real[rows] + self.noise * torch.randn(self.batch_size, real.shape[1], device=real.device)
            loss = self._surprise(seen).mean()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.flow.parameters(), 5.0)
            adam.step()
        self.flow.requires_grad_(False)
        self.flow.zero_grad()
        some = real[:: max(1, len(real) // 5000)]
        self.usual.copy_(self._surprise(some).detach().median())

    def _surprise(self, flat: Tensor) -> Tensor:
        return self.flow.surprise((flat - self.mean) @ self.whiten)

    def loss(self, lift: Lift) -> Tensor:
        """Return each view's negative log-likelihood minus the median of real keypoints, as a logarithm above 0."""
        surprise = self._surprise(lift.reprojected.index_select(1, self.places).flatten(1)) - self.usual
        # A flow is arbitrary and steep far from its data: no view may outweigh the rest.
        width, above = float(self.whiten.shape[1]), surprise.relu()
        return surprise - above + width * torch.log1p(above / width)


def _digest(tensors: Iterable[Tensor], *options: object) -> str:
    found = hashlib.sha256(repr(options).encode())
    for tensor in tensors:
        found.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return found.hexdigest()[:32]
