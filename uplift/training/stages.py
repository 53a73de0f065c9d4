"""`Recipe`, the stages of a fit, and `run_stage`, which runs one with its budget, checkpoints, loggers and progress."""

from __future__ import annotations

import inspect
import logging
import os
import time
import typing
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
from lightning.pytorch import callbacks as lightning_callbacks
from lightning.pytorch.loggers import Logger

from uplift.config.device import ACCELERATORS, device_of, fast_products, precision_of
from uplift.config.plugins import build, find_class, users_line
from uplift.config.progress import is_quiet
from uplift.config.run import RunFolder
from uplift.config.settings import Settings, TrainerSettings, seconds_of
from uplift.errors import UserError
from uplift.training import launch
from uplift.training.base import TrainingModule
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

__all__ = [
    "Recipe",
    "StageBudget",
    "StageRecord",
    "build_callbacks",
    "build_loggers",
    "check_trainer",
    "first_device",
    "module_class",
    "run_stage",
    "stage_budgets",
]

ModuleT = TypeVar("ModuleT", bound=TrainingModule)


class Recipe:
    """The stages of one fit; a subclass defines them and what each learns from the one before it."""

    def __init__(self, settings: Settings):
        self.settings = settings
        self.notes: list[str] = []
        self.budgets: dict[str, StageBudget] = {}
        self.spent: dict[str, float] = {}
        """Seconds that each stage took."""
        self.steps: dict[str, int] = {}
        """Steps that each stage took."""
        self.idle_priors: dict[str, int] = {}
        """Steps of the priors that had no gradient in any of them."""
        self._loggers: list[Logger] | None = None
        build_callbacks(settings.callbacks)  # what is wrong with them is said before any training

    def share_budget(self, shares: Mapping[str, float], frames: int) -> None:
        """Split the fit's steps and time over its stages by their shares; an epoch is so many ``frames``."""
        trainer = self.settings.trainer
        frames_a_step = self.settings.teacher.batch_size * trainer.flags.get("accumulate_grad_batches", 1)
        budgets = stage_budgets(trainer, list(shares.values()), frames, frames_a_step)
        self.budgets = dict(zip(shares, budgets, strict=True))

    def stage(self, run: RunFolder, name: str, module: TrainingModule, data: Any, batch_size: int) -> None:
        """Train ``module`` for the budget of the stage ``name``; preparing it counts for that."""
        with fast_products(self.settings.trainer.products, training=True):
            self._stage(run, name, module, data, batch_size)

    def _stage(self, run: RunFolder, name: str, module: TrainingModule, data: Any, batch_size: int) -> None:
        start = time.monotonic()
        if self._loggers is None:  # one of each for all stages
            self._loggers = build_loggers(self.settings, run.path)
        module.prepare_on(first_device(self.settings.trainer), data)
        data.batch_size = batch_size
        module.log_prefix, module.first_step = name, sum(self.steps.values())
        record = run_stage(
            name,
            module,
            data,
            self.settings.trainer,
            self.budgets[name],
            run.path,
            before=time.monotonic() - start,
            on_save=run.link_last,
            callbacks=build_callbacks(self.settings.callbacks),
            loggers=self._loggers,
        )
        self.spent[name], self.steps[name] = record.spent, record.steps
        self.idle_priors |= module.terms.idle


def module_class(use: str | None, where: str, default: type[ModuleT]) -> type[ModuleT]:
    """Return the class of modules that the setting ``where`` names; raises UserError for what is not a ``default``."""
    if use is None:
        return default
    found = find_class(use, {}, where)
    if not issubclass(found, default):
        raise UserError(f"{where}: '{use}' is not a subclass of uplift.{default.__name__}.")
    return found


@dataclass(frozen=True)
class StageBudget:
    """The limits of one stage; at least one of the two is set."""

    steps: int | None
    seconds: float | None


@dataclass(frozen=True)
class StageRecord:
    """What a stage took."""

    spent: float
    """Seconds."""
    steps: int


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
    module: TrainingModule,
    data: L.LightningDataModule,
    settings: TrainerSettings,
    budget: StageBudget,
    folder: Path,
    *,
    before: float = 0.0,
    on_save: Callable[[], None] | None = None,
    callbacks: Sequence[L.Callback] = (),
    loggers: Sequence[Logger] = (),
    metrics: L.Callback | None = None,
) -> StageRecord:
    """Train ``module`` for its budget, or for the rest of it if the run's ``folder`` has a checkpoint of this stage.

    ``before`` are seconds of the budget that are already spent; ``on_save`` is called after each checkpoint; ``metrics``
    writes what is measured, to the run's metrics.csv if None.

    Raises:
        Interrupted: after Ctrl-C, with everything saved.
        UserError: a checkpoint that does not fit, settings that Lightning refuses.
    """
    path = folder / "checkpoints" / f"{name}.ckpt"
    clock = Budget(budget.seconds, spent=min(before, 0.5 * (budget.seconds or 0)))
    resume = path.is_file()
    if path.is_dir():
        raise UserError(f"{path} is a folder, where the checkpoint of this stage would be. Remove or rename it.")
    if resume and (state := checked_checkpoint(path, module))["done"] >= 1:
        module.on_load_checkpoint(state)
        module.load_state_dict(state["state_dict"])
        clock.load_state_dict(state["callbacks"][clock.state_key])
        return StageRecord(clock.time_elapsed(), state["global_step"])
    flags = _trainer_flags(settings, budget, has_val=data.val is not None)  # type: ignore[attr-defined]
    ours = {
        "callbacks": _stage_callbacks(path, clock, settings, budget, [*callbacks, metrics or _metrics(path, settings)]),
        "logger": list(loggers) or False,
        "plugins": [AtomicCheckpointIO(on_save), *launch.plugins()],
        "default_root_dir": folder,
    }
    with clock, _quiet("profiler" in settings.flags):
        trainer = _trainer(settings, flags, **ours)
        with _users_errors():
            trainer.fit(module, datamodule=data, ckpt_path=str(path) if resume else None, weights_only=True)
        if not clock.interrupted and module.done < 1:  # a callback such as EarlyStopping ended it
            module.done = 1.0
            trainer.save_checkpoint(path)
    if clock.interrupted:
        raise Interrupted(folder)
    return StageRecord(clock.time_elapsed(), trainer.global_step)


@contextmanager
def _users_errors() -> Iterator[None]:
    """Turn what Lightning refuses, and an error in a user's callback, logger or module, into a `UserError`."""
    try:
        yield
    except MisconfigurationException as error:
        raise UserError(f"Lightning refuses the fit: {error}") from error
    except (UserError, OSError, MemoryError):
        raise
    except Exception as error:
        where = users_line(error)
        if where is None or launch.is_lost(error):
            raise
        raise UserError(f"{where}: {type(error).__name__}: {error}") from error


def _metrics(path: Path, settings: TrainerSettings) -> MetricsFile:
    return MetricsFile(path.parent.parent / "metrics.csv", path.stem, settings.log_every)


def _stage_callbacks(
    path: Path, clock: Budget, settings: TrainerSettings, budget: StageBudget, given: Sequence[L.Callback]
) -> list[L.Callback]:
    """Return the callbacks of the stage whose checkpoint is ``path``: ours, and those ``given``."""
    callbacks: list[L.Callback] = [clock, *given]
    if settings.flags.get("enable_progress_bar", True) and not is_quiet():
        callbacks.append(Progress(path.stem, clock))
    if settings.threads is None and budget.steps is None:
        callbacks.append(Threads())
    return [*callbacks, Checkpoints(path, clock, seconds=settings.checkpoint_every, steps=settings.checkpoint_steps)]


# The trainer.

_VALIDATIONS = 10
"""Validations in a stage of a set number of steps."""
_VALIDATE_EVERY = 1000
"""Steps between validations in a stage by time."""


def _trainer_flags(settings: TrainerSettings, budget: StageBudget, *, has_val: bool) -> dict[str, Any]:
    """Return the flags of the trainer of a stage: ours, and the user's over them."""
    every = _VALIDATE_EVERY if budget.steps is None else max(1, budget.steps // _VALIDATIONS)
    validation = {"val_check_interval": every, "check_val_every_n_epoch": None} if has_val else {"limit_val_batches": 0}
    return {
        "accelerator": settings.accelerator,
        **({} if launch.trainer_flags() else {"devices": _devices_of(settings)}),
        "precision": precision_of(settings.precision, settings.accelerator),
        "max_epochs": -1,
        "max_steps": budget.steps or -1,
        "log_every_n_steps": settings.log_every,
        "enable_model_summary": False,
        "num_sanity_val_steps": 0,
        "use_distributed_sampler": False,
        **validation,
        **settings.flags,
        **_flags_of_ranks(settings),
        **({"enable_progress_bar": False} if is_quiet() else {}),
    }


def first_device(settings: TrainerSettings) -> torch.device:
    """Return the device that this process trains on, or the processor where Lightning names another kind."""
    if settings.accelerator not in ("gpu", *ACCELERATORS):
        return torch.device("cpu")
    device = device_of(settings.accelerator)
    return torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0))) if device.type == "cuda" else device


_MOST_PROCESSES = 4
"""On a processor of fewer cores: for trying out how several devices share the work."""


def _devices_of(settings: TrainerSettings) -> int | str:
    """Return Lightning's ``devices``; raises UserError for more processes than there are cores, or computers that nothing starts."""
    nodes, by_hand = settings.flags.get("num_nodes", 1), ("MASTER_ADDR", "MASTER_PORT", "NODE_RANK")
    missing = [name for name in by_hand if name not in os.environ]
    if nodes != 1 and missing:
        raise UserError(
            f"trainer.num_nodes={nodes}: the fit would wait for other computers, and neither torchrun nor srun has started "
            f"this one. To start each by hand, set {', '.join(missing)} too."
        )
    if not settings.devices.lstrip("-").isdigit():
        return settings.devices
    count, most = int(settings.devices), max(_MOST_PROCESSES, os.cpu_count() or 1)
    on_cpu = settings.accelerator == "cpu" or (settings.accelerator == "auto" and not torch.cuda.is_available())
    if on_cpu and count > most:
        raise UserError(f"trainer.devices={count}: a process for each, expected at most {most} on this machine.")
    return count


def _flags_of_ranks(settings: TrainerSettings) -> dict[str, Any]:
    """Return the flags of one of several processes; a user's strategy stays, unless it is the usual one."""
    flags = launch.trainer_flags()
    if settings.flags.get("strategy", "auto") not in ("auto", "ddp"):
        flags.pop("strategy", None)
    return flags


def check_trainer(settings: TrainerSettings) -> L.Trainer:
    """Return a trainer for nothing, before any data is read.

    Raises UserError: Lightning refuses a flag, or this machine lacks the accelerator or devices.
    """
    hints = typing.get_type_hints(L.Trainer.__init__)
    for name, value in settings.flags.items():
        kinds = tuple(_kinds(hints[name]))
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            expected = " or ".join(dict.fromkeys(_KINDS[kind] for kind in kinds if kind in _KINDS))
            raise UserError(f"trainer.{name}={value!r}: expected {expected}.")
    flags = _trainer_flags(settings, StageBudget(1, None), has_val=False)
    with _quiet(profiled=False):
        return _trainer(settings, flags, logger=False, enable_checkpointing=False, plugins=launch.plugins())


_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text", dict: "a mapping"}


def _kinds(hint: Any) -> Iterator[type]:
    """Yield the classes that a type hint admits; a number may be a whole one."""
    if typing.get_origin(hint) is typing.Literal:
        yield from map(type, typing.get_args(hint))
    elif typing.get_args(hint):
        for part in typing.get_args(hint):
            yield from _kinds(part)
    elif isinstance(hint, type):
        yield from (int, float) if hint is float else (hint,)


def _trainer(settings: TrainerSettings, flags: Mapping[str, Any], **ours: Any) -> L.Trainer:
    try:
        return L.Trainer(**flags, **ours)
    except Exception as error:  # of any kind: a package that is missing too
        named = {name: getattr(settings, name) for name in ("accelerator", "devices", "precision")} | settings.flags
        given = ", ".join(f"trainer.{name}={value}" for name, value in named.items())
        raise UserError(f"Lightning refuses {given}: {' '.join(str(error).split())}") from error


_NOT_FOR_FITS = (
    "Callback", "Checkpoint", "ProgressBar", "Timer", "RichProgressBar", "TQDMProgressBar", "LearningRateFinder",
    "BatchSizeFinder", "BaseFinetuning", "BackboneFinetuning", "BasePredictionWriter", "LambdaCallback",
)  # fmt: skip
"""Bases, those that a fit has itself, and those that need functions or a rate without our schedule."""
CALLBACKS = {
    name: f"lightning.pytorch.callbacks:{name}" for name in lightning_callbacks.__all__ if name not in _NOT_FOR_FITS
}
LOGGERS = {
    "tensorboard": "lightning.pytorch.loggers:TensorBoardLogger",
    "wandb": "lightning.pytorch.loggers:WandbLogger",
    "csv": "lightning.pytorch.loggers:CSVLogger",
}


def build_callbacks(specs: Mapping[str, Any]) -> list[L.Callback]:
    """Return the callbacks that ``callbacks.NAME`` set: Lightning's by name, or ``file.py:Class``, with options.

    Raises UserError: an unknown class or option.
    """
    built = []
    for name, spec in specs.items():
        options = dict(spec)
        use = str(options.pop("use", name))
        built.append(build(use, CALLBACKS, options, f"callbacks.{name}", L.Callback))
    return built


def build_loggers(settings: Settings, folder: Path) -> list[Logger]:
    """Return the loggers that ``trainer.logger`` and ``loggers.NAME`` set, which write into the run's folder.

    Raises UserError: an unknown class or option, or one that is not installed.
    """
    named = [name.strip() for name in (settings.trainer.logger or "").split(",")]
    specs = {name: {} for name in named if name not in ("", "none")} | settings.loggers
    built = []
    for name, spec in specs.items():
        options, where = dict(spec), f"loggers.{name}"
        use = str(options.pop("use", name))
        setting = f"{where}.use" if name in settings.loggers else "trainer.logger"
        taken = inspect.signature(find_class(use, LOGGERS, setting)).parameters
        ours = {"save_dir": str(folder), "name": name, "version": ""}
        if use != "tensorboard":  # the others number the processes of a fit, or name their runs themselves
            ours.pop("version")
        defaults = {key: value for key, value in ours.items() if key in taken and key not in options}
        built.append(build(use, LOGGERS, options, where, Logger, setting=setting, **defaults))
    return built


@contextmanager
def _quiet(profiled: bool) -> Iterator[None]:
    """Silence messages of Lightning that repeat or contradict ours; not where its report is what was asked for."""
    names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] in ("lightning", "lightning_fabric")]
    names = [] if profiled else names
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
