"""Keep the training state so that a killed fit goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lightning as L

from uplift.errors import UserError
from uplift.torch_file import read_torch, save_torch
from uplift.training.base import LifterTraining

__all__ = ["Checkpoints", "check_checkpoint"]


class Checkpoints(L.Callback):
    """Save the stage to ``path`` every ``seconds`` or ``steps`` and at its end, whole or not at all."""

    def __init__(self, path: Path, *, seconds: float, steps: int | None, on_save: Callable[[], None] | None = None):
        self.path, self.seconds, self.steps, self.on_save = path, seconds, steps, on_save
        self._last = time.monotonic()

    def on_train_batch_end(self, trainer: L.Trainer, module: LifterTraining, *rest: Any) -> None:  # type: ignore[override]
        """Save when it is time to."""
        if self.steps:
            due = trainer.global_step % self.steps == 0
        else:
            due = time.monotonic() - self._last > self.seconds
        if due or trainer.should_stop:
            self.save(trainer, module)

    def save(self, trainer: L.Trainer, module: LifterTraining) -> None:
        """Save now."""
        state = trainer._checkpoint_connector.dump_checkpoint()
        state["done"] = module.done
        if trainer.is_global_zero:
            save_torch(state, self.path)
            if self.on_save:
                self.on_save()
        self._last = time.monotonic()


def check_checkpoint(path: Path, module: LifterTraining) -> float:
    """Return how much of the stage the checkpoint had done, after checking that it fits ``module``.

    Raises:
        UserError: damaged, or of other settings or another skeleton.
    """
    state = read_torch(path, "checkpoint")
    found, expected = state.get("state_dict"), module.state_dict()
    if not isinstance(found, dict) or "done" not in state:
        raise UserError(f"{path} is no checkpoint of a fit (no 'state_dict').")
    wrong = [k for k in expected if k not in found or found[k].shape != expected[k].shape]
    if wrong or set(found) - set(expected):
        raise UserError(
            f"{path} does not fit this run's settings ({wrong[0] if wrong else sorted(set(found) - set(expected))[0]} "
            "differs): another skeleton, network or set of priors. Resume with the run's own settings."
        )
    return float(state["done"])
