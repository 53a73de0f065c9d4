"""Train a mixture of shapes from masks alone: explain every mask from some view, turn, and let the priors judge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.config.settings import TeacherSettings
from uplift.data.tensors import MaskSet
from uplift.errors import UserError
from uplift.models.mixture import LEAST, MOST, Drawn, ShapeMixture, temperature_at
from uplift.priors.base import blame
from uplift.priors.shape_base import ShapeLift, ShapePrior
from uplift.training.base import LifterTraining

__all__ = ["Explained", "MixtureTraining"]

# `Explained`: which masks each shape explains from each view, summed up: all that the shapes are then trained on.

_CHUNK = 500
_POOLED = 0.9
"""How much smaller the errors of pooled crops are: with it, they give nearly the shares that whole crops do."""
_FAINT = 0.01
"""Shares of a mask below this, of its largest, are left out of the sums."""


class Explained(nn.Module):
    """The expectation step of a mixture, as buffers, so that a fit resumes where it was.

    The likelihood of masks under a shape and view is linear in the mask: the mean of the masks that a
    silhouette explains, and how many they are, are all that its gradient needs. So the expectation over
    all masks is made once in many steps, and a step costs the drawing of a few views.
    """

    weight: Tensor
    """(shapes drawn): share of all masks; sums to 1."""
    mask: Tensor
    """(shapes drawn side side): their mean, those of mirrored views mirrored."""
    ratio: Tensor
    """(shapes drawn): the mean logarithm of their width over height."""
    energy: Tensor
    told: Tensor
    """(shapes,): share of all masks that are labelled and explained by each shape."""
    truth: Tensor
    """(shapes depth height width): the mean of their true shapes."""

    def __init__(self, mixture: ShapeMixture, labels: bool, pooled: int = 1):
        """``labels``: true shapes are summed up too; ``pooled``: pixels, along an axis, that are compared as one."""
        super().__init__()
        self.pooled = pooled
        parts, drawn = len(mixture.logits), len(mixture.grid.drawn)
        side, n = mixture.settings.crop, mixture.settings.detail if labels else 1
        self.labels = labels
        sizes = {
            "weight": (parts, drawn), "mask": (parts, drawn, side, side), "ratio": (parts, drawn), "energy": (),
            "told": (parts,), "truth": (parts, n, n, n),
        }  # fmt: skip
        for name, size in sizes.items():
            self.register_buffer(name, torch.zeros(size))

    @torch.no_grad()
    def update(self, mixture: ShapeMixture, data: MaskSet, temperature: float) -> None:
        """Make all sums anew, over all masks, with the shapes as they are."""
        drawn = mixture.crops()
        if self.pooled > 1:
            drawn = drawn._replace(cut=nn.functional.avg_pool2d(drawn.cut, self.pooled))
            temperature *= _POOLED
        for part in self.buffers():
            part.zero_()
        for start in range(0, len(data), _CHUNK):
            rows = torch.arange(start, min(start + _CHUNK, len(data)), device=data.crops.device)
            self._add(mixture, data, drawn, rows, temperature)
        self.mask /= self.weight.clamp_min(1e-9)[..., None, None]
        self.ratio /= self.weight.clamp_min(1e-9)
        self.truth /= self.told.clamp_min(1e-9)[:, None, None, None]
        for part in (self.weight, self.told, self.energy):
            part /= len(data)

    def _add(self, mixture: ShapeMixture, data: MaskSet, drawn: Drawn, rows: Tensor, temperature: float) -> None:
        masks, spread, known = data.crops[rows], data.spread[rows], data.labelled[rows]
        small = nn.functional.avg_pool2d(masks, self.pooled) if self.pooled > 1 else masks
        evidence = mixture.evidence(small, spread, drawn, temperature)
        if bool(known.any()):
            nearest = (data.view[rows].flatten(1) @ mixture.grid.views.to(masks).flatten(1).T).argmax(1)
            elsewhere = torch.arange(evidence.shape[2], device=masks.device)[None] != nearest[:, None]
            evidence = evidence.masked_fill((known[:, None] & elsewhere)[:, None], -1e4)
        self.energy -= temperature * torch.logsumexp(evidence.flatten(1), 1).sum()
        share = evidence.flatten(1).softmax(1)
        share = share.where(share > _FAINT * share.amax(1, keepdim=True), 0).view_as(evidence)
        share = share / share.sum((1, 2), keepdim=True).clamp_min(1e-9)
        grid, ratio = mixture.grid, (spread[:, 0] / spread[:, 1]).log()
        for views, seen in ((grid.drawn, masks), (grid.mirrored, masks.flip(-1))):
            if views is None:
                continue
            flat = share[:, :, views.to(share.device)].flatten(1).T
            self.weight += flat.sum(1).view_as(self.weight)
            self.mask += (flat.to_sparse_csr() @ seen.flatten(1)).view_as(self.mask)
            self.ratio += (flat @ ratio).view_as(self.ratio)
        if self.labels and bool(known.any()):
            told = share[known].sum(2)
            self.told += told.sum(0)
            self.truth += (told.T @ data.shapes[data.shape[rows][known]].flatten(1)).view_as(self.truth)

    def loss(self, mixture: ShapeMixture, drawn: Drawn, rows: Sequence[int], temperature: float) -> Float[Tensor, ""]:
        """Return the error of the silhouettes ``drawn`` from ``rows`` of the drawn views; an estimate of that of all."""
        pixels, target = drawn.cut.clamp(LEAST, MOST), self.mask[:, rows]
        error = -(target * pixels.log() + (1 - target) * (1 - pixels).log()).mean((-2, -1))
        wide = (drawn.spread[..., 0] / drawn.spread[..., 1]).log()
        unlike = 0.5 * ((self.ratio[:, rows] - wide) / mixture.settings.proportions) ** 2
        each = (error + temperature * unlike) * self.weight[:, rows]
        return each.sum() * self.weight.shape[1] / len(rows)

    def unlike_truth(self, logits: Float[Tensor, "shapes depth height width"]) -> Float[Tensor, ""]:
        """Return the cross-entropy of the true shapes of labelled masks under the shapes that explain them."""
        each = -(self.truth * nn.functional.logsigmoid(logits) + (1 - self.truth) * nn.functional.logsigmoid(-logits))
        return (each.mean((1, 2, 3)) * self.told).sum()


# Train a mixture of shapes from masks alone: explain every mask from some view, turn, and let the priors judge.

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
    the likelihood falls from ``shape.temperature_start`` to ``shape.temperature_end`` (deterministic annealing): views are held
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
        start, end = self.lifter.settings.temperature_start, self.lifter.settings.temperature_end
        return temperature_at(self.done, start, end) if self.hot else end

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
