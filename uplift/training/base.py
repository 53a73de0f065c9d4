"""`LifterTraining`, the base of all training of lifters: random streams, schedule, optimiser, averaged weights."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import count
from typing import Any, Generic, TypeVar, cast

import lightning as L
import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from uplift.config.settings import StageSettings
from uplift.data.samples import Samples
from uplift.priors.base import Lift, ShapeLift
from uplift.training.objective import Logged, Objective

__all__ = ["LifterTraining", "stream_seed"]


def stream_seed(seed: int, rank: int, step: int) -> int:
    """Return the seed of the random stream of one step, different for every seed, rank and step.

    It needs no saved state: a resumed fit draws the same numbers as an uninterrupted one.
    """
    mixed = 0x9E3779B97F4A7C15
    for part in (seed, rank, step):
        mixed = (mixed ^ (part & 0xFFFFFFFFFFFFFFFF)) * 0xBF58476D1CE4E5B9 & 0xFFFFFFFFFFFFFFFF
        mixed ^= mixed >> 29
    return mixed >> 1


def _average(decay: float):
    """Return the rule of an exponential moving average, with a shorter memory over the first steps."""

    @torch.no_grad()
    def update(averaged: Any, current: Any, updates: Tensor | int) -> None:
        so_far = float(updates)
        torch._foreach_lerp_(averaged, current, 1 - min(decay, (1 + so_far) / (10 + so_far)))

    return update


LifterT = TypeVar("LifterT", bound=nn.Module)
DataT = TypeVar("DataT", bound=Samples)


class LifterTraining(L.LightningModule, Generic[LifterT, DataT]):
    """Train ``lifter`` with automatic optimisation: one optimiser, one backward pass per step.

    A subclass writes `objective`. `final` is the trained lifter: its averaged weights where
    `StageSettings.average` is set. ``terms`` are the priors that judge it, if any; their own parameters are
    trained at ``prior_rate``, or the lifter's rate.
    """

    logged: Logged
    """The terms of the last step."""
    last_lift: Lift | ShapeLift | None = None
    """What priors judged in the last step."""

    def __init__(
        self,
        lifter: LifterT,
        data: DataT,
        settings: StageSettings,
        seed: int,
        terms: Objective | None = None,
        prior_rate: float | None = None,
    ):
        super().__init__()
        self.lifter, self.data, self.settings, self.seed = lifter, data, settings, seed
        self.done = 0.0
        """Share of the stage that is over, 0..1; kept by `uplift.training.callbacks.Budget`."""
        self.averaged: AveragedModel | None = None
        if settings.average:
            self.averaged = AveragedModel(lifter, multi_avg_fn=_average(settings.average))
            # Nothing trains them, and ranks must not wait for their gradients.
            self.averaged.requires_grad_(False)
        self.terms = terms or Objective({}, {})
        self.priors = nn.ModuleDict(self.terms.priors)
        self.prior_rate = prior_rate or settings.learning_rate

    @property
    def final(self) -> LifterT:
        """The lifter to evaluate and predict with."""
        return self.lifter if self.averaged is None else cast(LifterT, self.averaged.module)

    def objective(self) -> tuple[Tensor, Logged]:
        """Return the loss of one random batch and the numbers to log."""
        raise NotImplementedError

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return the optimiser's groups: the lifter's, and one for each prior that has parameters."""
        lifter = {"params": list(self.lifter.parameters()), "lr": self.settings.learning_rate, "name": "lifter"}
        return [lifter, *self.terms.parameter_groups(self.prior_rate)]

    def train_dataloader(self) -> Iterable[int]:
        """Return an endless count of steps: the data are on the device, and each step draws a batch."""
        return count()

    def on_fit_start(self) -> None:
        """Move the data set to the model's device."""
        self.data = self.data.to(self.device)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return one Adam over all groups; each keeps its peak rate for the schedule."""
        groups = [{**group, "peak": group["lr"]} for group in self.parameter_groups()]
        s = self.settings
        # The fused kernel needs floating-point parameters of one device type, which ours are.
        return torch.optim.Adam(groups, betas=(s.beta1, s.beta2), weight_decay=s.weight_decay, fused=True)

    def on_train_batch_start(self, batch: int, batch_idx: int) -> None:
        """Set the learning rate for the share of the stage that is over."""
        factor = self.schedule(self.done)
        for group in self.optimizers().param_groups:  # type: ignore[union-attr]
            group["lr"] = group["peak"] * factor

    def schedule(self, done: float) -> float:
        """Return the learning rate's factor: warm up, constant to `decay_from`, half a cosine down to 2 %."""
        warm = min(1.0, (done + 1e-3) / self.settings.warm_up) if self.settings.warm_up else 1.0
        if self.settings.decay_from >= 1:
            return warm
        over = max(0.0, (done - self.settings.decay_from) / (1 - self.settings.decay_from))
        return warm * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(1.0, over))))

    def training_step(self, batch: int, batch_idx: int) -> Tensor:
        """Seed this step's random stream and return the loss of a batch drawn from it."""
        torch.manual_seed(stream_seed(self.seed, self.global_rank, self.global_step))
        loss, self.logged = self.objective()
        return loss

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep how much of the stage is over."""
        checkpoint["done"] = self.done

    def on_before_optimizer_step(self, optimizer: torch.optim.Optimizer) -> None:
        """Remove the gradients of gated parameters: Adam then skips them, momentum and decay included."""
        for parameter in self.terms.gated_parameters(self.lifter):
            parameter.grad = None

    def optimizer_step(self, *arguments: Any, **options: Any) -> None:
        """Take the step and update the average, so that a checkpoint of this step holds both."""
        super().optimizer_step(*arguments, **options)
        if self.averaged is not None:
            self.averaged.update_parameters(self.lifter)
