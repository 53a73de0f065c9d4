"""`ShapeRecipe`, the stages of a fit of masks: a mixture of shapes, refined by splitting, and its iso threshold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate
from operator import mul

import numpy as np
import torch

from uplift.config.run import RunFolder
from uplift.config.settings import Settings, ShapeSettings
from uplift.data.load_masks import LoadedMasks
from uplift.data.mask_tensors import as_tensor, to_mask_set
from uplift.errors import UserError
from uplift.models.mixture import AZIMUTHS, ShapeMixture, split
from uplift.models.model import ShapeModel, load_shapes
from uplift.models.shape_lifter import choose_iso_threshold
from uplift.training.objective import prepare_priors
from uplift.training.shapes import MixtureTraining
from uplift.training.stages import Recipe

__all__ = ["ShapeRecipe"]

_MOST_FOR_THRESHOLD = 100
"""Masks that the iso threshold is chosen on."""
_LEAST_MASKS = 20
"""Masks per shape below which shapes are not split any more."""
_FIRST_SHARE = 0.25
"""Of the budget, for the first stage."""


class ShapeRecipe(Recipe):
    """A few shapes and the views of the masks (`shape.parts`), then stages that split every shape (`shape.splits`)."""

    def __init__(self, settings: Settings, loaded: LoadedMasks):
        super().__init__(settings, settings.priors, None)
        labelled, shape = loaded.train.labelled if settings.data.labelled.only else None, settings.shape
        self.train_data = loaded.train if labelled is None else loaded.train.select(labelled)
        self.data = to_mask_set(self.train_data, shape)
        torch.manual_seed(settings.seed)
        self.start = _start_from(settings.init, shape) if settings.init else None
        self.mixture = ShapeMixture(shape) if self.start is None else self.start
        parts = len(self.mixture.logits)
        self.splits = _worth_it(parts, shape.splits, len(self.data)) if self.start is None else []
        self.share_budget(_shares(self.splits), len(self.data))
        counts = list(accumulate([parts, *self.splits], mul))
        self.notes.append(
            f"a mixture of {', then '.join(map(str, counts))} shapes of {shape.detail}^3 voxels"
            + (", each its own mirror image" if shape.symmetric else "")
        )

    def train(self, run: RunFolder) -> ShapeModel:
        """Return the model after its stages."""
        prepare_priors(self.priors, self.data)
        mixture = self._stage(run, "shapes", self.mixture, hot=self.start is None)
        for number, times in enumerate(self.splits, 1):
            torch.manual_seed(self.settings.seed + number)
            mixture = self._stage(run, f"split_{number}", split(mixture, times, 2 * AZIMUTHS), hot=False)
        model, count = ShapeModel(mixture, self.settings.shape), len(self.train_data)
        masks = self.train_data.masks[np.linspace(0, count - 1, min(_MOST_FOR_THRESHOLD, count)).astype(int)]
        lifted = model.lift(masks, resolution=self.settings.shape.detail)
        mixture.level.fill_(choose_iso_threshold(lifted, as_tensor(masks)))
        return model

    def _stage(self, run: RunFolder, name: str, mixture: ShapeMixture, *, hot: bool) -> ShapeMixture:
        def build() -> MixtureTraining:
            mixture.silhouettes([0])  # makes the projector's matrices, which take a while
            terms = self.priors, self.weights
            return MixtureTraining(mixture, self.data, self.settings.teacher, *terms, self.settings.seed, hot)

        trained = self.stage(run, name, build).cpu().eval()
        trained.projector = mixture.projector
        return trained


def _worth_it(parts: int, splits: Sequence[int], masks: int) -> list[int]:
    """Return the first splits, those that leave every shape enough masks."""
    kept = []
    for times in splits:
        parts *= times
        if masks < _LEAST_MASKS * parts:
            break
        kept.append(times)
    return kept


def _shares(splits: Sequence[int]) -> dict[str, float]:
    """Return each stage's share of the budget: a quarter for the views, and more for many shapes than for few."""
    rest = [math.sqrt(count) for count in accumulate(splits, mul)]
    later = {f"split_{number}": (1 - _FIRST_SHARE) * each / sum(rest) for number, each in enumerate(rest, 1)}
    return {"shapes": _FIRST_SHARE if rest else 1.0, **later}


def _start_from(init: str, shape: ShapeSettings) -> ShapeMixture:
    """Return another run's mixture, for the settings of this run."""
    other = load_shapes(init)
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
