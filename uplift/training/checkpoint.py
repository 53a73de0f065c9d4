"""Keep the training state so that a killed fit goes on where it was."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lightning as L
import torch

from uplift.errors import UserError
from uplift.saving import replacing
from uplift.training.base import LifterTraining

__all__ = ["Checkpoints", "check_checkpoint", "read_torch", "save_torch"]


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


def save_torch(state: dict[str, Any], path: Path) -> None:
    """Write tensors and plain data to ``path``, whole or not at all."""
    try:
        with replacing(path) as file:
            torch.save(state, file)
    except RuntimeError as error:
        # torch's own writer turns a full disk into a RuntimeError.
        if isinstance(error.__context__, OSError):
            raise error.__context__ from error
        raise OSError(f"cannot write {path}: {error}") from error


def read_torch(path: Path, kind: str) -> dict[str, Any]:
    """Read tensors and plain data; nothing in the file can run.

    Raises:
        UserError: not there, not such a file, damaged, or holding anything but plain data.
    """
    if not path.is_file():
        raise UserError(f"No {kind} {path}.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a file that is no checkpoint makes torch think aloud
            state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a dozen kinds for a file that is not one of its own
        reason = str(error).strip().splitlines()[0][:200] if str(error) else type(error).__name__
        raise UserError(
            f"{path} is no {kind} that can be read: damaged, or holding more than tensors and plain data, "
            f"which is never opened ({reason})."
        ) from error
    if not isinstance(state, dict):
        raise UserError(f"{path} is no {kind}: found {type(state).__name__}, expected what `uplift fit` writes.")
    return state


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
