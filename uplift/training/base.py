"""`LifterTraining`, what all training of lifters shares: random streams, schedule, optimiser, averaged weights."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Generic, Protocol, TypeVar, cast, runtime_checkable

import lightning as L
import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader, IterableDataset

from uplift.config.settings import StageSettings

__all__ = ["LifterTraining", "stream_seed"]


def stream_seed(seed: int, rank: int, step: int) -> int:
    """Return the seed of one step's random stream: a different one for every seed, rank and step.

    Streams that are a function of the step need no saved state: a resumed fit draws the same numbers as
    an uninterrupted one, and no two ranks draw the same.
    """
    mixed = 0x9E3779B97F4A7C15
    for part in (seed, rank, step):
        mixed = (mixed ^ (part & 0xFFFFFFFFFFFFFFFF)) * 0xBF58476D1CE4E5B9 & 0xFFFFFFFFFFFFFFFF
        mixed ^= mixed >> 29
    return mixed >> 1


def _average(decay: float):
    """Return the rule of an exponential moving average, with a shorter memory over the first steps."""

    def update(averaged: Any, current: Any, count: Tensor | int) -> None:
        so_far = float(count)
        torch._foreach_lerp_(averaged, current, 1 - min(decay, (1 + so_far) / (10 + so_far)))

    return torch.no_grad()(update)


class _Steps(IterableDataset):
    """An endless count of steps: the data are already on the device, and each step draws its own batch."""

    def __iter__(self) -> Iterator[int]:
        step = 0
        while True:
            yield step
            step += 1


@runtime_checkable
class _Data(Protocol):
    def to(self, device: Any) -> Any:
        """Return the data on another device."""


LifterT = TypeVar("LifterT", bound=nn.Module)
DataT = TypeVar("DataT", bound=_Data)


class LifterTraining(L.LightningModule, Generic[LifterT, DataT]):
    """Train ``lifter`` with automatic optimisation: one optimiser, one backward pass per step.

    A subclass writes `objective`. `final` is the trained lifter: its averaged weights where
    `StageSettings.average` is set.
    """

    def __init__(self, lifter: LifterT, data: DataT, settings: StageSettings, seed: int):
        super().__init__()
        self.lifter = lifter
        self.settings = settings
        self.seed = seed
        self.data = data
        self.done = 0.0
        """Share of the stage that is over, 0..1; kept by `uplift.training.callbacks.Budget`."""
        self.averaged: AveragedModel | None = None
        if settings.average:
            self.averaged = AveragedModel(lifter, multi_avg_fn=_average(settings.average))
            # Nothing trains them, and ranks must not wait for their gradients.
            self.averaged.requires_grad_(False)

    @property
    def final(self) -> LifterT:
        """The lifter to evaluate and predict with."""
        return self.lifter if self.averaged is None else cast(LifterT, self.averaged.module)

    def objective(self) -> tuple[Tensor, dict[str, float | Tensor]]:
        """Return the loss of one random batch and the numbers to log."""
        raise NotImplementedError

    def more_metrics(self) -> dict[str, float]:
        """Return more numbers to log of the last step; called only when a row is written."""
        return {}

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return the optimiser's groups; the first is the lifter's."""
        return [{"params": list(self.lifter.parameters()), "lr": self.settings.learning_rate, "name": "lifter"}]

    def gated_parameters(self) -> Iterator[nn.Parameter]:
        """Return the parameters that this step must leave as they are."""
        return iter(())

    def train_dataloader(self) -> DataLoader:
        """Return an endless count of steps."""
        return DataLoader(_Steps(), batch_size=None)

    def on_fit_start(self) -> None:
        """Move the data set to the model's device."""
        self.data = self.data.to(self.device)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return one Adam over all groups; a group keeps its own peak rate for the schedule."""
        groups = self.parameter_groups()
        for group in groups:
            group["peak"] = group["lr"]
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
        loss, logged = self.objective()
        self.logged = logged
        return loss

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep how much of the stage is over."""
        checkpoint["done"] = self.done

    def on_before_optimizer_step(self, optimizer: torch.optim.Optimizer) -> None:
        """Remove the gradients of gated parameters: Adam then skips them, momentum and decay included."""
        for parameter in self.gated_parameters():
            parameter.grad = None

    def optimizer_step(self, *arguments: Any, **options: Any) -> None:
        """Take the step and update the average, so that a checkpoint of this step holds both."""
        super().optimizer_step(*arguments, **options)
        if self.averaged is not None:
            self.averaged.update_parameters(self.lifter)
