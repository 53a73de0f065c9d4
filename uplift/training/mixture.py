"""Find the views of masks: a mixture of shapes, trained from masks alone by expectation and maximisation."""

from __future__ import annotations

import copy
import dataclasses
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.config import ranks
from uplift.config.settings import TeacherSettings
from uplift.config.trust import consents
from uplift.data.mask_tensors import MaskSet
from uplift.data.masks import MaskData
from uplift.data.module import MaskDataModule
from uplift.errors import UserError
from uplift.models.mixture import AZIMUTHS, LEAST, MOST, Drawn, ShapeMixture, agree_on_front, split, temperature_at
from uplift.priors import build_priors
from uplift.priors.base import Prior, ShapeLift
from uplift.training.base import (
    TrainingModule,
    add_given,
    plain_settings,
    prior_specs,
    saved_priors,
    seeded,
    stage_settings,
)
from uplift.training.objective import Logged, Objective, prepare_priors

__all__ = ["EStepStatistics", "MixtureModule"]

# The expectation step: which masks each shape explains from each view, as the sums that the gradient needs.

_CHUNK = 500
_POOLED = 0.9
"""How much smaller errors of pooled crops are; with this factor they give nearly the same shares as full crops."""
_FAINT = 0.01
"""Shares of a mask below this fraction of its largest are left out of the sums."""


class EStepStatistics(nn.Module):
    """Sufficient statistics of the expectation step, as buffers, so that a fit resumes where it was.

    The log likelihood of a mask under a shape and view is linear in the mask, so the gradient needs only the
    mean of the masks that a silhouette explains and their share. The expectation over all masks is therefore
    computed once in many steps, and a step costs the rendering of a few views.
    """

    weight: Tensor
    """(shapes drawn), share of all masks; sums to 1."""
    mask: Tensor
    """(shapes drawn side side), their mean; masks of mirrored views are mirrored."""
    ratio: Tensor
    """(shapes drawn), the mean logarithm of their width over height."""
    energy: Tensor
    """(), minus the mean log likelihood of a mask, times the temperature."""
    labelled: Tensor
    """(shapes,), share of all masks that are labelled and explained by each shape."""
    truth: Tensor
    """(shapes depth height width), the mean of their true shapes."""

    def __init__(self, mixture: ShapeMixture, labels: bool, pooled: int = 1):
        """Make zeros; with ``labels`` also for true shapes; ``pooled`` pixels along an axis are compared as one."""
        super().__init__()
        self.labels, self.pooled = labels, pooled
        parts, drawn = len(mixture.logits), len(mixture.grid.drawn)
        side, n = mixture.settings.crop, mixture.settings.coarse if labels else 1
        sizes = {
            "weight": (parts, drawn), "mask": (parts, drawn, side, side), "ratio": (parts, drawn), "energy": (),
            "labelled": (parts,), "truth": (parts, n, n, n),
        }  # fmt: skip
        for name, size in sizes.items():
            self.register_buffer(name, torch.zeros(size))

    @torch.no_grad()
    def update(self, mixture: ShapeMixture, data: MaskSet, temperature: float) -> None:
        """Compute all sums over all masks with the current shapes."""
        drawn = mixture.crops()
        if self.pooled > 1:
            drawn = drawn._replace(cut=nn.functional.avg_pool2d(drawn.cut, self.pooled))
            temperature *= _POOLED
        for part in self.buffers():
            part.zero_()
        with ranks.work_shared():
            for start in ranks.my_parts(range(0, len(data), _CHUNK)):
                self._add(mixture, data.select(slice(start, start + _CHUNK)), drawn, temperature)
            ranks.sum_of_parts(*self.buffers())
        self.mask /= self.weight.clamp_min(1e-9)[..., None, None]
        self.ratio /= self.weight.clamp_min(1e-9)
        self.truth /= self.labelled.clamp_min(1e-9)[:, None, None, None]
        for part in (self.weight, self.labelled, self.energy):
            part /= len(data)

    def _add(self, mixture: ShapeMixture, data: MaskSet, drawn: Drawn, temperature: float) -> None:
        masks, spread, known = data.crops, data.spread, data.labelled
        small = nn.functional.avg_pool2d(masks, self.pooled) if self.pooled > 1 else masks
        evidence = mixture.evidence(small, spread, drawn, temperature)
        if bool(known.any()):
            nearest = (data.view.flatten(1) @ mixture.grid.views.to(masks).flatten(1).T).argmax(1)
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
            labelled = share[known].sum(2)
            self.labelled += labelled.sum(0)
            self.truth += (labelled.T @ data.shapes[data.shape[known]].flatten(1)).view_as(self.truth)

    def loss(self, mixture: ShapeMixture, drawn: Drawn, rows: Sequence[int], temperature: float) -> Float[Tensor, ""]:
        """Return the error of the silhouettes ``drawn`` from ``rows`` of the views, an estimate of the error of all."""
        pixels, target = drawn.cut.clamp(LEAST, MOST), self.mask[:, rows]
        error = -(target * pixels.log() + (1 - target) * (1 - pixels).log()).mean((-2, -1))
        ratio = (drawn.spread[..., 0] / drawn.spread[..., 1]).log()
        proportions = 0.5 * ((self.ratio[:, rows] - ratio) / mixture.settings.proportions) ** 2
        each = (error + temperature * proportions) * self.weight[:, rows]
        return each.sum() * self.weight.shape[1] / len(rows)

    def label_loss(self, logits: Float[Tensor, "shapes depth height width"]) -> Float[Tensor, ""]:
        """Return the cross-entropy of the true shapes of labelled masks under the shapes that explain them."""
        each = -(self.truth * nn.functional.logsigmoid(logits) + (1 - self.truth) * nn.functional.logsigmoid(-logits))
        return (each.mean((1, 2, 3)) * self.labelled).sum()


# The maximisation step: shapes learn to explain their masks, and priors judge them.

_SEEN = 64
"""Silhouettes that priors judge in a step."""
_VIEWS = 12
"""Views that a step renders."""
_OFTEN, _SELDOM = 5, 25
"""Steps between expectations: with annealing, where shapes change fast, and without."""
_BALANCE_HOT = (0.3, 0.09)
_BALANCE_COLD = (0.0, 0.2)
"""Rates at which azimuths and shapes are balanced at each expectation; the few masks of a late shape need not show
all azimuths."""
_MOST_VALIDATED = 20
_TRUTH_WEIGHT = 3.0
_SIZE_WEIGHT = 1.0
_PRIOR_LEARNING_RATE = 1e-3
"""Of the priors' own parameters, as the shapes' rate is too high for networks."""


class MixtureModule(TrainingModule[ShapeMixture, MaskSet]):
    """Learn a mixture of shapes from masks by expectation and maximisation, with weighted priors; one backward pass per step.

    Once in ``every`` steps the expectation step runs over all masks (`EStepStatistics`); in between, the
    shapes learn to explain those masks better, each step from a few views. With ``hot`` the temperature of
    the likelihood falls from ``shape.temperature_start`` to ``shape.temperature_end`` (deterministic annealing):
    views stay uncertain while the shapes are. Otherwise it is ``shape.temperature_end``, and azimuths keep their
    balance.

    Example::

        data = uplift.MaskDataModule(2000, family="chairs")
        module = uplift.MixtureModule()
        lightning.Trainer(max_steps=300).fit(module, data)
        finer = module.split(4)

    Hooks for subclasses: `configure_lifter`, `configure_priors`, `objective`, and those of Lightning.

    Args:
        shape: settings ``shape.NAME`` by name.
        priors: for each prior its weight, its settings, its class or a `uplift.ShapePrior`; none by default.
        parts: how many shapes; ``shape.parts`` if None.
        azimuths: how many azimuths there are views from.
        hot: whether the temperature falls.
        seed: of the shapes and of all random numbers.
        training: settings ``teacher.NAME`` by name: ``learning_rate``, ``decay_from``, ...

    Raises:
        UserError: an unknown or invalid setting.
    """

    settings: TeacherSettings
    _priors_are_prepared: bool = False

    @consents
    def __init__(
        self,
        *,
        shape: Mapping[str, Any] | None = None,
        priors: Mapping[str, Any] | None = None,
        parts: int | None = None,
        azimuths: int = AZIMUTHS,
        hot: bool = True,
        seed: int = 0,
        **training: Any,
    ):
        super().__init__()
        if min(parts or 1, azimuths) < 1 or parts == 0:
            raise UserError(f"parts={parts}, azimuths={azimuths}: expected whole numbers of at least 1.")
        specs, self._given_priors = prior_specs(priors)
        chosen = stage_settings("teacher", training, "masks", shape=shape, priors=specs, seed=seed)
        self.shape_settings, self.prior_specs = chosen.shape, chosen.priors
        self.parts, self.azimuths, self.hot = parts or chosen.shape.parts, azimuths, hot
        self.save_hyperparameters(
            {
                "shape": dataclasses.asdict(chosen.shape), "priors": saved_priors(chosen.priors, self._given_priors), "parts": self.parts,
                "azimuths": azimuths, "hot": hot, "seed": seed, **plain_settings(chosen.teacher),
            }
        )  # fmt: skip
        with seeded(seed):
            terms = Objective(*self.configure_priors())
        with seeded(seed):
            mixture = self.configure_lifter()
            self._stream = torch.get_rng_state()
        self.every = _OFTEN if hot else _SELDOM
        self.prior_rate = chosen.teacher.prior_learning_rate or _PRIOR_LEARNING_RATE
        self.set_up(mixture, chosen.teacher, seed, terms)
        self.statistics = EStepStatistics(mixture, False, self._pooled)

    @property
    def _pooled(self) -> int:
        return 1 if self.hot or self.shape_settings.crop % 2 else 2

    def configure_lifter(self) -> ShapeMixture:
        """Return the untrained mixture of shapes."""
        return ShapeMixture(self.shape_settings, self.parts, self.azimuths)

    def configure_priors(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Return the priors by name, and their weights."""
        priors, weights, self.notes = build_priors(self.prior_specs)
        add_given(priors, weights, self._given_priors)
        return priors, weights

    def prepare(self, data: MaskDataModule | Any) -> None:
        """Take the training masks, show them to the priors, and look at their labels."""
        if not isinstance(data, MaskDataModule):
            raise UserError(f"MixtureModule trains on a uplift.MaskDataModule, found {type(data).__name__}.")
        self.prepared_with, self.frames = (
            weakref.ref(data),
            data.mask_set(self.shape_settings, self.shape_settings.coarse),
        )
        if not self._priors_are_prepared:
            with seeded(0):
                torch.set_rng_state(self._stream)
                prepare_priors(self.terms.priors, self.frames)
        self._priors_are_prepared = False  # other data, if any, are shown to them
        self.statistics = EStepStatistics(self.lifter, bool(self.frames.labelled.any()), self._pooled)
        self.lifter.silhouettes([0])  # makes the projector's matrices, which take a while

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Make room for the true shapes of labelled masks, where the checkpoint has them."""
        super().on_load_checkpoint(checkpoint)
        labels = checkpoint["state_dict"]["statistics.truth"].shape[-1] > 1
        self.statistics = EStepStatistics(self.lifter, labels, self._pooled).to(self.device)

    def split(self, times: int, azimuths: int = AZIMUTHS, seed: int = 0, reheat: bool = True) -> MixtureModule:
        """Return a module that goes on from this one with ``times`` as many shapes, which agree on their front.

        ``seed`` is that of the noise that tells copies of a shape apart; with ``reheat`` the temperature starts at
        ``shape.temperature_again`` and falls once more. The priors are the same objects.
        """
        with seeded(seed):
            mixture = self._copied()
            if self.shape_settings.gravity:
                agree_on_front(mixture)
            made = split(mixture, times, azimuths)
        parts, azimuths = made.azimuth_bias.shape
        shape = dict(self.hparams["shape"])
        if reheat:
            shape["temperature_start"] = shape["temperature_again"]
        changed = {"priors": {}, "parts": parts, "azimuths": azimuths, "hot": reheat, "shape": shape}
        module = type(self)(**{**self.hparams, **changed})
        module.hparams["priors"] = self.hparams["priors"]
        module.start_from(made)
        module.terms, module.priors, module.prior_specs = self.terms, self.priors, self.prior_specs
        module._given_priors, module._priors_are_prepared = self._given_priors, self.prepared_with is not None
        return module

    def _copied(self) -> ShapeMixture:
        """Return a copy of the trained mixture on the CPU; the projector, which is large, is shared."""
        final, projector = self.final, self.lifter.projector
        final.projector = self.lifter.projector = None
        copied = copy.deepcopy(final).cpu().eval()
        final.projector = self.lifter.projector = copied.projector = projector
        return copied

    def start_from(self, mixture: ShapeMixture) -> None:
        """Copy the shapes of another mixture of the same sizes."""
        for one in {self.lifter, self.final}:
            one.load_state_dict(mixture.state_dict())
        self.lifter.projector = mixture.projector

    def figures(self, batch: MaskData) -> dict[str, float]:
        """Return nothing: views are found here, and shapes are scored when there is a space of them."""
        return {}

    @property
    def mirrors(self) -> bool:
        """Whether priors see half of the masks mirrored: only where shapes are their own mirror image."""
        return self.settings.mirror and self.shape_settings.symmetric

    @property
    def temperature(self) -> float:
        """Of the likelihood, at this step."""
        start, end = self.lifter.settings.temperature_start, self.lifter.settings.temperature_end
        return temperature_at(self.done, start, end) if self.hot else end

    def objective(self, batch: int) -> tuple[Tensor, Logged]:
        """Return the loss from a few random views and its terms; priors are given ``batch`` masks."""
        mixture, statistics = self.lifter, self.statistics
        assert self.frames is not None
        if self.stream_step % self.every == 0:
            statistics.update(mixture, self.frames, self.temperature)
            mixture.balance(self.used, *(_BALANCE_HOT if self.hot else _BALANCE_COLD))
        count = len(mixture.grid.drawn)
        rows = torch.randperm(count)[:_VIEWS].tolist()
        drawn = mixture.cut_out(rows)
        silhouettes = statistics.loss(mixture, drawn, rows, self.temperature)
        loss = silhouettes + _SIZE_WEIGHT * mixture.size_loss(drawn)
        logged: Logged = {"energy": statistics.energy, "silhouettes": silhouettes.detach()}
        if statistics.labels:
            truth = statistics.label_loss(mixture.full_logits)
            loss, logged["truth"] = loss + _TRUTH_WEIGHT * truth, truth.detach()
        if self.terms.priors:
            lift = self.last_lift = self._lift(drawn, batch)
            judged, losses = self.terms.judge(lift, self.global_step)
            own, critic_losses = self.terms.train_adversaries(lift.masks[:_SEEN], lift.reprojected.detach())
            loss, logged = loss + judged + own, {**logged, **losses, **critic_losses}
        return loss, logged

    @property
    def used(self) -> Float[Tensor, "shapes views"]:
        """Share of the masks that each shape explains from each view, mirror images among them; sums to 1."""
        used = self.lifter.grid.for_all_views(self.statistics.weight)
        return used / used.sum().clamp_min(1e-9)

    def _lift(self, drawn: Drawn, count: int) -> ShapeLift:
        """Return what priors judge in this step."""
        masks = self._masks(count)
        flat = drawn.cut.flatten(0, 1)
        seen = flat[torch.randint(len(flat), (_SEEN,), device=flat.device)]
        if self.lifter.grid.mirrored is not None:  # the views that are not rendered see mirror images
            seen = torch.cat([seen[::2], seen[1::2].flip(-1)])
        views = self.lifter.grid.views.to(masks)
        return ShapeLift(self.lifter.full_logits, self.lifter.occupancy, seen, masks, self.used, views, self.done)

    def _masks(self, count: int) -> Float[Tensor, "items side side"]:
        """Return a batch of real masks, half of them mirrored if shapes are their own mirror image."""
        assert self.frames is not None
        crops = self.frames.crops
        rows = torch.randint(len(crops), (count,), device=crops.device)
        flipped = torch.rand(len(rows), device=rows.device) < (0.5 if self.mirrors else 0.0)
        masks = crops[rows]
        return torch.where(flipped[:, None, None], masks.flip(-1), masks)
