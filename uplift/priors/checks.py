"""Call the hooks of priors and refuse what would fail silently: no gradient, NaN, a wrong shape."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from uplift.errors import UserError
from uplift.priors.base import Lift, Prior, ShapeLift

__all__ = ["PriorChecks", "blame"]

_PATIENCE = 20
"""Calls after which a loss that has never carried a gradient is refused."""
_SYNC_EVERY = 50
"""Steps between looks at a loss on an accelerator, where each one waits for the device."""
_PACKAGE = Path(__file__).resolve().parent.parent


class PriorChecks:
    """Calls the hooks of priors of poses or shapes and checks what they return.

    A loss is connected if it carries a gradient to something trainable. A constant 0 may be a satisfied
    hinge written with an ``if``: it is refused after twenty calls without a gradient.
    """

    def __init__(self, priors: Mapping[str, Prior]):
        self.priors = dict(priors)
        self.connected: set[str] = set()
        self.calls = dict.fromkeys(priors, 0)

    def loss(self, name: str, lift: Lift | ShapeLift, step: int) -> Tensor:
        """Return the prior's loss as one number.

        Raises:
            UserError: it fails, has a wrong shape, is not finite, or depends on nothing trainable.
        """
        prior = self.priors[name]
        with blame(name, prior, "loss"):
            value = prior.loss(lift)
        if not isinstance(value, Tensor) or value.shape not in lift.loss_shapes:
            found = f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
            per_frame = "".join(f" or one per frame (shape {shape})" for shape in lift.loss_shapes if shape)
            raise UserError(f"priors.{name}: loss(lift) returned {found}, expected one number (shape ()){per_frame}.")
        if value.is_complex():
            raise UserError(f"priors.{name}: loss(lift) returned {value.dtype}, expected real numbers.")
        value = value.mean() if value.is_floating_point() else value.float().mean()
        self._check_finite(name, value, step)
        self._check_connected(name, value, lift)
        return value

    def own_loss(self, name: str, real: Tensor, seen: Tensor) -> Tensor | None:
        """Return what the prior trains itself on in this step, or None.

        Raises:
            UserError: it fails, or is not one number that depends on the prior's parameters.
        """
        prior = self.priors[name]
        with blame(name, prior, "own_loss"):
            own = prior.own_loss(real, seen)
        if own is None:
            return None
        if not isinstance(own, Tensor) or own.shape != () or not own.requires_grad:
            raise UserError(
                f"priors.{name}: own_loss(real, seen) must return one number (a tensor of shape ()) that depends on "
                "the prior's own parameters."
            )
        return own

    def metrics(self, name: str, lift: Lift | ShapeLift) -> dict[str, float]:
        """Return what the prior wants logged, under its name."""
        prior = self.priors[name]
        with blame(name, prior, "metrics"):
            return {f"{name}_{key}": float(value) for key, value in prior.metrics(lift).items()}

    def _check_finite(self, name: str, value: Tensor, step: int) -> None:
        if value.device.type != "cpu" and step % _SYNC_EVERY:
            return
        if not bool(torch.isfinite(value)):
            raise UserError(
                f"priors.{name}: loss is {value.item()} at step {step}. Look for a division by 0, a square root or "
                "a norm of 0 (add a small number), or a learning rate that is too high."
            )

    def _check_connected(self, name: str, value: Tensor, lift: Lift | ShapeLift) -> None:
        if name in self.connected:
            return
        self.calls[name] += 1
        if value.requires_grad:
            self.connected.add(name)
        elif bool(value != 0) or self.calls[name] >= _PATIENCE:
            *first, last = (f"lift.{field}" for field in lift.differentiable)
            raise UserError(
                f"priors.{name}: its loss depends on nothing that can be trained (no gradient reaches what was lifted "
                f"or the prior's own parameters). Compute it from {', '.join(first)} or {last}, without .detach(), "
                ".numpy() or comparisons in place of differences."
            )


class blame:
    """Turn an error inside a user's prior into a `UserError` that names file and line."""

    def __init__(self, name: str, prior: nn.Module, hook: str):
        self.name, self.prior, self.hook = name, prior, hook

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if not isinstance(error, Exception) or isinstance(error, UserError):
            return
        if type(self.prior).__module__.startswith("uplift."):
            return
        frames = [
            frame
            for frame in traceback.extract_tb(error.__traceback__)
            if _PACKAGE not in Path(frame.filename).resolve().parents and "site-packages" not in frame.filename
        ]
        # A hook with wrong arguments, or whose result cannot be read, fails in the package's frames alone.
        where = f"{frames[0].filename}, line {frames[0].lineno}" if frames else _file_of(self.prior)
        message = f"priors.{self.name}: {self.hook} failed in {where}: {type(error).__name__}: {error}"
        raise UserError(message) from error


def _file_of(prior: nn.Module) -> str:
    module = sys.modules.get(type(prior).__module__)
    return f"{type(prior).__name__} of {getattr(module, '__file__', None) or type(prior).__module__}"
