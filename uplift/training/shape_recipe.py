"""`ShapeRecipe`, the stages of a fit of masks: views by a mixture of shapes, then a space of shapes, coarse and fine."""

from __future__ import annotations

import dataclasses
import math
from itertools import accumulate
from operator import mul

import numpy as np
import torch
from jaxtyping import Float
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from torch import Tensor

from uplift.config.progress import say
from uplift.config.run import RunFolder
from uplift.config.settings import Settings, ShapeSettings
from uplift.data.module import MaskDataModule
from uplift.data.views import KnownViews, write_views
from uplift.errors import UserError
from uplift.models.front import front_of_views
from uplift.models.model import ShapeModel, load_shapes
from uplift.models.prediction import view_angles_deg
from uplift.models.shape_lifter import choose_iso_threshold
from uplift.models.shape_space import ShapeSpace
from uplift.models.silhouettes import angles_of, view_of
from uplift.training.base import plain_settings
from uplift.training.mixture import MixtureModule
from uplift.training.shapes import MaskPoses, ShapeModule
from uplift.training.stages import Recipe, module_class

__all__ = ["ShapeRecipe"]

_MOST_FOR_THRESHOLD = 100
"""Masks that the iso threshold is chosen on."""
_LEAST_MASKS = 20
"""Masks per shape of the mixture below which its shapes are not split any more."""
_OF_VIEWS = {"learning_rate": 0.05, "decay_from": 0.7, "warm_up": 0.0}
"""Of the mixture: its grids are no networks, which ``teacher.learning_rate`` is for."""
_VIEW_MASKS = 512
"""Masks that priors see in a step of the mixture."""


class ShapeRecipe(Recipe):
    """Views are found by one shape that is split (`shape.parts`, `shape.splits`); then shapes are learned.

    The space is coarse at first, and the views of all masks are looked for again with it `shape.rounds` times; the last
    stage is at ``shape.detail``. With ``init`` a trained space finds the views, and only the last stages are trained.
    """

    def __init__(self, settings: Settings, data: MaskDataModule):
        super().__init__(settings)
        self.data, shape = data, settings.shape
        self.known = _known_views(settings, data)
        self.start = _start_from(settings.init, shape) if settings.init else None
        count = len(data.masks)
        self.splits = _worth_it(shape, count) if self.start is None else []
        self.share_budget(self._shares(), count)
        given = {"shape": dataclasses.asdict(shape), **plain_settings(settings.teacher)}
        self.views = MixtureModule(parts=shape.parts, seed=settings.seed, **{**given, **_OF_VIEWS})
        build = module_class(settings.module, "module", ShapeModule)
        self.module = build(
            self.start or self.views,
            priors=settings.priors,
            detail=shape.coarse if self.start is None else shape.detail,
            first=self.start is None,
            seed=settings.seed,
            **given,
        )
        self.training_views: np.ndarray | None = None
        """Rotations (items 3 3) of the training masks' shapes to their cameras, once they are found."""
        self.notes += [*self.module.notes, *self._described(shape)]

    def _shares(self) -> dict[str, float]:
        """Return each stage's share of the budget: of steps, or of time where that is what ends the fit."""
        timed = self.settings.trainer.max_time is not None
        views = {f"views_{number}": _VIEWS[timed] for number in range(1, len(self.splits) + 2)}
        first = {} if self.start else {**views, "coarse": _COARSE[timed]}
        rounds = {f"coarse_{number}": _ROUND[timed] for number in range(2, self.settings.shape.rounds + 1)}
        return {**first, **({} if self.start else rounds), "fine": _FINE[timed]}

    def _described(self, shape: ShapeSettings) -> list[str]:
        mirrored = ", each its own mirror image" if shape.symmetric else ""
        counts = ", then ".join(map(str, accumulate([shape.parts, *self.splits], mul)))
        found = f"views are found with {counts} shapes of {shape.coarse}^3 voxels"
        return [
            f"the views are those that {self.settings.init} finds" if self.start else found,
            f"a space of shapes with codes of {shape.code} numbers, on grids of {shape.detail}^3 voxels{mirrored}",
        ]

    def train(self, run: RunFolder) -> ShapeModel:
        """Return the model after its stages."""
        settings, module = self.settings, self.module
        if self.start is None:
            self._find_views(run)
            coarse = [name for name in self.budgets if name.startswith("coarse")]
            for number, name in enumerate(coarse):
                if number:
                    module = module.go_on(seed=settings.seed + number, decay_from=1.0)
                self.stage(run, name, module, self.data, settings.teacher.batch_size)
            last = settings.teacher.decay_from
            module = module.go_on(settings.shape.detail, seed=settings.seed + len(coarse), decay_from=last)
        self.stage(run, "fine", module, self.data, settings.teacher.batch_size)
        model, count = module.model(), len(self.data.masks)
        masks = self.data.masks.masks[np.linspace(0, count - 1, min(_MOST_FOR_THRESHOLD, count)).astype(int)]
        model.lifter.level.fill_(choose_iso_threshold(model.lift(masks).occupancy))
        if self.known is not None:
            self._face(model, module.poses.best.view.cpu())
        front = model.lifter.front.cpu()
        self.training_views = (module.poses.best.view.cpu() @ front.mT).double().numpy()
        if rank_zero_only.rank == 0:
            write_views(run.path / VIEWS, self.data.masks.names, _view_columns(module.poses, front))
        return model

    def _face(self, model: ShapeModel, found: Float[Tensor, "items 3 3"]) -> None:
        """Name the front of shapes by the known views of some masks, and say how many of these agree."""
        assert self.known is not None
        found, settings = found[self.known.rows], model.settings
        given = torch.from_numpy(self.known.angles_deg).float().deg2rad()
        own = torch.stack(angles_of(found), 1)
        angles = torch.cat([given[:, :1], own[:, 1:]], 1) if settings.gravity else given
        known = view_of(*angles.unbind(1))
        front = front_of_views(found, known, settings)
        cosine = (((found @ front.mT) * known).sum((1, 2)) - 1) / 2
        agree, count = int((cosine > math.cos(_AGREES)).sum()), len(found)
        say(f"front: {agree} of {count} known views agree within {math.degrees(_AGREES):.0f} degrees")
        model.lifter.front.copy_(front.to(model.lifter.front))

    def _find_views(self, run: RunFolder) -> None:
        """Train the mixture, which the first space then starts from."""
        views = self.views
        self.stage(run, "views_1", views, self.data, _VIEW_MASKS)
        for number, times in enumerate(self.splits, 1):
            views = views.split(times, seed=self.settings.seed + number)
            self.stage(run, f"views_{number + 1}", views, self.data, _VIEW_MASKS)
        self.module.starts_from(views)


VIEWS = "views.csv"
"""In a run: the views of its training masks."""
_AGREES = math.radians(30)


def _known_views(settings: Settings, data: MaskDataModule) -> KnownViews | None:
    """Return the views that ``shape.views`` has; raises UserError where labelled masks name the front already."""
    if settings.shape.views is None:
        return None
    if data.masks.labelled is not None and data.masks.labelled.any():
        raise UserError("shape.views: labelled masks say already which side is the front, that of their true shapes.")
    return KnownViews.read(settings.shape.views, data.masks.names, all_angles=not settings.shape.gravity)


def _view_columns(poses: MaskPoses, front: Float[Tensor, "3 3"]) -> dict[str, np.ndarray]:
    """Return the views of training masks, in degrees, with the probability of each and the second likeliest."""
    order = poses.weight.argsort(1, descending=True)
    columns: dict[str, np.ndarray] = {}
    for rank, prefix in enumerate(("", "second_")):
        pose = poses.ranked(order[:, rank])
        angles = view_angles_deg((pose.view.cpu() @ front.mT).numpy())
        names = (f"{prefix}{name}_deg" for name in ("azimuth", "elevation", "roll"))
        columns |= dict(zip(names, angles, strict=True))
        columns[f"{prefix}probability"] = poses.weight.gather(1, order[:, rank, None])[:, 0].cpu().numpy()
    return columns


_VIEWS, _COARSE, _ROUND, _FINE = (3.0, 0.5), (5.0, 2.0), (1.6, 2.0), (4.0, 5.0)
"""Shares of stages, of steps and of time: a step at a fine grid takes twenty times as long as one of the mixture."""


def _worth_it(shape: ShapeSettings, masks: int) -> list[int]:
    """Return the first splits, those that leave every shape of the mixture enough masks."""
    parts, kept = shape.parts, []
    for times in shape.splits:
        parts *= times
        if masks < _LEAST_MASKS * parts:
            break
        kept.append(times)
    return kept


def _start_from(init: str, shape: ShapeSettings) -> ShapeSpace:
    """Return another run's space, for the settings of this run; raises UserError where it has another form."""
    other = load_shapes(init)
    for name in ("symmetric", "gravity", "code", "hidden", "detail"):
        theirs, ours = getattr(other.settings, name), getattr(shape, name)
        if theirs != ours:
            raise UserError(f"init={init} has shape.{name}={theirs}, this run {ours}: they must be the same.")
    return other.lifter
