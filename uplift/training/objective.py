"""`Objective`: the weighted sum of priors; adversarial ones are frozen while they judge and trained on their own loss."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn

from uplift.priors.base import Lift, Prior, ShapeLift
from uplift.priors.checks import PriorChecks, blame

__all__ = ["Logged", "Objective", "prepare_priors"]

Logged = dict[str, float | Tensor]


def prepare_priors(priors: Mapping[str, Prior], data: Any) -> None:
    """Let every prior look at the training data."""
    for name, prior in priors.items():
        with blame(name, prior, "prepare"):
            prior.prepare(data)


class Objective:
    """Weighted priors of poses or of shapes, every result checked (`PriorChecks`)."""

    def __init__(self, priors: Mapping[str, Prior], weights: Mapping[str, float]):
        self.priors, self.weights = dict(priors), dict(weights)
        self.adversarial = [name for name, prior in priors.items() if type(prior).own_loss is not Prior.own_loss]
        self.checks = PriorChecks(priors)

    def judge(self, lift: Lift | ShapeLift, step: int) -> tuple[Tensor, Logged]:
        """Return the weighted sum of the priors' losses, which trains the lifter, and each loss by name."""
        total, losses = torch.zeros(()), Logged()
        with _frozen(self.priors[name] for name in self.adversarial):
            for name in self.priors:
                loss = self.checks.loss(name, lift, step)
                total = total + self.weights[name] * loss
                losses[name] = loss.detach()
        return total, losses

    def train_adversaries(self, real: Tensor, seen: Tensor) -> tuple[Tensor, Logged]:
        """Return the sum of what adversarial priors are trained on, and each such loss by name.

        ``seen`` are detached views of what was lifted, ``real`` the same of the data.
        """
        total, losses = real.new_zeros(()), Logged()
        for name in self.adversarial:
            own = self.checks.own_loss(name, real, seen)
            if own is not None:
                total = total + own
                losses[f"{name}_own"] = own.detach()
        return total, losses

    def metrics(self, lift: Lift | ShapeLift) -> dict[str, float]:
        """Return what the priors want logged."""
        with torch.no_grad():
            found = [self.checks.metrics(name, lift) for name in self.priors]
        return {key: value for one in found for key, value in one.items()}

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Return an optimiser group for each prior that has parameters."""
        parameters = {name: list(prior.parameters()) for name, prior in self.priors.items()}
        return [{"params": own, "lr": learning_rate, "name": name} for name, own in parameters.items() if own]

    def gated_parameters(self, lifter: nn.Module) -> Iterator[nn.Parameter]:
        """Return the parameters, a prior's or the lifter's, that a prior asked to leave as they are in this step."""
        for prior in self.priors.values():
            if prior.gate_itself:
                yield from prior.parameters()
            if prior.gate_lifter:
                yield from lifter.parameters()


@contextmanager
def _frozen(modules: Iterable[nn.Module]) -> Iterator[None]:
    """Compute no gradients of the modules' parameters; gradients still flow through them."""
    parameters = [p for module in modules for p in module.parameters() if p.requires_grad]
    for parameter in parameters:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in parameters:
            parameter.requires_grad_(True)
