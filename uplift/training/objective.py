"""`Objective`: the weighted sum of priors, every result checked; adversarial ones are frozen while they judge."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import torch
from torch import Tensor, nn

from uplift.config import ranks
from uplift.config.plugins import blame
from uplift.config.run import idle_prior
from uplift.errors import UserError
from uplift.priors.base import Lift, Prior, ShapeLift

__all__ = ["Logged", "Objective", "frozen", "prepare_priors"]

Logged = dict[str, float | Tensor]

_PATIENCE = 20
"""Calls after which a loss that has never carried a gradient is rejected."""
_WATCHED = 100
"""Steps in which a prior is expected to have had a gradient; after them, the rest are looked at only every so often."""
_SYNC_EVERY = 50
"""Steps between checks of a loss on an accelerator, where each one waits for the device."""


def prepare_priors(priors: Mapping[str, Prior], data: Any) -> None:
    """Show every prior the training data."""
    with ranks.rank_0_first():
        for name, prior in priors.items():
            with blame(f"priors.{name}: prepare", type(prior)):
                prior.prepare(data)


class Objective:
    """Weighted priors of poses or of shapes.

    What would fail silently is rejected: no gradient, NaN, a wrong shape. A loss is connected if it carries a
    gradient to something trainable. A constant 0 may be a satisfied hinge written with an ``if``: it is rejected
    after twenty calls without a gradient. A gradient that is 0 may belong to a satisfied hinge too: `idle` names the
    priors that have had no other so far.
    """

    def __init__(self, priors: Mapping[str, Prior], weights: Mapping[str, float]):
        self.priors, self.weights = dict(priors), dict(weights)
        self.adversarial = [name for name, prior in priors.items() if type(prior).critic_loss is not Prior.critic_loss]
        self._connected: set[str] = set()
        self._calls = dict.fromkeys(priors, 0)
        self.idle = {name: 0 for name in priors if weights[name] != 0}
        """Steps without a gradient, of the priors that never had one; those of weight 0 are not expected to."""

    def leave_out(self, name: str) -> None:
        """Judge without the prior ``name``, if there is one."""
        self.priors.pop(name, None)
        self.idle.pop(name, None)
        self.adversarial = [other for other in self.adversarial if other != name]

    def judge(self, lift: Lift | ShapeLift, step: int) -> tuple[Tensor, Logged]:
        """Return the weighted sum of the priors' losses, which trains the lifter, and each loss by name."""
        losses, weighted = Logged(), []
        with frozen(self.priors[name] for name in self.adversarial):
            found = [self.loss(name, lift, step) for name in self.priors]
            for name, loss in zip(self.priors, ranks.mean(*found), strict=True):
                if name in self.idle:
                    trained = (*_lifted(lift), *self.priors[name].parameters())
                    self.watch(
                        name, lambda loss=loss, trained=trained: loss.requires_grad and _any_gradient(loss, trained)
                    )
                weighted.append(self.weights[name] * loss)
                losses[name] = loss.detach()
        return torch.stack(weighted).sum() if weighted else torch.zeros(()), losses

    def loss(self, name: str, lift: Lift | ShapeLift, step: int) -> Tensor:
        """Return one prior's loss as one number; raises UserError if it fails or does not pass the checks."""
        with blame(f"priors.{name}: loss", type(self.priors[name])), _numbers_of(self.priors[name]):
            value = self.priors[name].loss(lift)
        if not isinstance(value, Tensor) or value.shape not in lift.loss_shapes:
            found = f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
            per_frame = "".join(f" or one per frame (shape {shape})" for shape in lift.loss_shapes if shape)
            raise UserError(f"priors.{name}: loss(lift) returned {found}, expected one number (shape ()){per_frame}.")
        if value.is_complex():
            raise UserError(f"priors.{name}: loss(lift) returned {value.dtype}, expected real numbers.")
        value = value if value.is_floating_point() else value.float()
        value = value.mean() if value.ndim else value
        if (value.device.type == "cpu" or step % _SYNC_EVERY == 0) and not math.isfinite(value.item()):
            raise UserError(
                f"priors.{name}: loss is {value.item()} at step {step}. Look for a division by 0, a square root or "
                "a norm of 0 (add a small number), or a learning rate that is too high."
            )
        if name not in self._connected:
            self._check_connected(name, value, lift)
        return value

    def _check_connected(self, name: str, value: Tensor, lift: Lift | ShapeLift) -> None:
        self._calls[name] += 1
        if value.requires_grad:
            self._connected.add(name)
        elif bool(value != 0) or self._calls[name] >= _PATIENCE:
            *first, last = (f"lift.{field}" for field in lift.differentiable)
            raise UserError(
                f"priors.{name}: its loss depends on nothing that can be trained (no gradient reaches what was lifted "
                f"or the prior's own parameters). Compute it from {', '.join(first)} or {last}, without .detach(), "
                ".numpy() or comparisons in place of differences."
            )

    def watch(self, name: str, moves: Callable[[], bool]) -> None:
        """Look whether the loss of an idle prior ``moves`` anything that is trained, until it has done so once."""
        steps = self.idle[name] = self.idle[name] + 1
        due = steps <= _WATCHED or steps % _WATCHED == 0
        if due and moves():
            del self.idle[name]
        elif steps == _WATCHED:
            warnings.warn(idle_prior(name, _WATCHED), stacklevel=2)

    def train_adversaries(self, real: Tensor, reprojected: Tensor) -> tuple[Tensor, Logged]:
        """Return the sum of the losses that adversarial priors are trained on, and each of them by name.

        ``reprojected`` are detached views of what was lifted, ``real`` the same of the data. Raises UserError for a loss
        that fails, or is not one number that depends on the prior's parameters.
        """
        total, losses = real.new_zeros(()), Logged()
        for name in self.adversarial:
            with blame(f"priors.{name}: critic_loss", type(self.priors[name])), _numbers_of(self.priors[name]):
                own = self.priors[name].critic_loss(real, reprojected)
            if own is None:
                continue
            if not isinstance(own, Tensor) or own.shape != () or not own.requires_grad:
                raise UserError(
                    f"priors.{name}: critic_loss(real, reprojected) must return one number (a tensor of shape ()) that depends "
                    "on the prior's own parameters."
                )
            (own,) = ranks.mean(own)
            total = total + own
            losses[f"{name}_own"] = own.detach()
        return total, losses

    @torch.no_grad()
    def metrics(self, lift: Lift | ShapeLift) -> dict[str, float]:
        """Return what the priors want logged."""
        found = {}
        for name, prior in self.priors.items():
            with blame(f"priors.{name}: metrics", type(prior)):
                found |= {f"{name}_{key}": float(value) for key, value in prior.metrics(lift).items()}
        return found

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Return an optimiser group for each prior that has parameters."""
        parameters = {name: list(prior.parameters()) for name, prior in self.priors.items()}
        return [{"params": own, "lr": learning_rate, "name": name} for name, own in parameters.items() if own]

    def gated_parameters(self, lifter: nn.Module) -> Iterator[nn.Parameter]:
        """Return the parameters, a prior's or the lifter's, that a prior excluded from the update in this step."""
        for prior in self.priors.values():
            if prior.gate_itself:
                yield from prior.parameters()
            if prior.gate_lifter:
                yield from lifter.parameters()


def _numbers_of(prior: Prior) -> AbstractContextManager[None]:
    """Return a context for a prior's loss: one of a user's draws random numbers of its own on every rank."""
    return nullcontext() if type(prior).__module__.startswith("uplift.") else ranks.own_numbers()


def _lifted(lift: Lift | ShapeLift) -> Iterator[Tensor]:
    """Return the tensors of ``lift`` that a loss can be computed from."""
    for value in vars(lift).values():
        yield from value.parameters() if isinstance(value, nn.Module) else [value] if isinstance(value, Tensor) else []


def _any_gradient(loss: Tensor, of: Iterable[Tensor]) -> bool:
    trained = [part for part in of if part.requires_grad]
    gradients = torch.autograd.grad(loss, trained, retain_graph=True, allow_unused=True)
    found = any(bool(part.any()) for part in gradients if part is not None)
    return bool(ranks.largest([found])[0]) if ranks.shared() else found


@contextmanager
def frozen(modules: Iterable[nn.Module]) -> Iterator[None]:
    """Compute no gradients of the modules' parameters; gradients still flow through them."""
    parameters = [p for module in modules for p in module.parameters() if p.requires_grad]
    for parameter in parameters:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in parameters:
            parameter.requires_grad_(True)
