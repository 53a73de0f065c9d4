"""A fit that is told the views of a few masks: its shapes face the way these say."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uplift.config.loading import load_settings
from uplift.config.run import RunFolder
from uplift.data.load_masks import load_masks
from uplift.data.module import MaskDataModule
from uplift.errors import UserError
from uplift.training.shape_recipe import VIEWS, ShapeRecipe

SMALL = (
    "data.simulate=24", "data.family=chairs", "data.side=32", "shape.detail=8", "shape.coarse=8", "shape.crop=12",
    "shape.splits=", "shape.resolution=8", "shape.code=4", "shape.hidden=8", "shape.pixels=8", "shape.rounds=1",
    "shape.refine=1", "trainer.max_time=null", "trainer.max_steps=6", "trainer.threads=1", "teacher.batch_size=8",
)  # fmt: skip


def fitted(folder: Path, *words: str) -> tuple[ShapeRecipe, list[dict[str, str]]]:
    """Return the recipe of a fit, and the table of views that it wrote."""
    (folder / "checkpoints").mkdir(parents=True)
    settings = load_settings("masks_demo", [*SMALL, *words])
    recipe = ShapeRecipe(settings, MaskDataModule.of(load_masks(settings), settings))
    recipe.train(RunFolder(folder))
    with (folder / VIEWS).open(newline="") as file:
        return recipe, list(csv.DictReader(file))


def test_known_views_turn_the_frame_of_a_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recipe, before = fitted(tmp_path / "before")
    assert [row["name"] for row in before] == list(recipe.data.masks.names)
    assert all(0 < float(row["probability"]) <= 1 for row in before)
    known = [(row["name"], (float(row["azimuth_deg"]) + 190) % 360) for row in before[3:8]]
    (tmp_path / "known.csv").write_text("name,azimuth_deg\n" + "".join(f"{name},{turn}\n" for name, turn in known))
    capsys.readouterr()
    _, after = fitted(tmp_path / "after", f"shape.views={tmp_path / 'known.csv'}")
    assert "front: 5 of 5 known views agree within 30 degrees" in "".join(capsys.readouterr())
    turned = [float(b["azimuth_deg"]) - float(a["azimuth_deg"]) for a, b in zip(before, after, strict=True)]
    np.testing.assert_allclose(np.mod(turned, 360), 180, atol=1e-2)
    assert [row["elevation_deg"] for row in before] == [row["elevation_deg"] for row in after]


def test_known_views_beside_labelled_masks(tmp_path: Path) -> None:
    settings = load_settings("masks_demo", [*SMALL, "data.labelled.fraction=0.5"])
    settings = replace(settings, shape=replace(settings.shape, views="known.csv"))
    with pytest.raises(UserError, match="labelled masks say already which side is the front"):
        ShapeRecipe(settings, MaskDataModule.of(load_masks(settings), settings))
