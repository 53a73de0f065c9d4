"""Small fits of masks, of one stage and of three, complete or interrupted."""

from __future__ import annotations

import os
import signal
from functools import lru_cache
from pathlib import Path

import pytest
import torch
from bodies import last_words
from torch import Tensor

from uplift.config.loading import load_settings
from uplift.config.run import RunFolder
from uplift.data.load_masks import LoadedMasks, load_masks
from uplift.data.module import MaskDataModule
from uplift.models.model import ShapeModel
from uplift.training import shape_recipe as recipe_module
from uplift.training.callbacks import Interrupted
from uplift.training.shape_recipe import ShapeRecipe
from uplift.training.shapes import ShapeModule

__all__ = ["SMALL", "STAGES", "fit_of", "interrupt", "many", "noted", "same", "trained"]

SMALL = (
    "data.simulate=60", "data.family=chairs", "data.side=32", "shape.detail=12", "shape.crop=16", "shape.parts=2",
    "shape.splits=", "shape.resolution=12", "shape.elevation_deg=20,1", "trainer.max_time=null", "trainer.max_steps=10",
    "trainer.log_every=2", "trainer.threads=1", "teacher.batch_size=16",
)  # fmt: skip
STAGES = ("data.simulate=130", "shape.parts=1", "shape.splits=2,2", "trainer.max_steps=24")
"""Added to `SMALL`: three stages, of 1, 2 and 4 shapes."""


@lru_cache
def many() -> LoadedMasks:
    """Return the masks of `STAGES`, which take a while to simulate."""
    return load_masks(load_settings("masks_demo", last_words(*SMALL, *STAGES)))


def fit_of(folder: Path, *words: str, loaded: LoadedMasks | None = None) -> tuple[ShapeRecipe, ShapeModel]:
    """Return the recipe and the model of a small fit, without its evaluation and its pages."""
    settings = load_settings("masks_demo", last_words(*SMALL, *words))
    (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
    run = RunFolder(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recipe_module, "_MOST_FOR_THRESHOLD", 8)
        recipe = ShapeRecipe(settings, MaskDataModule.of(loaded or load_masks(settings), settings))
        model = recipe.train(run)
    assert all(seconds > 0 for seconds in recipe.spent.values())
    return recipe, model


def trained(folder: Path, *words: str, loaded: LoadedMasks | None = None) -> ShapeModel:
    """Return only the model."""
    return fit_of(folder, *words, loaded=loaded)[1]


def same(one: ShapeModel, other: ShapeModel) -> bool:
    """Return whether all weights are bit-identical."""
    first, second = one.lifter.state_dict(), other.lifter.state_dict()
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def noted(patch: pytest.MonkeyPatch) -> list[tuple[int, int, float]]:
    """Return a list that records every step: number of shapes, step of the stage, temperature."""
    taken: list[tuple[int, int, float]] = []
    objective = ShapeModule.objective

    def noting(module: ShapeModule, batch: int) -> tuple[Tensor, dict[str, float | Tensor]]:
        taken.append((len(module.lifter.logits), module.global_step, module.temperature))
        return objective(module, batch)

    patch.setattr(ShapeModule, "objective", noting)
    return taken


def interrupt(folder: Path, shapes: int, step: int, *words: str, loaded: LoadedMasks | None = None) -> None:
    """Fit, and press Ctrl-C in a step of the stage with so many shapes."""
    objective = ShapeModule.objective

    def pressing(module: ShapeModule, batch: int) -> tuple[Tensor, dict[str, float | Tensor]]:
        if (len(module.lifter.logits), module.global_step) == (shapes, step):
            os.kill(os.getpid(), signal.SIGINT)
        return objective(module, batch)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(Interrupted):
        patch.setattr(ShapeModule, "objective", pressing)
        trained(folder, *words, loaded=loaded)
