"""End a stage when its steps or its time are over, or when the user asks for it."""

from __future__ import annotations

import signal
import threading
import time
from typing import Any

import lightning as L
import torch

from uplift.training.base import LifterTraining

__all__ = ["Budget", "Interrupted"]


class Interrupted(Exception):
    """The user pressed Ctrl-C; the training state has been saved."""


class Budget(L.Callback):
    """Keeps `LifterTraining.done` from 0 to 1 and stops there; time goes on counting after a resume.

    Ctrl-C or a SIGTERM ends the stage after the step under way; a second one at once.
    """

    def __init__(self, *, steps: int | None, seconds: float | None, spent: float = 0.0):
        self.steps, self.seconds = steps, seconds
        self.spent = spent
        self.first_step_s: float | None = None
        self.interrupted = False

    def on_train_start(self, trainer: L.Trainer, module: LifterTraining) -> None:  # type: ignore[override]
        """Start the clock where a resumed stage left it."""
        self._catch(signal.SIGTERM)  # here, as Lightning has just put its own in place
        self._before = self.spent
        self._start = time.monotonic()
        self._update(trainer, module)

    def on_train_batch_start(self, trainer: Any, module: Any, batch: Any, batch_idx: int) -> None:
        """Set how much of the stage is over."""
        self._update(trainer, module)

    def on_train_batch_end(self, trainer: L.Trainer, module: Any, *rest: Any) -> None:
        """Stop when it is over, or when it was interrupted."""
        if self.first_step_s is None:
            self.first_step_s = time.monotonic() - self._start
        self._update(trainer, module)
        if module.done >= 1 or self.interrupted:
            trainer.should_stop = True

    def _update(self, trainer: L.Trainer, module: LifterTraining) -> None:
        self.spent = self._before + time.monotonic() - self._start
        shares = [0.0]
        if self.steps:
            shares.append(trainer.global_step / self.steps)
        if self.seconds:
            spent = self.spent
            if trainer.world_size > 1:  # all ranks must stop at the same step
                spent = float(trainer.strategy.broadcast(torch.tensor(spent)))
            shares.append(spent / self.seconds)
        module.done = min(1.0, max(shares))

    def state_dict(self) -> dict[str, float]:
        """Return the time spent so far, seconds."""
        return {"spent": self.spent}

    def load_state_dict(self, state: dict[str, float]) -> None:
        """Take over the time an earlier process spent."""
        self.spent = float(state["spent"])

    def __enter__(self) -> Budget:
        self._handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        self._catch(signal.SIGINT)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._handlers.items():
            if handler is not None and threading.current_thread() is threading.main_thread():
                signal.signal(number, handler)

    def _catch(self, number: int) -> None:
        """Note the signal when it comes, instead of what it does otherwise."""

        def ask(number: int, frame: object) -> None:
            if self.interrupted:
                raise SystemExit(130)  # Lightning turns a KeyboardInterrupt into an exit with status 1
            self.interrupted = True

        if threading.current_thread() is threading.main_thread():  # elsewhere signals are the caller's
            signal.signal(number, ask)
