"""Train a mixture of shapes from masks alone: explain every mask from some view, turn, and let the priors judge."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from uplift.config import TeacherSettings
from uplift.errors import UserError
from uplift.priors.shape_base import ShapePrior
from uplift.shapes.lift import ShapeLift
from uplift.shapes.mask_set import MaskSet
from uplift.shapes.mixture import ShapeMixture, temperature_at
from uplift.training.base import LifterTraining
from uplift.training.watch import blame

__all__ = ["MixtureTraining"]

_TURNED = 64
_TRUTH_WEIGHT = 3.0
_SIZE_WEIGHT = 1.0


class MixtureTraining(LifterTraining):
    """The free energy of masks under a mixture, with weighted priors; all of it is one backward.

    The temperature falls from ``shape.hot`` to ``shape.cold`` (deterministic annealing): views are
    held to be unsure while the shapes are.
    """

    lifter: ShapeMixture  # type: ignore[assignment]
    settings: TeacherSettings

    def __init__(
        self,
        mixture: ShapeMixture,
        data: MaskSet,
        settings: TeacherSettings,
        priors: Mapping[str, ShapePrior],
        weights: Mapping[str, float],
        seed: int,
    ):
        super().__init__(mixture, data, settings, seed)
        self.priors = nn.ModuleDict(priors)
        self.weights = dict(weights)
        self.adversarial = [name for name, p in priors.items() if type(p).own_loss is not ShapePrior.own_loss]

    @property
    def mirrors(self) -> bool:
        """Whether masks are shown mirrored half the time: only where shapes are their own mirror image."""
        return self.settings.mirror and self.lifter.settings.symmetric

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return the groups of the grids and of the priors' own parameters."""
        groups = [{"params": list(self.lifter.parameters()), "lr": self.settings.learning_rate, "name": "shapes"}]
        own = list(self.priors.parameters())
        rate = self.settings.prior_learning_rate or 1e-3
        return groups + ([{"params": own, "lr": rate, "name": "priors"}] if own else [])

    def objective(self) -> tuple[Tensor, dict[str, float | Tensor]]:
        """Return the loss of one random batch and the numbers to log."""
        data, shape = self.data, self.lifter.settings
        rows = torch.randint(len(data), (self.settings.batch_size,), device=data.crops.device)
        masks, spread = data.crops[rows], data.spread[rows]
        temperature = temperature_at(self.done, shape.hot, shape.cold)
        drawn = self.lifter.crops()
        known = data.labelled[rows]
        flipped = torch.rand(len(rows), device=masks.device) < (0.5 if self.mirrors else 0.0)
        flipped &= ~known  # a label tells the view of the mask as it is
        masks = torch.where(flipped[:, None, None], masks.flip(-1), masks)
        evidence = self.lifter.evidence(masks, spread, drawn, temperature)
        if bool(known.any()):
            elsewhere = torch.arange(evidence.shape[2], device=masks.device)[None] != data.view[rows][:, None]
            evidence = evidence.masked_fill((known[:, None] & elsewhere)[:, None], -1e4)
        energy = -temperature * torch.logsumexp(evidence.flatten(1), 1).mean()
        responsibility = evidence.detach().flatten(1).softmax(1).view_as(evidence)
        self.lifter.balance(responsibility)
        loss = energy + _SIZE_WEIGHT * self.lifter.size_loss(drawn)
        logged: dict[str, float | Tensor] = {"energy": energy.detach()}
        if bool(known.any()):
            truth = self._unlike_truth(responsibility.sum(2)[known], data.shapes[data.shape[rows][known]])
            loss, logged = loss + _TRUTH_WEIGHT * known.float().mean() * truth, logged | {"truth": truth.detach()}
        judged, more = self._priors(masks, drawn[0], responsibility)
        return loss + judged, logged | more

    def _unlike_truth(self, share: Tensor, shapes: Tensor) -> Tensor:
        """Return the cross-entropy of true shapes under the shapes that stand for them."""
        logits = self.lifter.full_logits
        each = -(
            shapes.flatten(1) @ nn.functional.logsigmoid(logits).flatten(1).T
            + (1 - shapes).flatten(1) @ nn.functional.logsigmoid(-logits).flatten(1).T
        )
        return (each / shapes[0].numel() * share).sum(1).mean()

    def _priors(self, masks: Tensor, cut: Tensor, responsibility: Tensor) -> tuple[Tensor, dict[str, float | Tensor]]:
        """Return the weighted sum of the priors and each one's loss."""
        total, logged = masks.new_zeros(()), dict[str, float | Tensor]()
        if not self.priors:
            return total, logged
        flat = cut.flatten(0, 1)
        turned = flat[torch.randint(len(flat), (_TURNED,), device=flat.device)]
        occupancy = self.lifter.occupancy
        views = self.lifter.grid.views.to(masks)
        lift = ShapeLift(self.lifter.full_logits, occupancy, turned, masks, responsibility, views, self.done)
        for name, prior in self.priors.items():
            still = name in self.adversarial
            prior.requires_grad_(not still)
            with blame(name, prior, "loss"):
                value = prior.loss(lift)  # type: ignore[operator]
            prior.requires_grad_(True)
            if not isinstance(value, Tensor) or value.shape != () or not bool(torch.isfinite(value)):
                found = f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
                raise UserError(f"priors.{name}: loss(lift) returned {found}: {value}. Expected one finite number.")
            total = total + self.weights[name] * value
            logged[name] = value.detach()
            if still:
                with blame(name, prior, "own_loss"):
                    own = prior.own_loss(masks[:_TURNED], turned.detach())  # type: ignore[operator]
                if not isinstance(own, Tensor) or own.shape != () or not own.requires_grad:
                    raise UserError(
                        f"priors.{name}: own_loss(real, seen) must return one number made with its parameters."
                    )
                total, logged[f"{name}_own"] = total + own, own.detach()
        return total, logged
