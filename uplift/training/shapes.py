"""Train a space of shapes from masks alone: codes, a decoder, and the pose of every mask, with priors on what is learned."""

from __future__ import annotations

import copy
import dataclasses
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy, interpolate

from uplift.config import ranks
from uplift.config.device import half_is_fast
from uplift.config.files import refuse_existing
from uplift.config.settings import TeacherSettings
from uplift.config.trust import consents
from uplift.data.mask_tensors import MaskSet
from uplift.data.masks import FILL, MaskData
from uplift.data.module import MaskDataModule
from uplift.errors import UserError
from uplift.metrics.evaluate_shapes import evaluate_shapes, silhouettes_seen
from uplift.models.lifter import mixed_networks
from uplift.models.model import ShapeModel
from uplift.models.prediction import ShapePrediction
from uplift.models.shape_lifter import LiftedShapes, pick_views
from uplift.models.shape_space import MASK_SIDE, ShapeSpace
from uplift.models.silhouettes import ObjectPose
from uplift.models.view_hypotheses import ViewHypotheses, likely_views
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
from uplift.training.mixture import MixtureModule
from uplift.training.objective import Logged, Objective, frozen, prepare_priors

__all__ = ["MaskPoses", "ShapeModule"]

# What is unknown of every training mask: where its shape stands, by hypothesis.

_HYPOTHESES = 3
_FAINT_WEIGHT = 1e-4
_TRUST = 0.7
"""Power of the probabilities of hypotheses: what finds views is too sure of them."""


class MaskPoses(nn.Module):
    """The poses of training masks, several hypotheses for each, and how likely each of them is."""

    scale: nn.Parameter
    weight: Tensor
    """(items, hypotheses); sums to 1."""
    known: Tensor
    """(items,), whether the pose is the true one, of labelled masks."""

    def __init__(self, count: int):
        """Make places for the poses of ``count`` masks."""
        super().__init__()
        for name in ObjectPose._fields:
            size = (count, _HYPOTHESES, 2) if name == "offset" else (count, _HYPOTHESES)
            self.register_parameter(name, nn.Parameter(torch.zeros(size)))
        self.register_buffer("weight", torch.full((count, _HYPOTHESES), 1 / _HYPOTHESES))
        self.register_buffer("known", torch.zeros(count, dtype=torch.bool))

    @torch.no_grad()
    def set(self, views: ViewHypotheses, data: MaskSet) -> None:
        """Take hypotheses, and of labelled masks the truth."""
        for name, value in views.poses._asdict().items():
            getattr(self, name).copy_(value)
        weight = views.weight.clamp_min(_FAINT_WEIGHT) ** _TRUST
        self.weight.copy_(weight / weight.sum(1, keepdim=True))
        self.known.copy_(data.labelled)
        truth = ObjectPose.of(data.view[data.labelled], data.scale[data.labelled], data.offset[data.labelled])
        for name, value in truth._asdict().items():
            getattr(self, name)[data.labelled] = value.unsqueeze(1)

    def drawn(self, rows: Int[Tensor, " batch"]) -> ObjectPose:
        """Return one hypothesis of each mask of ``rows``, drawn by its weight; known poses take no gradient."""
        picked = torch.multinomial(self.weight[rows], 1)[:, 0]
        pose = ObjectPose(*(getattr(self, name)[rows, picked] for name in ObjectPose._fields))
        return ObjectPose.where(self.known[rows], pose.detached(), pose)

    def hypotheses(self) -> ViewHypotheses:
        """Return all of them as they are now."""
        return ViewHypotheses(**{name: getattr(self, name).detach() for name in ObjectPose._fields}, weight=self.weight)

    @property
    def best(self) -> ObjectPose:
        """The likeliest of each mask."""
        return self.ranked(self.weight.argmax(1))

    def ranked(self, picked: Int[Tensor, " items"]) -> ObjectPose:
        """Return one hypothesis of each mask."""
        rows = torch.arange(len(picked), device=picked.device)
        return ObjectPose(*(getattr(self, name)[rows, picked].detach() for name in ObjectPose._fields))


# Training.

_TEMPERATURE = 0.0012
"""Of the likelihood: mean cross-entropy of a pixel per nat of the code."""
_SURE = 0.005
"""Bound of the opacity of a pixel, so that no mask is impossible."""
_PLACE_WEIGHT, _CYCLE_WEIGHT, _TURNED_WEIGHT, _KNOWN_WEIGHT = 10.0, 0.3, 1.0, 1.0
_KNOWN_TEMPERATURE = 0.0015
"""Mean cross-entropy of a voxel of a known shape per nat of the code."""
_KNOWN_SHARE = 4
"""A step has one labelled mask, and as many new views of known shapes, for so many others."""
_POSE_RATES = {"azimuth": 0.008, "roll": 0.008, "elevation": 0.0032, "scale": 0.0032, "offset": 0.0032}
_POSES_FROM = 0.3
"""Share of the first stage after which poses are learned too: by then there are shapes."""
_CYCLE_FROM = 0.4
_PRIOR_LEARNING_RATE = 1e-3
_PICK_CHUNK = 100
_MOST_PICKED = 8000
"""Masks whose views are looked for again between two stages."""
_MOST_VALIDATED = 20
_BIN = 0.6
"""Width of the target of the view head, in steps of its views."""


class ShapeModule(TrainingModule[ShapeSpace, MaskSet]):
    """Learn a `ShapeSpace` from masks and the views they may be from; one backward pass per step.

    A step draws masks, each with one of its hypotheses of a pose; encodes, decodes and renders them; and compares with
    the masks (a variational autoencoder). Poses are parameters too. A cycle makes a code what can be seen from any side:
    the silhouette from the pose of another mask must be encoded as the same code. Priors judge the shapes and those
    silhouettes. `go_on` continues at a finer grid, after the views of all masks were looked for again.

    Example::

        data = uplift.MaskDataModule(2000, family="chairs")
        views = uplift.MixtureModule()
        lightning.Trainer(max_steps=300).fit(views, data)
        coarse = uplift.ShapeModule(start=views, detail=16)
        lightning.Trainer(max_steps=300).fit(coarse, data)
        fine = coarse.go_on(detail=32)

    Hooks for subclasses: `configure_lifter`, `configure_priors`, `objective`, and those of Lightning.

    Args:
        start: a trained `MixtureModule`, which says where masks are seen from, or a trained space, which finds them.
        shape: settings ``shape.NAME`` by name.
        priors: for each prior its weight, its settings, its class or a `uplift.ShapePrior`; none by default.
        detail: voxels along the grids; ``shape.detail`` if None.
        seed: of the networks and of all random numbers.
        training: settings ``teacher.NAME`` by name: ``learning_rate``, ``decay_from``, ...

    Raises:
        UserError: an unknown or invalid setting.
    """

    settings: TeacherSettings
    poses: MaskPoses
    _priors_are_prepared: bool = False

    @consents
    def __init__(
        self,
        start: MixtureModule | ShapeSpace | None = None,
        *,
        shape: Mapping[str, Any] | None = None,
        priors: Mapping[str, Any] | None = None,
        detail: int | None = None,
        first: bool = True,
        seed: int = 0,
        **training: Any,
    ):
        super().__init__()
        specs, self._given_priors = prior_specs(priors)
        chosen = stage_settings("teacher", training, "masks", shape=shape, priors=specs, seed=seed)
        self.shape_settings, self.prior_specs = chosen.shape, chosen.priors
        self._start = (start,)  # in a tuple: its weights are not part of this module
        self.grid, self.first = detail or chosen.shape.detail, first
        self.save_hyperparameters(
            {
                "shape": dataclasses.asdict(chosen.shape), "priors": saved_priors(chosen.priors, self._given_priors),
                "detail": self.grid, "first": first, "seed": seed, **plain_settings(chosen.teacher),
            }
        )  # fmt: skip
        with seeded(seed):
            terms = Objective(*self.configure_priors())
        with seeded(seed):
            space = self.configure_lifter()
            self._stream = torch.get_rng_state()
        self.prior_rate = chosen.teacher.prior_learning_rate or _PRIOR_LEARNING_RATE
        self.poses = MaskPoses(0)
        self.set_up(space, chosen.teacher, seed, terms)

    def starts_from(self, start: MixtureModule | ShapeSpace) -> None:
        """Set what the training starts from, such as a mixture that was split since."""
        self._start = (start,)

    @property
    def start(self) -> MixtureModule | ShapeSpace | None:
        """What the training starts from."""
        return self._start[0]

    def configure_lifter(self) -> ShapeSpace:
        """Return the untrained space, or the one to start from at the resolution of this stage."""
        if isinstance(self.start, ShapeSpace):
            space = copy.deepcopy(self.start).train().requires_grad_()
            space.refine_grid(self.grid)
            return space
        return ShapeSpace(self.shape_settings, self.grid)

    def configure_priors(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Return the priors by name, and their weights."""
        priors, weights, self.notes = build_priors(self.prior_specs)
        add_given(priors, weights, self._given_priors)
        return priors, weights

    def prepare(self, data: MaskDataModule | Any) -> None:
        """Take the training masks, make places for their poses, and show them to the priors."""
        if not isinstance(data, MaskDataModule):
            raise UserError(f"ShapeModule trains on a uplift.MaskDataModule, found {type(data).__name__}.")
        self.prepared_with, self.frames = (
            weakref.ref(data),
            data.mask_set(self.shape_settings, self.shape_settings.detail),
        )
        if len(self.poses.weight) != len(self.frames):
            self.poses = MaskPoses(len(self.frames))
        self.poses.roll.requires_grad_(self.lifter.rolls)
        if not self._priors_are_prepared:
            with seeded(0):
                torch.set_rng_state(self._stream)
                prepare_priors(self.terms.priors, self.frames)
        self._priors_are_prepared = False  # other data, if any, are shown to them

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Make room for the poses of the checkpoint's masks."""
        super().on_load_checkpoint(checkpoint)
        self.poses = MaskPoses(len(checkpoint["state_dict"]["poses.weight"])).to(self.device)
        self.poses.roll.requires_grad_(self.lifter.rolls)

    def on_train_start(self) -> None:
        """Find the views of all masks, unless the stage is resumed."""
        super().on_train_start()
        if self.global_step == 0:
            self.find_views()

    def find_views(self) -> None:
        """Set the hypotheses of every mask's pose, from the mixture or as the space itself sees them."""
        assert self.frames is not None
        if isinstance(self.start, MixtureModule):
            found = likely_views(self.start.final, self.frames.masks, most=_HYPOTHESES)
        elif isinstance(self.start, ShapeSpace):
            found = self._picked()
        else:
            raise UserError(
                "ShapeModule starts from a trained uplift.MixtureModule, which finds the views of masks, or from a trained "
                "space: ShapeModule(start=...)."
            )
        if bool(self.frames.labelled.any()):
            found = found.scaled_to(self.frames)
        self.poses.set(found, self.frames)

    @torch.no_grad()
    def _picked(self) -> ViewHypotheses:
        """Return hypotheses of all masks, those that were and those of the view head, refined and judged by the space.

        Of very many masks those are judged that were least sure.
        """
        assert self.frames is not None
        before = self.poses.hypotheses() if bool((self.poses.scale > 0).any()) else None
        count = len(self.frames)
        order = torch.arange(count) if before is None else before.weight.amax(1).argsort(stable=True)
        rows = order[: count if before is None else _MOST_PICKED].sort().values
        chunks, space = rows.split(_PICK_CHUNK), self.start
        assert isinstance(space, ShapeSpace)  # as it was: a coarser grid is much faster
        half = torch.bfloat16 if "mixed" in str(self.trainer.precision) and half_is_fast(self.device) else None
        found = ViewHypotheses.empty(count, _HYPOTHESES, self.device) if before is None else before
        values = {name: value.clone() for name, value in vars(found).items()}
        with frozen([space]), self.inference(), mixed_networks(half), ranks.work_shared():
            for part in ranks.my_parts(chunks):
                own = None if before is None else before.select(part)
                for name, value in vars(pick_views(space, self.frames.masks[part], own, _HYPOTHESES)).items():
                    values[name][part] = value
            return ViewHypotheses(**{name: ranks.filled(value, chunks) for name, value in values.items()})

    def go_on(self, detail: int | None = None, seed: int = 0, **training: Any) -> ShapeModule:
        """Return a module that goes on from this one, at grids of ``detail`` voxels; priors are the same objects.

        ``training`` are settings ``teacher.NAME`` that change.
        """
        changed = {"priors": {}, "detail": detail or self.grid, "first": False, "seed": seed, **training}
        module = type(self)(self.final, **{**self.hparams, **changed})
        module.hparams["priors"] = self.hparams["priors"]
        module.poses = copy.deepcopy(self.poses)
        module.terms, module.priors, module.prior_specs = self.terms, self.priors, self.prior_specs
        module._given_priors, module._priors_are_prepared = self._given_priors, self.prepared_with is not None
        return module

    def model(self) -> ShapeModel:
        """Return a copy of the trained space as people use it: `predict`, `save`."""
        return ShapeModel(copy.deepcopy(self.final).cpu().eval().requires_grad_(False), self.shape_settings)

    def save(self, path: str | Path) -> None:
        """Write `model` to one file, which `uplift.load` and the command line take; raises UserError where it exists."""
        refuse_existing(Path(path))
        self.model().save(Path(path))

    def forward(self, masks: UInt8[np.ndarray, "items side side"]) -> LiftedShapes:
        """Return the shapes of masks, 0..255, cropped as `uplift.data.masks.MaskData` has them."""
        return self.model().lift(masks)

    def predict_step(self, batch: MaskData, batch_idx: int) -> ShapePrediction:
        """Return a shape for every mask, as ``uplift predict`` computes it."""
        with self.inference():
            return self.model().predict(batch)

    def figures(self, batch: MaskData) -> dict[str, float]:
        """Return every metric of shapes by name where true shapes are known, and the fit of silhouettes where not.

        During a fit at most 20 of the masks are scored, a fixed choice: each takes a third of a second.
        """
        if self._log_every and len(batch) > _MOST_VALIDATED:
            batch = batch.select(np.linspace(0, len(batch) - 1, _MOST_VALIDATED).astype(int))
        prediction = self.model().predict(batch.without_truth())
        if batch.truth is None or not np.isfinite(batch.truth.scale).all():
            return {"silhouette_iou_seen": float(np.mean(silhouettes_seen(prediction, batch.masks)))}
        return evaluate_shapes(prediction, batch.truth, batch.masks, batch.source, batch.category).overall

    # A step.

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return the optimiser's groups: the networks', one for each kind of pose parameter, and the priors'."""
        # Without momentum and decay a mask that is not in a step does not move.
        poses = [
            {
                "params": [getattr(self.poses, name)],
                "lr": rate,
                "betas": (0.0, 0.99),
                "weight_decay": 0.0,
                "name": f"pose_{name}",
            }
            for name, rate in _POSE_RATES.items()
            if getattr(self.poses, name).requires_grad
        ]
        return [*super().parameter_groups(), *poses]

    @property
    def mirrors(self) -> bool:
        """Whether half of the masks are mirrored: only where shapes are their own mirror image."""
        return self.settings.mirror and self.shape_settings.symmetric

    @property
    def pixels(self) -> int:
        """Pixels along the silhouettes that are compared: no finer than the grid at first."""
        return min(self.shape_settings.pixels, self.grid if self.grid < self.shape_settings.detail else 10**9)

    def objective(self, batch: int) -> tuple[Tensor, Logged]:
        """Return the loss of ``batch`` masks drawn at random, and its terms."""
        assert self.frames is not None
        space, settled = self.lifter, not self.first or self.done > _POSES_FROM
        rows = torch.randint(len(self.frames), (batch,), device=self.device)
        masks, pose = self._maybe_mirrored(self.frames.masks[rows].float() / 255, self.poses.drawn(rows))
        pose = pose if settled else pose.detached()
        features = space.features(masks)
        code, spread = self._coded(features, pose.detached())
        logits = space.logits(code)
        target = _smaller(masks, self.pixels)
        error = binary_cross_entropy(space.seen(logits, pose, self.pixels).clamp(_SURE, 1 - _SURE), target)
        warm = min(1.0, 0.02 + self.done) if self.first else 1.0
        loss = error / _TEMPERATURE + warm * spread + space.elevation_cost(pose.elevation).mean()
        loss = loss + self._heads_loss(features, pose.detached())
        logged: Logged = {"silhouettes": error.detach(), "code": spread.detach()}
        if self.global_step % 2 and (not self.first or self.done > _CYCLE_FROM):
            turned, other = self._turned(logits, pose.detached())
            cycle, heads = self._cycle_loss(code.detach(), turned.detach(), other)
            loss, logged["cycle"] = loss + _CYCLE_WEIGHT * cycle + _TURNED_WEIGHT * heads, cycle.detach()
            loss, logged = self._judged(
                loss, logged, ShapeLift.of(logits, _smaller(turned, self.pixels), target, pose, self.done)
            )
        if bool(self.poses.known.any()):
            known = self._known_loss(max(1, batch // _KNOWN_SHARE), warm)
            loss, logged["truth"] = loss + _KNOWN_WEIGHT * known, known.detach()
        return loss, logged

    def _maybe_mirrored(self, masks: Tensor, pose: ObjectPose) -> tuple[Tensor, ObjectPose]:
        if not self.mirrors:
            return masks, pose
        flip = torch.rand(len(masks), device=masks.device) < 0.5
        masks = torch.where(flip[:, None, None], masks.flip(-1), masks)
        return masks, ObjectPose.where(flip, pose.mirrored, pose)

    def _coded(self, features: Tensor, pose: ObjectPose) -> tuple[Float[Tensor, "batch code"], Float[Tensor, ""]]:
        """Return samples of the codes of masks, and the divergence of their distribution from the prior."""
        mean, log_variance = self.lifter.encode(features, pose)
        code = mean + torch.randn_like(mean) * (log_variance / 2).exp()
        return code, 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(1).mean()

    def _heads_loss(self, features: Tensor, pose: ObjectPose) -> Float[Tensor, ""]:
        """Return how far the heads are from saying the poses as they are."""
        space = self.lifter
        cosine = (pose.view.flatten(1) @ space.view_matrices.flatten(1).T - 1) / 2
        wanted = ((cosine - 1) / (_BIN * space.view_spacing) ** 2).softmax(1)
        views = -(wanted * space.view_logits(features).log_softmax(1)).sum(1).mean()
        start = space.usual_elevation(pose.elevation)
        place = space.placed(features, pose.azimuth, start, pose.roll)
        off = (place.elevation - pose.elevation).square() + (place.scale - pose.scale).square()
        return views + _PLACE_WEIGHT * (off + (place.offset - pose.offset).square().sum(1)).mean()

    def _turned(self, logits: Tensor, pose: ObjectPose) -> tuple[Float[Tensor, "batch side side"], ObjectPose]:
        """Return silhouettes from the poses of other masks, cut out as masks are; with gradient where priors judge them."""
        assert self.frames is not None
        rows = torch.randint(len(self.frames), (len(logits),), device=self.device)
        _, other = self._maybe_mirrored(logits.new_zeros(len(logits), 1, 1), self.poses.drawn(rows).detached())
        other = other._replace(scale=pose.scale, offset=torch.zeros_like(pose.offset))
        with torch.set_grad_enabled(bool(self.terms.priors)):
            seen = self.lifter.seen(logits, other, self.pixels)
            cut, half, middle = cut_out(interpolate(seen[:, None], (MASK_SIDE,) * 2, mode="bilinear")[:, 0])
        return cut, other._replace(scale=other.scale / half, offset=-middle / half[:, None])

    def _cycle_loss(
        self, code: Tensor, turned: Tensor, pose: ObjectPose
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """Return minus the log likelihood of codes as they are encoded from silhouettes of their shapes, and the heads' loss.

        The heads learn from views that are surely right, while some of those of real masks are not.
        """
        features = self.lifter.features(turned)
        mean, log_variance = self.lifter.encode(features, pose)
        log_variance = log_variance.clamp_min(-6)
        unlike = 0.5 * ((code - mean).square() / log_variance.exp() + log_variance).sum(1).mean()
        return unlike, self._heads_loss(features, pose)

    def _judged(self, loss: Tensor, logged: Logged, lift: ShapeLift) -> tuple[Tensor, Logged]:
        """Return the loss and its terms with those of the priors."""
        if not self.terms.priors:
            return loss, logged
        self.last_lift = lift
        judged, losses = self.terms.judge(lift, self.global_step)
        own, critic_losses = self.terms.train_adversaries(lift.masks, lift.reprojected.detach())
        # Weights are relative to the mean cross-entropy of a pixel.
        return loss + judged / _TEMPERATURE + own, {**logged, **losses, **critic_losses}

    def _known_loss(self, count: int, warm: float) -> Float[Tensor, ""]:
        """Return the cross-entropy of known shapes, encoded from their masks and from their silhouettes in other poses."""
        frames, space = self.frames, self.lifter
        assert frames is not None
        labelled = self.poses.known.nonzero()[:, 0]
        rows = labelled[torch.randint(len(labelled), (2 * count,), device=self.device)]
        truth = frames.shapes[frames.shape[rows]]
        masks, pose = frames.masks[rows].float() / 255, self.poses.drawn(rows)
        # Logits of a grid of coverage that are steep at its surface.
        turned, other = self._turned((truth - 0.42) * 12, pose.detached())
        half = torch.arange(len(rows), device=self.device) < count
        pose = ObjectPose.where(half, pose, other)
        features = space.features(torch.where(half[:, None, None], _smaller(masks, MASK_SIDE), turned.detach()))
        code, spread = self._coded(features, pose)
        grid = interpolate(truth[:, None], (self.grid,) * 3, mode="area")[:, 0]
        error = nn.functional.binary_cross_entropy_with_logits(space.logits(code), grid)
        return error / _KNOWN_TEMPERATURE + warm * spread


def _smaller(masks: Float[Tensor, "items side side"], side: int) -> Float[Tensor, "items new new"]:
    return interpolate(masks[:, None], (side, side), mode="area")[:, 0]


def cut_out(
    image: Float[Tensor, "items side side"],
) -> tuple[Float[Tensor, "items side side"], Float[Tensor, " items"], Float[Tensor, "items 2"]]:
    """Return silhouettes scaled and moved as masks are: the longer side of the box is `FILL` of the image, in its middle.

    Also half the side of what is cut out, and its middle, in half sides of the image.
    """
    side = image.shape[-1]
    at = (2 * torch.arange(side, device=image.device) + 1) / side - 1
    inside, low, high = image.detach() > 0.4, [], []
    for axis in (1, 2):
        covered = inside.any(axis)
        low.append(torch.where(covered, at, 9.0).amin(1))
        high.append(torch.where(covered, at, -9.0).amax(1))
    # From edge to edge of the outermost pixels.
    half = ((torch.maximum(high[0] - low[0], high[1] - low[1]) + 2 / side) / 2 / FILL).clamp(0.2, 1.3)
    middle = ((torch.stack(low, 1) + torch.stack(high, 1)) / 2).clamp(-0.6, 0.6)
    places = torch.cat([torch.diag_embed(half[:, None].expand(-1, 2)), middle[..., None]], 2)
    grid = nn.functional.affine_grid(places, [len(image), 1, side, side], align_corners=False)
    return nn.functional.grid_sample(image[:, None], grid, align_corners=False)[:, 0], half, middle
