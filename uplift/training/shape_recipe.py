"""The stages of a fit of masks: a mixture of shapes, made finer, and the level of its surfaces."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from itertools import accumulate
from operator import mul

import numpy as np
import torch

from uplift.config.run import RunFolder
from uplift.config.settings import Settings, ShapeSettings
from uplift.data.load_masks import LoadedMasks
from uplift.data.tensors import as_tensor, mask_set
from uplift.errors import UserError
from uplift.models.mixture import AZIMUTHS, ShapeMixture, split
from uplift.models.model import ShapeModel, load
from uplift.models.shape_lifter import choose_level
from uplift.priors import build_priors
from uplift.training.objective import prepare_priors
from uplift.training.recipe import StageBudget, run_stage, stage_budgets
from uplift.training.shapes import MixtureTraining

__all__ = ["ShapeRecipe"]

_MOST_FOR_LEVEL = 100
_LEAST_MASKS = 20
"""Fewer for each shape, and shapes are not split any more."""
_FIRST_SHARE = 0.25


class ShapeRecipe:
    """Builds and trains the lifter of masks that ``settings`` say, from what training may see of the masks.

    The first stage finds a few shapes and the views of the masks (`shape.parts`), each later one splits
    every shape into several (`shape.splits`) and goes on.
    """

    def __init__(self, settings: Settings, loaded: LoadedMasks):
        self.settings = settings
        labelled = loaded.train.labelled if settings.data.labelled.only else None
        self.train_data = loaded.train if labelled is None else loaded.train.select(labelled)
        self.data = mask_set(self.train_data, settings.shape)
        self.priors, self.weights, _ = build_priors(settings.priors)
        self.spent: dict[str, float] = {}
        shape = settings.shape
        torch.manual_seed(settings.seed)
        self.start = _start_from(settings.init, shape) if settings.init else None
        first = ShapeMixture(shape) if self.start is None else self.start
        self.mixture = first
        self.splits = _worth_it(len(first.logits), shape.splits, len(self.data)) if self.start is None else []
        shares = _shares(self.splits)
        self.budgets = stage_budgets(settings.trainer, shares, len(self.data), settings.teacher.batch_size)
        counts = list(accumulate([len(first.logits), *self.splits], mul))
        self.notes = [
            f"a mixture of {', then '.join(map(str, counts))} shapes of {shape.detail}^3 voxels"
            + (", each its own mirror image" if shape.symmetric else ""),
        ]

    def train(self, run: RunFolder) -> ShapeModel:
        """Return the model after its stages."""
        prepare_priors(self.priors, self.data)
        mixture = self._stage(run, "shapes", self.mixture, self.budgets[0], hot=self.start is None)
        for number, times in enumerate(self.splits, 1):
            torch.manual_seed(self.settings.seed + number)
            mixture = split(mixture, times, 2 * AZIMUTHS)
            mixture = self._stage(run, f"split_{number}", mixture, self.budgets[number], hot=False)
        model = ShapeModel(mixture, self.settings.shape)
        rows = np.linspace(0, len(self.train_data) - 1, min(_MOST_FOR_LEVEL, len(self.train_data))).astype(int)
        lifted = model.lift(self.train_data.masks[rows], resolution=self.settings.shape.detail)
        mixture.level.fill_(choose_level(lifted, as_tensor(self.train_data.masks[rows])))
        return model

    def _stage(self, run: RunFolder, name: str, mixture: ShapeMixture, budget: StageBudget, *, hot: bool):
        start = time.monotonic()
        mixture.silhouettes([0])  # makes the matrices of the views
        training = MixtureTraining(
            mixture, self.data, self.settings.teacher, self.priors, self.weights, self.settings.seed, hot
        )
        before = time.monotonic() - start
        clock = run_stage(name, training, self.settings.trainer, budget, run.path, before)
        self.spent[name] = clock.spent
        projector = mixture.projector
        found: ShapeMixture = training.final.cpu().eval()
        found.projector = projector
        return found


def _worth_it(parts: int, splits: Sequence[int], masks: int) -> list[int]:
    """Return the splits that leave every shape some masks."""
    kept = []
    for times in splits:
        parts *= times
        if masks < _LEAST_MASKS * parts:
            break
        kept.append(times)
    return kept


def _shares(splits: Sequence[int]) -> list[float]:
    """Return each stage's share of the budget: a quarter finds the views, and many shapes take longer than few."""
    rest = [math.sqrt(count) for count in accumulate(splits, mul)]
    return [_FIRST_SHARE if rest else 1.0, *((1 - _FIRST_SHARE) * each / sum(rest) for each in rest)]


def _start_from(init: str, shape: ShapeSettings) -> ShapeMixture:
    other = load(init)
    if not isinstance(other, ShapeModel):
        raise UserError(f"init={init} lifts keypoints, this task masks.")
    parts, azimuths = other.lifter.azimuth_bias.shape
    mixture = ShapeMixture(shape, parts, azimuths)
    for name in ("logits", "azimuth_bias"):
        theirs, ours = (tuple(getattr(lifter, name).shape) for lifter in (other.lifter, mixture))
        if theirs != ours:
            raise UserError(
                f"init={init} has {name} {theirs}, this run {ours}: shape.detail, shape.symmetric and "
                "shape.gravity must be those of that run."
            )
    mixture.load_state_dict(other.lifter.state_dict())
    return mixture
