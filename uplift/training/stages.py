"""Run the stages of a fit, each with its budget, checkpoint and progress."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import lightning as L
from lightning.fabric.utilities.exceptions import MisconfigurationException

from uplift.config import TrainerSettings
from uplift.errors import UserError
from uplift.limits import seconds_of
from uplift.torch_file import read_torch
from uplift.training.base import LifterTraining
from uplift.training.budget import Budget, Interrupted
from uplift.training.checkpoint import Checkpoints, check_checkpoint
from uplift.training.progress import MetricsFile, Progress
from uplift.training.threads import Threads

__all__ = ["StageBudget", "run_stage", "stage_budgets"]


@dataclass(frozen=True)
class StageBudget:
    """What one stage may spend; at least one of the two is set."""

    steps: int | None
    seconds: float | None


def stage_budgets(trainer: TrainerSettings, shares: Sequence[float], frames: int, batch_size: int) -> list[StageBudget]:
    """Split the fit's steps and time over its stages by their shares."""
    total = sum(shares)
    steps = trainer.max_steps
    if trainer.max_epochs is not None:
        by_epochs = max(1, round(trainer.max_epochs * frames / batch_size))
        steps = by_epochs if steps is None else min(steps, by_epochs)
    seconds = None if trainer.max_time is None else seconds_of(trainer.max_time)
    if steps is not None and steps < sum(share > 0 for share in shares):
        raise UserError(f"{steps} steps are too few for {sum(s > 0 for s in shares)} stages: one each at least.")
    ends = [0] if steps is None else [round(steps * sum(shares[: i + 1]) / total) for i in range(len(shares))]
    return [
        StageBudget(
            None if steps is None else max(1, ends[i] - (ends[i - 1] if i else 0)),
            None if seconds is None else seconds * share / total,
        )
        for i, share in enumerate(shares)
    ]


def run_stage(
    name: str,
    module: LifterTraining,
    settings: TrainerSettings,
    budget: StageBudget,
    folder: Path,
    before: float = 0.0,
    on_save: Callable[[], None] | None = None,
) -> Budget:
    """Train ``module`` for its budget, or what is left of it where ``folder`` has a checkpoint of it.

    ``before`` are seconds of the budget that are spent already; ``on_save`` is called after each checkpoint.

    Raises:
        Interrupted: after Ctrl-C, with everything saved.
        UserError: a checkpoint that does not fit, settings that Lightning refuses.
    """
    path = folder / "checkpoints" / f"{name}.ckpt"
    clock = Budget(steps=budget.steps, seconds=budget.seconds, spent=min(before, 0.5 * (budget.seconds or 0)))
    resume = path.is_file()
    if resume and check_checkpoint(path, module) >= 1:
        state = read_torch(path, "checkpoint")
        module.load_state_dict(state["state_dict"])
        clock.load_state_dict(state["callbacks"][clock.state_key])
        return clock
    saver = Checkpoints(path, seconds=settings.checkpoint_every, steps=settings.checkpoint_steps, on_save=on_save)
    callbacks: list[L.Callback] = [
        clock,
        Progress(name, clock),
        MetricsFile(folder / "metrics.csv", name, settings.log_every),
        saver,
    ]
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
    from lightning.pytorch import loggers

    kinds = {"tensorboard": "TensorBoardLogger", "wandb": "WandbLogger"}
    if name not in kinds:
        raise UserError(
            f"trainer.logger={name!r}: expected one of {', '.join(kinds)}, or none (metrics.csv is always written)."
        )
    try:
        return getattr(loggers, kinds[name])(save_dir=str(folder), name=name)
    except ModuleNotFoundError as error:
        raise UserError(f"trainer.logger={name}: {str(error).splitlines()[0]}") from error


class _quiet:
    """Keep Lightning from telling what our own lines say better."""

    def __enter__(self) -> None:
        names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] in ("lightning", "lightning_fabric")]
        self._levels = {name: logging.getLogger(name).level for name in names}
        for name in self._levels:
            logging.getLogger(name).setLevel(logging.ERROR)
        self._caught = warnings.catch_warnings()
        self._caught.__enter__()
        warnings.filterwarnings("ignore", module="lightning")
        warnings.filterwarnings("ignore", message=".*(num_workers|log_every_n_steps|litlogger|tensorboardX).*")

    def __exit__(self, *error: object) -> None:
        self._caught.__exit__(*error)  # type: ignore[arg-type]
        for name, level in self._levels.items():
            logging.getLogger(name).setLevel(level)
