"""The one stage of a fit of masks: a mixture of shapes, and the level of its surfaces."""

from __future__ import annotations

import time

import numpy as np
import torch

from uplift.config import Settings
from uplift.errors import UserError
from uplift.masks.load import LoadedMasks
from uplift.model import load
from uplift.priors.of_shapes import build_shape_priors
from uplift.run import RunFolder
from uplift.shapes.level import choose_level
from uplift.shapes.mask_set import as_tensor, mask_set
from uplift.shapes.mixture import ShapeMixture
from uplift.shapes.model import ShapeModel
from uplift.shapes.training import MixtureTraining
from uplift.training.stages import run_stage, stage_budgets

__all__ = ["ShapeRecipe"]

_MOST_FOR_LEVEL = 100


class ShapeRecipe:
    """Builds and trains the lifter of masks that ``settings`` say, from what training may see of the masks."""

    def __init__(self, settings: Settings, loaded: LoadedMasks, run: RunFolder | None):
        self.settings = settings
        labelled = loaded.train.labelled
        only = settings.data.labelled.only and labelled is not None
        self.train_data = loaded.train.select(labelled) if only else loaded.train
        self.data = mask_set(self.train_data, settings.shape)
        self.priors, self.weights = build_shape_priors(settings.priors)
        self.spent: dict[str, float] = {}
        self.budget = stage_budgets(settings.trainer, [1.0], len(self.data), settings.teacher.batch_size)[0]
        shape = settings.shape
        self.notes = [
            f"a mixture of {shape.parts} shapes of {shape.detail}^3 voxels"
            + (", each its own mirror image" if shape.symmetric else ""),
        ]
        torch.manual_seed(settings.seed)
        self.mixture = ShapeMixture(shape)
        if settings.init:
            _start_from(self.mixture, settings.init)

    def train(self, run: RunFolder) -> ShapeModel:
        """Return the model after its stage."""
        start = time.monotonic()
        self.mixture.crops()  # makes the matrix of views
        training = MixtureTraining(
            self.mixture, self.data, self.settings.teacher, self.priors, self.weights, self.settings.seed
        )
        before = time.monotonic() - start
        clock = run_stage("shapes", training, self.settings.trainer, self.budget, run.path, before)
        self.spent["shapes"] = clock.spent
        mixture: ShapeMixture = training.final.cpu().eval()
        mixture.projector = self.mixture.projector
        model = ShapeModel(mixture, self.settings.shape)
        rows = np.linspace(0, len(self.train_data) - 1, min(_MOST_FOR_LEVEL, len(self.train_data))).astype(int)
        lifted = model.lift(self.train_data.masks[rows], resolution=self.settings.shape.detail)
        mixture.level.fill_(choose_level(lifted, as_tensor(self.train_data.masks[rows])))
        return model


def _start_from(mixture: ShapeMixture, init: str) -> None:
    other = load(init)
    if not isinstance(other, ShapeModel):
        raise UserError(f"init={init} lifts keypoints, this task masks.")
    for name in ("logits", "azimuth_bias"):
        theirs, ours = (tuple(getattr(lifter, name).shape) for lifter in (other.lifter, mixture))
        if theirs != ours:
            raise UserError(
                f"init={init} has {name} {theirs}, this run {ours}: shape.parts, shape.detail, shape.symmetric and "
                "shape.gravity must be those of that run."
            )
    mixture.load_state_dict(other.lifter.state_dict(), strict=False)
