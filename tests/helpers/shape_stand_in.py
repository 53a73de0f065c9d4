"""A stand-in for the lifter of masks, without training: each shape is the mask extruded along its rays."""

from __future__ import annotations

import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
import pytest

from uplift.cli import evaluate
from uplift.config.files import save_torch
from uplift.config.run import RunFolder, Weights
from uplift.config.settings import Settings, ShapeSettings
from uplift.data.masks import MaskData
from uplift.data.module import MaskDataModule
from uplift.metrics import baselines
from uplift.metrics import shape_metrics as shape_item
from uplift.metrics.baselines import score_with_baselines, shape_baselines
from uplift.metrics.shape_metrics import grid_surface, mesh_surface
from uplift.models import model as model_module
from uplift.models.front import front_at
from uplift.models.prediction import ShapePrediction
from uplift.models.shape_space import ShapeSpace

__all__ = ["StandInModel", "stand_in", "thick_shapes"]

_R = 16


class StandInModel(model_module.ShapeModel):
    """Saved and loaded like the real one; its only weight is the thickness of the shapes."""

    grouped: ClassVar[list[Any]] = []
    """What each call had for its groups."""

    def facing(self, degrees: int | float) -> StandInModel:
        """Refuse what the real one does."""
        front_at(degrees, self.settings)
        return self

    def predict(self, data: MaskData, title: str = "", refine: int | None = None, group: Any = None) -> ShapePrediction:
        """Return every mask extruded."""
        assert data.truth is None
        self.grouped.append(group)
        depth = np.abs((2 * np.arange(_R) + 1) / _R - 1) < float(self.lifter.level)
        small = data.masks.reshape(len(data), _R, data.side // _R, _R, data.side // _R).mean((2, 4)) / 255
        return ShapePrediction(
            (small[:, None] * depth[:, None, None]).astype(np.float32), np.repeat(np.eye(3)[None], len(data), 0),
            np.ones(len(data)), np.zeros((len(data), 2)), np.full(len(data), 6.0), data.masks, list(data.names),
            data.centre_px, data.scale_px, title=title, images=data.images,
        )  # fmt: skip

    def save(self, path: Path) -> None:
        """Write one file."""
        save_torch({"lifts": "masks", "thick": self.lifter.level, "settings": asdict(self.settings)}, path)

    @classmethod
    def from_weights(cls, weights: Weights) -> StandInModel:
        """Read it."""
        state = weights.state
        return cls(thick_shapes(float(state["thick"])), ShapeSettings(**state["settings"]))


def thick_shapes(thick: float) -> ShapeSpace:
    """Return a space that stores only the thickness of shapes."""
    space = ShapeSpace(ShapeSettings(detail=4, code=1, hidden=1))
    space.level.fill_(thick)
    return space


def stand_in(patch: pytest.MonkeyPatch, stop: bool = False) -> list[MaskDataModule]:
    """Replace the lifter, its training and the baselines by quick ones; return the data of each training.

    ``stop``: simulate Ctrl-C once there is a checkpoint.
    """
    given: list[MaskDataModule] = []

    class ShapeRecipe:
        """Trains by guessing."""

        def __init__(self, settings: Settings, data: MaskDataModule):
            self.settings, self.notes, self.spent = settings, ["a stand-in"], {"guess": 0.5}
            self.steps, self.idle_priors, self.training_views = {"guess": 2}, {}, None
            given.append(data)

        def train(self, run: RunFolder) -> Any:
            (run.checkpoints / "guess.ckpt").write_bytes(b"guessed")
            (run.path / "metrics.csv").write_text("stage,step,name,value\nguess,1,loss,0.5\nguess,2,loss,0.25\n")
            if stop and len(given) == 1:
                run.link_last()
                raise KeyboardInterrupt
            return StandInModel(thick_shapes(0.4), self.settings.shape)

    module = ModuleType("uplift.training.shape_recipe")
    module.ShapeRecipe = ShapeRecipe  # type: ignore[attr-defined]
    patch.setitem(sys.modules, "uplift.training.shape_recipe", module)
    patch.setattr(model_module, "ShapeModel", StandInModel)
    patch.setattr(baselines, "shape_baselines", partial(shape_baselines, resolution=12, sample=6))
    for sampled in (mesh_surface, grid_surface):
        patch.setattr(shape_item, sampled.__name__, partial(sampled, points=400))
    patch.setattr(evaluate, "score_with_baselines", partial(score_with_baselines, resolution=16))
    return given
