"""Small fits of masks in all of their stages, complete or interrupted."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

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
from uplift.training.mixture import MixtureModule
from uplift.training.shape_recipe import ShapeRecipe
from uplift.training.shapes import ShapeModule

__all__ = ["SMALL", "STAGES", "fit_of", "interrupt", "loaded_small", "noted", "same", "trained"]

SMALL = (
    "data.simulate=60", "data.family=chairs", "data.side=32", "shape.coarse=8", "shape.detail=12", "shape.crop=12",
    "shape.pixels=12", "shape.code=4", "shape.hidden=16", "shape.parts=1", "shape.splits=2", "shape.rounds=2",
    "shape.refine=2", "shape.resolution=12", "shape.elevation_deg=20,1", "trainer.max_time=null", "trainer.max_steps=15",
    "trainer.log_every=1", "trainer.threads=1", "teacher.batch_size=8",
)  # fmt: skip
STAGES = ["views_1", "views_2", "coarse", "coarse_2", "fine"]


@lru_cache
def loaded_small() -> LoadedMasks:
    """Return the masks of `SMALL`, which take a while to simulate."""
    return load_masks(load_settings("masks_demo", SMALL))


def fit_of(folder: Path, *words: str, loaded: LoadedMasks | None = None) -> tuple[ShapeRecipe, ShapeModel]:
    """Return the recipe and the model of a small fit, without its evaluation and its pages."""
    settings = load_settings("masks_demo", last_words(*SMALL, *words))
    (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
    run = RunFolder(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recipe_module, "_MOST_FOR_THRESHOLD", 8)
        recipe = ShapeRecipe(
            settings, MaskDataModule.of(loaded or (load_masks(settings) if words else loaded_small()), settings)
        )
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


def _before_steps(patch: pytest.MonkeyPatch, do: Callable[[str, int], None]) -> None:
    """Call ``do`` with the name of the stage before every step of it, and the step's number."""

    def wrapped(kind: type[MixtureModule] | type[ShapeModule]) -> None:
        objective = kind.objective

        def with_call(module: Any, batch: int) -> tuple[Tensor, dict[str, float | Tensor]]:
            do(module.log_prefix, module.global_step)
            return objective(module, batch)

        patch.setattr(kind, "objective", with_call)

    wrapped(MixtureModule)
    wrapped(ShapeModule)


def noted(patch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Return a list that records every step: its stage, and its number in that."""
    taken: list[tuple[str, int]] = []
    _before_steps(patch, lambda stage, step: taken.append((stage, step)))
    return taken


def interrupt(folder: Path, stage: str, step: int, *words: str, loaded: LoadedMasks | None = None) -> None:
    """Fit, and press Ctrl-C in a step of a stage."""

    def pressing(*at: Any) -> None:
        if at == (stage, step):
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(Interrupted):
        _before_steps(patch, pressing)
        trained(folder, *words, loaded=loaded)
