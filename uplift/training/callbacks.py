"""Lightning callbacks: time budget, checkpoints, progress and metrics.csv, number of CPU threads."""

from __future__ import annotations

import csv
import signal
import sys
import threading
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from statistics import median_high
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, Timer, TQDMProgressBar
from lightning.pytorch.callbacks.progress.tqdm_progress import Tqdm
from lightning.pytorch.plugins.io import TorchCheckpointIO
from lightning.pytorch.trainer.states import RunningStage

from uplift.config import ranks
from uplift.config.files import read_torch, save_torch
from uplift.errors import UserError
from uplift.training.base import TrainingModule

__all__ = [
    "AtomicCheckpointIO",
    "Budget",
    "Checkpoints",
    "Interrupted",
    "MetricsFile",
    "Progress",
    "Threads",
    "checked_checkpoint",
    "read_metrics",
]

# The faster number of CPU threads: all on an idle machine, one on a busy one.

_PROBE_STEPS = 4
_EVERY_S = 20.0


class Threads(L.Callback):
    """Every 20 seconds times a few steps with all threads and a few with one, and continues with the faster.

    Threads that share a small product wait for each other: if another process occupies a core, two threads can be
    ten times slower than one. Every probe is a step of the training, so no time is lost; but the last digits
    depend on the number of threads, so fits with a set number of steps do not use this.
    """

    def __init__(self) -> None:
        self.most = torch.get_num_threads()
        self._times: dict[int, list[float]] = {}
        self._queue: list[int] = []
        self._next = self._start = 0.0

    def on_train_batch_start(self, *rest: Any) -> None:
        """Set the threads of this step if it is a probe."""
        if not self._queue and time.perf_counter() >= self._next:
            self._times = {}
            self._queue = [self.most] * _PROBE_STEPS + [1] * _PROBE_STEPS
        if self._queue:
            torch.set_num_threads(self._queue[0])
        self._start = time.perf_counter()

    def on_train_batch_end(self, *rest: Any) -> None:
        """Record how long a probe took; after the last one, keep the faster number."""
        if not self._queue:
            return
        threads = self._queue.pop(0)
        self._times.setdefault(threads, []).append(time.perf_counter() - self._start)
        if not self._queue:
            torch.set_num_threads(min(self._times, key=lambda n: median_high(self._times[n])))
            self._next = time.perf_counter() + _EVERY_S

    def on_train_end(self, *rest: Any) -> None:
        """Set all threads again for the rest of the program."""
        torch.set_num_threads(self.most)

    def on_exception(self, *rest: Any) -> None:
        """Do as at the end."""
        self.on_train_end()


# Checkpoints: the training state, so that a killed fit continues where it was.


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes each checkpoint completely or not at all, so that a kill or a full disk leaves the last one.

    ``on_save`` is called after each.
    """

    def __init__(self, on_save: Callable[[], None] | None = None):
        super().__init__()
        self.on_save = on_save

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write tensors and plain data to ``path``."""
        save_torch(checkpoint, Path(path))
        if self.on_save is not None:
            self.on_save()


def _between_steps(trainer: L.Trainer, rest: tuple[Any, ...]) -> bool:
    """Return whether a batch ends a step of the optimiser, from the last arguments of ``on_train_batch_end``."""
    return (rest[-1] + 1) % trainer.accumulate_grad_batches == 0 or trainer.is_last_batch


class Checkpoints(ModelCheckpoint):
    """Save the stage to ``path`` every ``seconds`` or ``steps`` and at its end, each time over the last.

    The trainer must have the plugin `AtomicCheckpointIO`.
    """

    def __init__(self, path: Path, clock: Budget, *, seconds: float, steps: int | None):
        when: dict[str, Any] = {"train_time_interval": timedelta(seconds=seconds)}
        if steps:
            when = {"every_n_train_steps": steps}
        super().__init__(path.parent, path.stem, save_on_train_epoch_end=False, enable_version_counter=False, **when)
        self.path, self.clock, self.steps = path, clock, steps

    def on_train_batch_end(self, trainer: L.Trainer, module: TrainingModule, *rest: Any) -> None:  # type: ignore[override]
        """Save when it is due, and when the stage is over."""
        if not _between_steps(trainer, rest):
            return
        if (module.done >= 1 or trainer.should_stop) and not trainer.fast_dev_run:  # type: ignore[attr-defined]
            trainer.save_checkpoint(self.path)
        elif self.steps or self.clock.just_agreed:  # others would ask all ranks for the time at every step
            super().on_train_batch_end(trainer, module, *rest)


def checked_checkpoint(path: Path, module: TrainingModule) -> dict[str, Any]:
    """Return the checkpoint of a stage; raises UserError if it is damaged or does not fit ``module``."""
    state = read_torch(path, "checkpoint")
    found, expected = state.get("state_dict"), module.state_dict()
    if not isinstance(found, dict) or "done" not in state:
        raise UserError(f"{path} is not a checkpoint of a fit (no 'state_dict').")
    wrong = [k for k in expected if k not in found or found[k].shape != expected[k].shape]
    wrong += [k for k in found if k not in expected]
    if wrong:
        raise UserError(
            f"{path} does not fit this run's settings ({wrong[0]} differs): another skeleton, network or set of "
            "priors. Resume with the settings of the run."
        )
    return state


# Progress: one line on a terminal, rows in metrics.csv.


_REFRESH_S = 0.5
"""Between looks of the bar."""


class Progress(TQDMProgressBar):
    """A bar over the share of the stage that is over in a terminal; elsewhere, a line for every tenth of it."""

    def __init__(self, stage: str, clock: Budget, stream: Any = None):
        super().__init__()
        self.stage, self.clock, self.stream = stage, clock, stream or sys.stderr
        self._tenth, self._first, self._start, self._shown = -1, 0, 0.0, 0.0
        self._smooth: dict[str, float] = {}
        if not self.stream.isatty():
            self.disable()

    def init_train_tqdm(self) -> Tqdm:
        """Return a bar of a hundred percent."""
        shape = "{desc} {percentage:3.0f} % |{bar:12}| {unit}"
        given = {"bar_format": shape, "file": self.stream, "dynamic_ncols": True, "disable": self.is_disabled}
        return Tqdm(desc=f"{self.stage:9s}", total=100.0, unit="", **given)

    def init_validation_tqdm(self) -> Tqdm:
        """Return no bar: validation is one batch."""
        return Tqdm(disable=True)

    def on_train_start(self, trainer: L.Trainer, module: Any) -> None:
        """Start counting steps and seconds."""
        super().on_train_start(trainer, module)
        self._first, self._start = trainer.global_step, time.monotonic()

    def on_train_epoch_start(self, *rest: Any) -> None:
        """Go on: a stage is one bar."""

    def on_train_batch_end(self, trainer: L.Trainer, module: TrainingModule, *rest: Any) -> None:  # type: ignore[override]
        """Show the state when it is time to."""
        tenth, now, live = int(module.done * 10), time.monotonic(), not self.is_disabled
        over = module.done >= 1 or trainer.should_stop
        due = now - self._shown > _REFRESH_S if live else tenth != self._tenth
        if not trainer.is_global_zero or not (due or over):
            return
        self._tenth, self._shown = tenth, now
        for name, value in module.logged.items():
            before = self._smooth.get(name, float(value))
            self._smooth[name] = 0.6 * before + 0.4 * float(value)
        text = self._text(trainer, module.done)
        if live:
            self.train_progress_bar.n, self.train_progress_bar.unit = 100 * module.done, text
            self.train_progress_bar.refresh()
        else:
            self.stream.write(f"{self.stage:9s} {100 * module.done:3.0f} %  {text}\n")
            self.stream.flush()

    def _text(self, trainer: L.Trainer, done: float) -> str:
        step, spent = trainer.global_step, self.clock.time_elapsed()
        speed = (step - self._first) / max(1e-9, time.monotonic() - self._start)
        left = spent * (1 - done) / done if done > 0.01 else float("nan")
        clock = f"{int(left) // 60}:{int(left) % 60:02d} left" if left == left else "..."
        losses = "  ".join(f"{name} {value:.3f}" for name, value in list(self._smooth.items())[:8])
        return f"step {step:,}  {speed:.3g} steps/s  {clock}  {losses}"


class MetricsFile(L.Callback):
    """Append losses and prior metrics to ``metrics.csv`` every ``every`` steps, as stage, step, name and value.

    Rows after the step that a fit resumes from are removed first, so that an uninterrupted and a resumed fit
    leave the same file.
    """

    def __init__(self, path: Path, stage: str, every: int):
        self.path, self.stage, self.every, self._last = path, stage, every, 0

    def on_train_start(self, trainer: L.Trainer, module: Any) -> None:
        """Remove what a killed process wrote after its last checkpoint."""
        if not trainer.is_global_zero:
            return
        kept = [r for r in read_metrics(self.path) if r[0] != self.stage or int(r[1]) <= trainer.global_step]
        with open(self.path, "w", newline="", encoding="utf-8", errors="backslashreplace") as file:
            csv.writer(file).writerows([["stage", "step", "name", "value"], *kept])

    def on_train_batch_end(self, trainer: L.Trainer, module: TrainingModule, *rest: Any) -> None:  # type: ignore[override]
        """Append rows when it is time to."""
        if trainer.global_step % self.every or trainer.global_step == self._last:
            return
        self._last = trainer.global_step
        step, values = trainer.global_step, {name: float(value) for name, value in module.logged.items()}
        if module.last_lift is not None:
            with module.sharing(rest[-2]):
                values |= module.terms.metrics(module.last_lift)
        if not trainer.is_global_zero:
            return
        with open(self.path, "a", newline="", encoding="utf-8", errors="backslashreplace") as file:
            csv.writer(file).writerows([self.stage, step, name, f"{value:.6g}"] for name, value in values.items())


def read_metrics(path: Path) -> list[list[str]]:
    """Return the rows of a metrics.csv without its header and without a line that a kill cut short."""
    if not path.is_file():
        return []
    with open(path, newline="", encoding="utf-8", errors="replace") as file:
        return [row for row in csv.reader(file) if len(row) == 4 and row[1].isdigit()]


# Budget: a stage ends when its time is over, or on Ctrl-C.


class Interrupted(Exception):
    """The user pressed Ctrl-C; the training state has been saved."""


_AGREE_S = 1.0
_MOST_APART = 1000
"""Seconds, and most steps, between times that ranks agree on."""


class Budget(Timer):
    """Stops a stage after ``seconds``, which go on where an interrupted fit stopped them; None for no limit of time.

    Ctrl-C or SIGTERM ends the stage after the current step; a second one ends it at once.
    """

    agrees = True
    """Whether ranks have the same time."""

    def __init__(self, seconds: float | None, spent: float = 0.0):
        super().__init__(None if seconds is None else timedelta(seconds=seconds), verbose=False)
        self.load_state_dict({"spent": spent})
        self.interrupted = False
        self.just_agreed = True
        """Whether all ranks have the same time and know of interruptions at this step: always, where there is but one."""
        self._agreed: float | None = None
        self._next, self._last = 0, (0, 0.0)

    def on_train_start(self, trainer: L.Trainer, module: Any) -> None:
        """Start the clock."""
        self._catch(signal.SIGTERM)  # here, as Lightning has just installed its handler
        super().on_train_start(trainer, module)
        self._last = (trainer.global_step, time.monotonic())
        self._agree(trainer.global_step)
        self._next = trainer.global_step + 1  # the pace is not known yet

    def on_train_batch_end(self, trainer: L.Trainer, module: TrainingModule, *rest: Any) -> None:  # type: ignore[override]
        """Stop when the time is over or the user interrupted."""
        super().on_train_end(trainer, module)  # time counts to the end of the last step, and checkpoints have the same
        between = _between_steps(trainer, rest)
        self.just_agreed = between and trainer.global_step >= self._next
        if self.just_agreed:
            self._agree(trainer.global_step)
            trainer.should_stop = trainer.should_stop or self.interrupted
        if self._duration is not None and self.time_elapsed() >= self._duration:
            trainer.should_stop = True
        module.update_done()

    def _agree(self, step: int) -> None:
        """Let ranks agree on the time and on interruptions, about once a second: in between none waits for another."""
        if ranks.world() == 1:
            return
        (before, then), now = self._last, time.monotonic()
        values = (super().time_elapsed(), float(self.interrupted), (now - then) / max(1, step - before))
        self._agreed, stop, pace = ranks.largest(values)
        self.interrupted, self._last = bool(stop), (step, now)
        self._next = step + max(1, min(_MOST_APART, round(_AGREE_S / max(pace, 1e-6))))

    def time_elapsed(self, stage: RunningStage = RunningStage.TRAINING) -> float:
        """Return the seconds so far, those of the slowest rank when ranks last agreed."""
        training = stage == RunningStage.TRAINING
        return float(super().time_elapsed(stage)) if self._agreed is None or not training else self._agreed

    def on_train_end(self, *rest: Any) -> None:
        """Leave the time as the last step's end set it."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the time that an earlier process spent; ``spent`` is what earlier versions wrote."""
        spent = state_dict.get("spent")
        super().load_state_dict(state_dict if spent is None else {"time_elapsed": {"train": float(spent)}})

    def __enter__(self) -> Budget:
        self._handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        self._catch(signal.SIGINT)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._handlers.items():
            if handler is not None and threading.current_thread() is threading.main_thread():
                signal.signal(number, handler)

    def _catch(self, number: int) -> None:
        """Record the signal instead of acting at once."""

        def ask(number: int, frame: object) -> None:
            if self.interrupted:
                raise SystemExit(130)  # Lightning turns a KeyboardInterrupt into an exit with status 1
            self.interrupted = True

        if threading.current_thread() is threading.main_thread():  # elsewhere signals are the caller's
            signal.signal(number, ask)
