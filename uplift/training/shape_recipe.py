"""`ShapeRecipe`, the stages of a fit of masks: views by a mixture of shapes, then a space of shapes, coarse and fine."""

from __future__ import annotations

import dataclasses
from itertools import accumulate
from operator import mul

import numpy as np

from uplift.config.run import RunFolder
from uplift.config.settings import Settings, ShapeSettings
from uplift.data.module import MaskDataModule
from uplift.errors import UserError
from uplift.models.model import ShapeModel, load_shapes
from uplift.models.shape_lifter import choose_iso_threshold
from uplift.models.shape_space import ShapeSpace
from uplift.training.base import plain_settings
from uplift.training.mixture import MixtureModule
from uplift.training.shapes import ShapeModule
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
        self.training_views = module.poses.best.view.double().cpu().numpy()
        model, count = module.model(), len(self.data.masks)
        masks = self.data.masks.masks[np.linspace(0, count - 1, min(_MOST_FOR_THRESHOLD, count)).astype(int)]
        model.lifter.level.fill_(choose_iso_threshold(model.lift(masks).occupancy))
        return model

    def _find_views(self, run: RunFolder) -> None:
        """Train the mixture, which the first space then starts from."""
        views = self.views
        self.stage(run, "views_1", views, self.data, _VIEW_MASKS)
        for number, times in enumerate(self.splits, 1):
            views = views.split(times, seed=self.settings.seed + number)
            self.stage(run, f"views_{number + 1}", views, self.data, _VIEW_MASKS)
        self.module.starts_from(views)


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
