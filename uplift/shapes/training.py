"""Train a mixture of shapes from masks alone: explain every mask from some view, turn, and let the priors judge."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.config import TeacherSettings
from uplift.errors import UserError
from uplift.priors.shape_base import ShapePrior
from uplift.shapes.explained import Explained
from uplift.shapes.lift import ShapeLift
from uplift.shapes.mask_set import MaskSet
from uplift.shapes.mixture import Drawn, ShapeMixture, temperature_at
from uplift.training.base import LifterTraining
from uplift.training.watch import blame

__all__ = ["MixtureTraining"]

_TURNED = 64
_VIEWS = 12
"""Views that a step draws."""
_OFTEN, _SELDOM = 5, 25
"""Steps between expectations: over few shapes that change fast, over many whose views are known."""
_BALANCE_HOT = (0.3, 0.09)
_BALANCE_COLD = (0.0, 0.2)
"""How fast azimuths and shapes are balanced at each expectation; a shape of few masks has not all azimuths."""
_TRUTH_WEIGHT = 3.0
_SIZE_WEIGHT = 1.0


class MixtureTraining(LifterTraining):
    """Expectation and maximisation of a mixture, with weighted priors; a step is one backward.

    Once in ``every`` steps all masks are explained by the shapes as they are (`Explained`); in between the
    shapes learn to explain those masks better, each step from a few views. With ``hot`` the temperature of
    the likelihood falls from ``shape.hot`` to ``shape.cold`` (deterministic annealing): views are held
    to be unsure while the shapes are. Otherwise it is cold, and azimuths are as balanced as they were.
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
        hot: bool = True,
    ):
        super().__init__(mixture, data, settings, seed)
        self.priors = nn.ModuleDict(priors)
        self.weights = dict(weights)
        self.adversarial = [name for name, p in priors.items() if type(p).own_loss is not ShapePrior.own_loss]
        self.hot = hot
        self.every = _OFTEN if hot else _SELDOM
        pooled = 1 if hot or mixture.settings.crop % 2 else 2
        self.explained = Explained(mixture, bool(data.labelled.any()), pooled)

    @property
    def mirrors(self) -> bool:
        """Whether priors see masks mirrored half the time: only where shapes are their own mirror image."""
        return self.settings.mirror and self.lifter.settings.symmetric

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return the groups of the grids and of the priors' own parameters."""
        groups = [{"params": list(self.lifter.parameters()), "lr": self.settings.learning_rate, "name": "shapes"}]
        own = list(self.priors.parameters())
        rate = self.settings.prior_learning_rate or 1e-3
        return groups + ([{"params": own, "lr": rate, "name": "priors"}] if own else [])

    @property
    def temperature(self) -> float:
        """Of the likelihood, at this step."""
        shape = self.lifter.settings
        return temperature_at(self.done, shape.hot, shape.cold) if self.hot else shape.cold

    def objective(self) -> tuple[Tensor, dict[str, float | Tensor]]:
        """Return the loss from a few random views and the numbers to log."""
        mixture, explained = self.lifter, self.explained
        if self.global_step % self.every == 0:
            explained.update(mixture, self.data, self.temperature)
            mixture.balance(self.used, *(_BALANCE_HOT if self.hot else _BALANCE_COLD))
        count = len(mixture.grid.drawn)
        rows = torch.randperm(count)[:_VIEWS].tolist()
        drawn = mixture.cut_out(rows)
        unlike = explained.loss(mixture, drawn, rows, self.temperature)
        loss = unlike + _SIZE_WEIGHT * mixture.size_loss(drawn)
        logged: dict[str, float | Tensor] = {"energy": explained.energy, "silhouettes": unlike.detach()}
        if explained.labels:
            truth = explained.unlike_truth(mixture.full_logits)
            loss, logged = loss + _TRUTH_WEIGHT * truth, logged | {"truth": truth.detach()}
        judged, more = self._priors(drawn)
        return loss + judged, logged | more

    @property
    def used(self) -> Float[Tensor, "shapes views"]:
        """Share of the masks that each shape explains from each view, mirror images among them; sums to 1."""
        whole = self.lifter.grid.whole(self.explained.weight)
        return whole / whole.sum().clamp_min(1e-9)

    def _priors(self, drawn: Drawn) -> tuple[Tensor, dict[str, float | Tensor]]:
        """Return the weighted sum of the priors and each one's loss."""
        total, logged = drawn.cut.new_zeros(()), dict[str, float | Tensor]()
        if not self.priors:
            return total, logged
        masks = self._masks()
        flat = drawn.cut.flatten(0, 1)
        turned = flat[torch.randint(len(flat), (_TURNED,), device=flat.device)]
        if self.lifter.grid.mirrored is not None:  # the views that are not drawn see mirror images
            turned = torch.cat([turned[::2], turned[1::2].flip(-1)])
        occupancy = self.lifter.occupancy
        views = self.lifter.grid.views.to(masks)
        lift = ShapeLift(self.lifter.full_logits, occupancy, turned, masks, self.used, views, self.done)
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

    def _masks(self) -> Float[Tensor, "items side side"]:
        """Return a batch of real masks, mirrored half the time where they may be."""
        rows = torch.randint(len(self.data), (self.settings.batch_size,), device=self.data.crops.device)
        flipped = torch.rand(len(rows), device=rows.device) < (0.5 if self.mirrors else 0.0)
        masks = self.data.crops[rows]
        return torch.where(flipped[:, None, None], masks.flip(-1), masks)
