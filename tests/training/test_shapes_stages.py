"""Fits of masks in their stages: views, a coarse space, a fine one; resumed in any of them, and gone on with elsewhere."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from bodies import last_words
from shape_fits import SMALL, STAGES, fit_of, interrupt, loaded_small, noted, same, trained

import uplift
from uplift.config.loading import load_settings
from uplift.data.load_masks import load_masks
from uplift.data.module import MaskDataModule
from uplift.errors import UserError
from uplift.models.model import ShapeModel
from uplift.training import shape_recipe as recipe_module
from uplift.training.shape_recipe import ShapeRecipe


@pytest.fixture(scope="module")
def staged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ShapeRecipe, ShapeModel]:
    """Return the folder, the recipe and the model of an unbroken fit."""
    folder = tmp_path_factory.mktemp("staged") / "run"
    recipe, model = fit_of(folder)
    model.save(folder / "lifter.pt")
    return folder, recipe, model


def steps_of(recipe: ShapeRecipe) -> dict[str, int]:
    """Return how many steps each stage has."""
    return {name: budget.steps or 0 for name, budget in recipe.budgets.items()}


def test_views_are_found_and_then_a_space_is_learned(staged: tuple[Path, ShapeRecipe, ShapeModel]) -> None:
    folder, recipe, model = staged
    assert list(recipe.spent) == STAGES
    assert sorted(path.stem for path in folder.glob("checkpoints/*")) == sorted(STAGES)
    assert {line.split(",")[0] for line in (folder / "metrics.csv").read_text().splitlines()[1:]} == set(STAGES)
    assert "views are found with 1, then 2 shapes of 8^3 voxels" in recipe.notes
    assert any(
        "codes of 4 numbers, on grids of 12^3 voxels, each its own mirror image" in note for note in recipe.notes
    )
    assert sum(steps_of(recipe).values()) == 15
    assert model.lifter.detail == 12
    kept = {name: torch.load(folder / f"checkpoints/{name}.ckpt", weights_only=True)["state_dict"] for name in STAGES}
    sizes = [len(kept[name]["lifter.logits"]) for name in ("views_1", "views_2")]
    assert sizes == [1, 2]
    voxels = [len(kept[name]["lifter.last.bias"]) for name in ("coarse", "coarse_2", "fine")]
    assert voxels == [8**3 // 2, 8**3 // 2, 12**3 // 2]
    assert recipe.training_views is not None
    assert recipe.training_views.shape == (60, 3, 3)
    again = uplift.load(folder / "lifter.pt")
    assert isinstance(again, ShapeModel)
    assert same(again, model)


@pytest.mark.parametrize(
    ("masks", "splits"), [(9, []), (10, [2]), (19, [2]), (20, [2, 2]), (59, [2, 2]), (60, [2, 2, 3])]
)
def test_shapes_of_few_masks_are_not_split(masks: int, splits: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recipe_module, "_LEAST_MASKS", 5)
    words = last_words(*SMALL, f"data.simulate={masks}", "shape.splits=2,2,3", "shape.rounds=0")
    settings = load_settings("masks_demo", words)
    whole = loaded_small()
    data = MaskDataModule.of(load_masks(settings) if masks != len(whole.train) else whole, settings)
    recipe = ShapeRecipe(settings, data)
    assert recipe.splits == splits
    views = [f"views_{number}" for number in range(1, len(splits) + 2)]
    assert list(recipe.budgets) == [*views, "coarse", "fine"]
    assert sum(steps_of(recipe).values()) == 15


def test_too_few_steps_for_the_stages(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="4 steps are too few for 5 stages"):
        trained(tmp_path / "run", "trainer.max_steps=4", loaded=loaded_small())


@pytest.mark.parametrize(
    ("stage", "step"), [("views_2", 1), ("coarse", 0), ("coarse", 2), ("coarse_2", 0), ("fine", 1), ("fine", 3)]
)
def test_a_fit_goes_on_in_any_stage(
    stage: str, step: int, staged: tuple[Path, ShapeRecipe, ShapeModel], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    interrupt(folder, stage, step)
    at = STAGES.index(stage)
    assert {path.stem for path in folder.glob("checkpoints/*")} == set(STAGES[: at + 1])
    taken = noted(monkeypatch)
    assert same(trained(folder), staged[2])
    steps = steps_of(staged[1])
    assert taken == [
        *((stage, later) for later in range(step + 1, steps[stage])),
        *((name, later) for name in STAGES[at + 1 :] for later in range(steps[name])),
    ]


def test_stages_that_are_over_are_read(
    staged: tuple[Path, ShapeRecipe, ShapeModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = noted(monkeypatch)
    assert same(trained(staged[0]), staged[2])
    assert taken == []


def test_a_start_from_another_run(staged: tuple[Path, ShapeRecipe, ShapeModel], tmp_path: Path) -> None:
    folder, _, model = staged
    start = f"init={folder / 'lifter.pt'}"
    recipe, more = fit_of(tmp_path / "more", start, "trainer.max_steps=1", "teacher.learning_rate=1e-9", "shape.rounds=0",
                          loaded=loaded_small())  # fmt: skip
    assert list(recipe.spent) == ["fine"], "the space that is there finds the views"
    assert any("the views are those that" in note for note in recipe.notes)
    for name, weight in model.lifter.named_parameters():
        assert torch.allclose(more.lifter.get_parameter(name), weight, atol=1e-5), name
    longer = fit_of(tmp_path / "longer", start, "trainer.max_steps=3", loaded=loaded_small())[0]
    assert list(longer.spent)[-1] == "fine"
    assert sum(longer.steps.values()) == 3, "no step is lost"
    for word in ("shape.detail=10", "shape.symmetric=false", "shape.gravity=false", "shape.code=3", "shape.hidden=8"):
        with pytest.raises(UserError, match=f"{word.split('=')[0]}=.*they must be the same"):
            trained(tmp_path / "wrong", start, word, loaded=loaded_small())
