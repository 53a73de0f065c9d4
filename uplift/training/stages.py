"""`Recipe`, the stages of a fit, and `run_stage`, which runs one with its budget, checkpoints and progress."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, TypeVar

import lightning as L
import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch import loggers
from torch import nn

from uplift.config.run import RunFolder
from uplift.config.settings import Settings, TrainerSettings, seconds_of
from uplift.errors import UserError
from uplift.priors import build_priors
from uplift.skeleton import Skeleton
from uplift.training.base import LifterTraining
from uplift.training.callbacks import (
    AtomicCheckpointIO,
    Budget,
    Checkpoints,
    Interrupted,
    MetricsFile,
    Progress,
    Threads,
    checked_checkpoint,
)

__all__ = ["Recipe", "StageBudget", "run_stage", "stage_budgets"]

LifterT = TypeVar("LifterT", bound=nn.Module)


class Recipe:
    """The stages of one fit; a subclass defines them and what each learns from the one before it.

    ``priors`` are the settings of the priors, ``skeleton`` is None for priors of shapes.
    """

    def __init__(self, settings: Settings, priors: Mapping[str, Any], skeleton: Skeleton | None):
        self.settings = settings
        self.budgets: dict[str, StageBudget] = {}
        self.spent: dict[str, float] = {}
        """Seconds that each stage took."""
        torch.manual_seed(settings.seed)
        self.priors, self.weights, self.notes = build_priors(priors, skeleton)

    def share_budget(self, shares: Mapping[str, float], frames: int) -> None:
        """Split the fit's steps and time over its stages by their shares; an epoch is so many ``frames``."""
        budgets = stage_budgets(self.settings.trainer, list(shares.values()), frames, self.settings.teacher.batch_size)
        self.budgets = dict(zip(shares, budgets, strict=True))

    def stage(self, run: RunFolder, name: str, build: Callable[[], LifterTraining[LifterT, Any]]) -> LifterT:
        """Build the training of one stage, run it and return its lifter; building counts for its budget."""
        start = time.monotonic()
        training = build()
        before = time.monotonic() - start
        clock = run_stage(name, training, self.settings.trainer, self.budgets[name], run.path, before, run.link_last)
        self.spent[name] = clock.spent
        return training.final


@dataclass(frozen=True)
class StageBudget:
    """The limits of one stage; at least one of the two is set."""

    steps: int | None
    seconds: float | None


def stage_budgets(trainer: TrainerSettings, shares: Sequence[float], frames: int, batch_size: int) -> list[StageBudget]:
    """Split the fit's steps and time over its stages by their shares."""
    total, stages = sum(shares), sum(share > 0 for share in shares)
    steps: list[int | None] = [None] * len(shares)
    limits = [] if trainer.max_steps is None else [trainer.max_steps]
    if trainer.max_epochs is not None:
        limits.append(max(1, round(trainer.max_epochs * frames / batch_size)))
    if limits:
        most = min(limits)
        if most < stages:
            raise UserError(f"{most} steps are too few for {stages} stages: one each at least.")
        ends = [round(most * share / total) for share in accumulate(shares)]
        steps = [max(1, end - start) for start, end in pairwise([0, *ends])]
    seconds = None if trainer.max_time is None else seconds_of(trainer.max_time)
    times = [None if seconds is None else seconds * share / total for share in shares]
    return [StageBudget(*both) for both in zip(steps, times, strict=True)]


def run_stage(
    name: str,
    module: LifterTraining,
    settings: TrainerSettings,
    budget: StageBudget,
    folder: Path,
    before: float = 0.0,
    on_save: Callable[[], None] | None = None,
) -> Budget:
    """Train ``module`` for its budget, or for the rest of it if the run's ``folder`` has a checkpoint of this stage.

    ``before`` are seconds of the budget that are already spent; ``on_save`` is called after each checkpoint.

    Raises:
        Interrupted: after Ctrl-C, with everything saved.
        UserError: a checkpoint that does not fit, settings that Lightning refuses.
    """
    path = folder / "checkpoints" / f"{name}.ckpt"
    clock = Budget(steps=budget.steps, seconds=budget.seconds, spent=min(before, 0.5 * (budget.seconds or 0)))
    resume = path.is_file()
    if resume and (state := checked_checkpoint(path, module))["done"] >= 1:
        module.load_state_dict(state["state_dict"])
        clock.load_state_dict(state["callbacks"][clock.state_key])
        return clock
    saver = Checkpoints(path, seconds=settings.checkpoint_every, steps=settings.checkpoint_steps, on_save=on_save)
    metrics = MetricsFile(folder / "metrics.csv", name, settings.log_every)
    callbacks: list[L.Callback] = [clock, Progress(name, clock), metrics, saver]
    if settings.threads is None and budget.steps is None:
        callbacks.append(Threads())
    with clock, _quiet():
        trainer = _trainer(settings, callbacks, folder)
        trainer.fit(module, ckpt_path=str(path) if resume else None, weights_only=True)
    if clock.interrupted:
        raise Interrupted(folder)
    return clock


def _trainer(settings: TrainerSettings, callbacks: list[L.Callback], folder: Path) -> L.Trainer:
    devices: int | str = int(settings.devices) if settings.devices.lstrip("-").isdigit() else settings.devices
    try:
        return L.Trainer(
            accelerator=settings.accelerator,
            devices=devices,
            precision=settings.precision,  # type: ignore[arg-type]
            logger=_logger(settings.logger, folder),
            callbacks=callbacks,
            plugins=AtomicCheckpointIO(),
            max_epochs=-1,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            num_sanity_val_steps=0,
            use_distributed_sampler=False,
            default_root_dir=folder,
        )
    except (ValueError, TypeError, RuntimeError, MisconfigurationException) as error:
        raise UserError(
            f"Lightning refuses trainer.accelerator={settings.accelerator}, trainer.devices={settings.devices}, "
            f"trainer.precision={settings.precision}: {error}"
        ) from error


def _logger(name: str | None, folder: Path):
    if name in (None, "none", "csv"):
        return False
    kinds = {"tensorboard": "TensorBoardLogger", "wandb": "WandbLogger"}
    if name not in kinds:
        raise UserError(
            f"trainer.logger={name!r}: expected one of {', '.join(kinds)}, or none (metrics.csv is always written)."
        )
    try:
        return getattr(loggers, kinds[name])(save_dir=str(folder), name=name)
    except ModuleNotFoundError as error:
        raise UserError(f"trainer.logger={name}: {str(error).splitlines()[0]}") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence messages of Lightning that repeat or contradict ours."""
    names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] in ("lightning", "lightning_fabric")]
    levels = {logging.getLogger(name): logging.getLogger(name).level for name in names}
    for logger in levels:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="lightning")
            warnings.filterwarnings("ignore", message=".*(num_workers|log_every_n_steps|litlogger|tensorboardX).*")
            yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)
