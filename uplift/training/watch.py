"""Call a prior's hooks and refuse what would fail in silence: no gradient, NaN, a wrong shape."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from uplift.errors import UserError
from uplift.lift import Lift
from uplift.priors.base import Prior

__all__ = ["PriorWatch", "blame"]

_PATIENCE = 20
_PACKAGE = Path(__file__).resolve().parent.parent


class PriorWatch:
    """Calls each prior's `loss` and `own_loss` and checks what comes back.

    A loss is connected when it carries a graph to something trainable. A constant 0 may be a
    satisfied hinge written with an ``if``: it is refused when twenty steps have brought no graph.
    """

    def __init__(self, priors: Mapping[str, Prior]):
        self.priors = dict(priors)
        self.connected: set[str] = set()
        self.calls = dict.fromkeys(priors, 0)

    def loss(self, name: str, lift: Lift, step: int) -> Tensor:
        """Return the prior's loss as one number."""
        prior = self.priors[name]
        with blame(name, prior, "loss"):
            value = prior.loss(lift)
        if not isinstance(value, Tensor) or value.shape not in ((), (len(lift.pose),)):
            found = f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
            raise UserError(
                f"priors.{name}: loss(lift) returned {found}, expected one number (shape ()) or one a frame "
                f"(shape ({len(lift.pose)},))."
            )
        if value.is_complex():
            raise UserError(f"priors.{name}: loss(lift) returned {value.dtype}, expected real numbers.")
        value = value.mean() if value.is_floating_point() else value.float().mean()
        self._check(name, value, step)
        return value

    def own_loss(self, name: str, real: Tensor, seen: Tensor) -> Tensor | None:
        """Return what the prior trains itself on in this step."""
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

    def metrics(self, name: str, lift: Lift) -> dict[str, float]:
        """Return what the prior wants logged, under its name."""
        prior = self.priors[name]
        with blame(name, prior, "metrics"):
            found = prior.metrics(lift)
            return {f"{name}_{key}": float(value) for key, value in found.items()}

    def _check(self, name: str, value: Tensor, step: int) -> None:
        if name not in self.connected:
            self.calls[name] += 1
            if value.requires_grad:
                self.connected.add(name)
            elif bool(value != 0) or self.calls[name] >= _PATIENCE:
                raise UserError(
                    f"priors.{name}: its loss depends on nothing that can be trained (no gradient reaches the pose or "
                    "parameters of its own). Compute it from lift.pose, lift.level_pose, lift.turned or lift.seen, "
                    "without .detach(), .numpy() or comparisons in place of differences."
                )
        if value.device.type == "cpu" and not bool(torch.isfinite(value)):
            raise UserError(
                f"priors.{name}: loss is {value.item()} at step {step}. Look for a division by 0, a square root or "
                "a norm of 0 (add a small number), or a learning rate that is too high."
            )


class blame:
    """Turn an error inside a user's own prior into a `UserError` that names file and line."""

    def __init__(self, name: str, prior: nn.Module, hook: str):
        self.name, self.prior, self.hook = name, prior, hook

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if not isinstance(error, Exception) or isinstance(error, UserError):
            return
        if type(self.prior).__module__.startswith("uplift."):
            return
        frames = traceback.extract_tb(error.__traceback__)
        own = [f for f in frames if _PACKAGE not in Path(f.filename).resolve().parents]
        place = next((f for f in own if "site-packages" not in f.filename), None)
        # A hook with other arguments, or one that returns what cannot be read, fails in our frames alone.
        where = f"{place.filename}, line {place.lineno}" if place else f"{_file_of(self.prior)}"
        raise UserError(
            f"priors.{self.name}: {self.hook} failed in {where}: {type(error).__name__}: {error}"
        ) from error


def _file_of(prior: nn.Module) -> str:
    module = sys.modules.get(type(prior).__module__)
    return f"{type(prior).__name__} of {getattr(module, '__file__', None) or type(prior).__module__}"
