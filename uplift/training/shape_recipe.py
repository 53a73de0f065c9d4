"""`ShapeRecipe`, the stages of a fit of masks: a mixture of shapes, refined by splitting, and its iso threshold."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from itertools import accumulate
from operator import mul

import numpy as np

from uplift.config.run import RunFolder
from uplift.config.settings import Settings, ShapeSettings
from uplift.data.mask_tensors import as_tensor
from uplift.data.module import MaskDataModule
from uplift.errors import UserError
from uplift.models.mixture import AZIMUTHS, ShapeMixture
from uplift.models.model import ShapeModel, load_shapes
from uplift.models.shape_lifter import choose_iso_threshold
from uplift.training.base import plain_settings
from uplift.training.shapes import ShapeModule
from uplift.training.stages import Recipe, module_class

__all__ = ["ShapeRecipe"]

_MOST_FOR_THRESHOLD = 100
"""Masks that the iso threshold is chosen on."""
_LEAST_MASKS = 20
"""Masks per shape below which shapes are not split any more."""
_FIRST_SHARE = 0.25
"""Of the budget, for the first stage."""


class ShapeRecipe(Recipe):
    """A few shapes and the views of the masks (`shape.parts`), then stages that split every shape (`shape.splits`)."""

    def __init__(self, settings: Settings, data: MaskDataModule):
        super().__init__(settings)
        self.data, shape = data, settings.shape
        count = len(data.mask_set(shape))
        start = _start_from(settings.init, shape) if settings.init else None
        parts, azimuths = (shape.parts, AZIMUTHS) if start is None else start.azimuth_bias.shape
        build = module_class(settings.module, "module", ShapeModule)
        self.module = build(
            shape=dataclasses.asdict(shape),
            priors=settings.priors,
            parts=parts,
            azimuths=azimuths,
            hot=start is None,
            seed=settings.seed,
            **plain_settings(settings.teacher),
        )
        if start is not None:
            self.module.start_from(start)
        self.splits = _worth_it(parts, shape.splits, count) if start is None else []
        self.share_budget(_shares(self.splits), count)
        counts = list(accumulate([parts, *self.splits], mul))
        self.notes += [
            *self.module.notes,
            f"a mixture of {', then '.join(map(str, counts))} shapes of {shape.detail}^3 voxels"
            + (", each its own mirror image" if shape.symmetric else ""),
        ]

    def train(self, run: RunFolder) -> ShapeModel:
        """Return the model after its stages."""
        settings, module = self.settings, self.module
        self.stage(run, "shapes", module, self.data, settings.teacher.batch_size)
        for number, times in enumerate(self.splits, 1):
            module = module.split(times, seed=settings.seed + number)
            self.stage(run, f"split_{number}", module, self.data, settings.teacher.batch_size)
        mixture = module.final.cpu().eval()
        mixture.projector = module.lifter.projector
        model, count = ShapeModel(mixture, settings.shape), len(self.data.masks)
        masks = self.data.masks.masks[np.linspace(0, count - 1, min(_MOST_FOR_THRESHOLD, count)).astype(int)]
        lifted = model.lift(masks, resolution=settings.shape.detail)
        mixture.level.fill_(choose_iso_threshold(lifted, as_tensor(masks)))
        return model


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
