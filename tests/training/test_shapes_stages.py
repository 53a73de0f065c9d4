"""Fits of masks in several stages: finer mixtures, resumed in any of them, and gone on with in another run."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from bodies import last_words
from shape_fits import SMALL, STAGES, fit_of, interrupt, many, noted, same, trained

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
    """Return the folder, the recipe and the model of an unbroken fit of three stages."""
    folder = tmp_path_factory.mktemp("staged") / "run"
    recipe, model = fit_of(folder, *STAGES, loaded=many())
    model.save(folder / "lifter.pt")
    return folder, recipe, model


def test_each_stage_makes_a_finer_mixture(staged: tuple[Path, ShapeRecipe, ShapeModel]) -> None:
    folder, recipe, model = staged
    stages = ["shapes", "split_1", "split_2"]
    assert list(recipe.spent) == stages
    assert sorted(path.name for path in folder.glob("checkpoints/*")) == [f"{name}.ckpt" for name in stages]
    assert {line.split(",")[0] for line in (folder / "metrics.csv").read_text().splitlines()[1:]} == set(stages)
    assert "a mixture of 1, then 2, then 4 shapes of 12^3 voxels" in recipe.notes[0]
    _, second, third = steps = [budget.steps or 0 for budget in recipe.budgets.values()]
    assert sum(steps) == 24
    assert second < third, "the more shapes, the more steps"
    assert model.lifter.azimuth_bias.shape == (4, 48)
    between = torch.cdist(*[model.lifter.logits.detach().flatten(1)] * 2)
    assert float(between[~torch.eye(4, dtype=torch.bool)].min()) > 1, "no two shapes are the same"
    again = uplift.load(folder / "lifter.pt")
    assert isinstance(again, ShapeModel)
    assert same(again, model)
    assert not same(trained(folder.with_name("other"), *STAGES, "seed=1", loaded=many()), model)


@pytest.mark.parametrize(
    ("masks", "splits"), [(9, []), (10, [2]), (19, [2]), (20, [2, 2]), (59, [2, 2]), (60, [2, 2, 3])]
)
def test_shapes_of_few_masks_are_not_split(masks: int, splits: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recipe_module, "_LEAST_MASKS", 5)
    words = last_words(*SMALL, f"data.simulate={masks}", "shape.parts=1", "shape.splits=2,2,3")
    settings = load_settings("masks_demo", words)
    data = MaskDataModule.of(load_masks(settings), settings)
    assert len(data.masks) == masks
    recipe = ShapeRecipe(settings, data)
    assert recipe.splits == splits
    steps = [budget.steps or 0 for budget in recipe.budgets.values()]
    assert len(steps) == len(splits) + 1
    assert sum(steps) == 10
    assert steps[1:] == sorted(steps[1:])


def test_too_few_steps_for_the_stages(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="2 steps are too few for 3 stages"):
        trained(tmp_path / "run", *STAGES, "trainer.max_steps=2", loaded=many())


@pytest.mark.parametrize("last", [False, True])
def test_a_fit_goes_on_in_its_second_stage(
    last: bool, staged: tuple[Path, ShapeRecipe, ShapeModel], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    _, second, third = (budget.steps or 0 for budget in staged[1].budgets.values())
    step = second - 1 if last else 2
    interrupt(folder, 2, step, *STAGES, loaded=many())
    assert {path.name for path in folder.glob("checkpoints/*")} == {"shapes.ckpt", "split_1.ckpt"}
    kept = torch.load(folder / "checkpoints/split_1.ckpt", weights_only=True)["state_dict"]
    assert float(kept["statistics.weight"].sum()) == pytest.approx(1, abs=1e-5)
    taken = noted(monkeypatch)
    assert same(trained(folder, *STAGES, loaded=many()), staged[2])
    assert [(shapes, at) for shapes, at, _ in taken] == [
        *((2, later) for later in range(step + 1, second)),
        *((4, later) for later in range(third)),
    ]


def test_stages_that_are_over_are_read(
    staged: tuple[Path, ShapeRecipe, ShapeModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = noted(monkeypatch)
    assert same(trained(staged[0], *STAGES, loaded=many()), staged[2])
    assert taken == []


def test_a_start_from_a_run_of_stages(staged: tuple[Path, ShapeRecipe, ShapeModel], tmp_path: Path) -> None:
    folder, _, model = staged
    words = (*STAGES, f"init={folder / 'lifter.pt'}", "trainer.max_steps=1")
    still = ("shape.parts=3", "teacher.learning_rate=1e-9", "teacher.average=null")
    recipe, more = fit_of(tmp_path / "more", *words, *still, loaded=many())
    assert list(recipe.spent) == ["shapes"], "one stage, though there are masks for more"
    assert "a mixture of 4 shapes" in recipe.notes[0], "those of that run"
    for name in ("logits", "azimuth_bias"):
        assert torch.allclose(getattr(more.lifter, name), getattr(model.lifter, name), atol=1e-5)
    for word in ("shape.detail=10", "shape.symmetric=false", "shape.gravity=false"):
        with pytest.raises(UserError, match="must be those of that run"):
            trained(tmp_path / "wrong", *words, word, loaded=many())


def test_only_what_nothing_is_known_of_is_hot(
    staged: tuple[Path, ShapeRecipe, ShapeModel], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = noted(monkeypatch)
    words = (*STAGES, "trainer.max_steps=3", "shape.temperature_start=0.2", "shape.temperature_end=0.03")
    more = trained(tmp_path / "more", *words, f"init={staged[0] / 'lifter.pt'}", loaded=many())
    assert not same(more, staged[2])
    assert taken == [(4, step, 0.03) for step in range(3)]
    taken.clear()
    trained(tmp_path / "new", *words, loaded=many())
    assert taken == [(1, 0, 0.2), (2, 0, 0.03), (4, 0, 0.03)]
