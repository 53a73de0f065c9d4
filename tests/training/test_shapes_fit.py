"""Whole fits of masks, small ones: they run, save, resume, repeat themselves, and look at no truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from shape_fits import SMALL, loaded_small, same, trained

import uplift
from uplift.config.files import save_torch
from uplift.config.loading import load_settings
from uplift.data.load_masks import load_masks
from uplift.errors import UserError
from uplift.models.model import ShapeModel


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ShapeModel]:
    """Return the folder and the model of an unbroken fit."""
    folder = tmp_path_factory.mktemp("fitted") / "run"
    model = trained(folder)
    model.save(folder / "lifter.pt")
    return folder, model


def test_a_fit_is_saved_and_predicts_the_same(fitted: tuple[Path, ShapeModel]) -> None:
    folder, model = fitted
    data = loaded_small().train.select(np.arange(4))
    found = model.predict(data)
    again = uplift.load(folder / "lifter.pt")
    assert isinstance(again, ShapeModel)
    assert again.settings == model.settings
    assert same(again, model)
    np.testing.assert_allclose(again.predict(data).occupancy, found.occupancy, rtol=0, atol=1e-6)
    assert found.occupancy.shape == (4, 12, 12, 12)
    assert 0.04 <= found.level <= 0.5
    assert found.uncertainty is not None
    names = {line.split(",")[2] for line in (folder / "metrics.csv").read_text().splitlines()[1:]}
    assert {"energy", "silhouettes", "code", "cycle"} <= names


def test_the_same_seed_gives_the_same_weights(fitted: tuple[Path, ShapeModel], tmp_path: Path) -> None:
    assert same(trained(tmp_path / "again"), fitted[1])
    assert not same(trained(tmp_path / "other", "seed=1"), fitted[1])


def test_no_truth_is_looked_at(fitted: tuple[Path, ShapeModel], tmp_path: Path) -> None:
    """Neither truth that is there nor noise in its place changes one bit."""
    whole = load_masks(load_settings("masks_demo", SMALL))
    truth = whole.train.truth
    assert truth is not None
    assert whole.for_training().train.truth is None
    assert same(trained(tmp_path / "run", loaded=whole), fitted[1])
    stream = np.random.default_rng(0)
    noise = replace(
        truth,
        meshes=truth.meshes[::-1],
        view=stream.normal(size=truth.view.shape),
        scale=stream.uniform(0.1, 3, truth.scale.shape),
        offset=stream.normal(size=truth.offset.shape),
    )
    wrong = replace(whole, train=replace(whole.train, truth=noise))
    assert same(trained(tmp_path / "noise", loaded=wrong), fitted[1])


def test_labels_change_what_is_learned(fitted: tuple[Path, ShapeModel], tmp_path: Path) -> None:
    told = trained(tmp_path / "told", "data.labelled.fraction=0.2")
    assert not same(told, fitted[1])
    assert "truth" in (tmp_path / "told/metrics.csv").read_text()
    alone = trained(tmp_path / "alone", "data.labelled.fraction=0.2", "data.labelled.only=true")
    assert not same(alone, told)


def damaged(state: dict[str, Any], how: str) -> dict[str, Any]:
    """Return what a file of a lifter must not hold."""
    weights = state["state"]
    return {
        "format": {**state, "uplift_format": 99},
        "setting": {**state, "shape": {**state["shape"], "colour": 3}},
        "no settings": {name: value for name, value in state.items() if name != "shape"},
        "no weights": {**state, "state": {}},
        "sizes": {**state, "state": {**weights, "last.bias": weights["last.bias"][:1]}},
        "kind": {**state, "state": "weights"},
        "detail": {**state, "detail": 10},
        "no detail": {name: value for name, value in state.items() if name != "detail"},
        "detail of another kind": {**state, "detail": "fine"},
        "huge detail": {**state, "detail": 100_000},
        "negative detail": {**state, "detail": -12},
    }[how]


@pytest.mark.parametrize(
    "how",
    [
        "format",
        "setting",
        "no settings",
        "no weights",
        "sizes",
        "kind",
        "detail",
        "no detail",
        "detail of another kind",
        "huge detail",
        "negative detail",
    ],
)
def test_a_file_that_is_no_whole_lifter(how: str, fitted: tuple[Path, ShapeModel], tmp_path: Path) -> None:
    state = torch.load(fitted[0] / "lifter.pt", weights_only=True)
    save_torch(damaged(state, how), tmp_path / "lifter.pt")
    with pytest.raises(UserError, match=r"lifter\.pt is no"):
        uplift.load(tmp_path / "lifter.pt")


def test_a_file_that_was_cut_off(fitted: tuple[Path, ShapeModel], tmp_path: Path) -> None:
    whole = (fitted[0] / "lifter.pt").read_bytes()
    for size in (0, 100, len(whole) // 2):
        (tmp_path / "lifter.pt").write_bytes(whole[:size])
        with pytest.raises(UserError, match=r"lifter\.pt"):
            uplift.load(tmp_path / "lifter.pt")


MINE = """
import torch
from uplift import ShapePrior


class Mine(ShapePrior):
    def __init__(self, share=0.1):
        super().__init__()
        self.share = torch.nn.Parameter(torch.tensor(float(share)))
        self.masks = 0

    def prepare(self, data):
        self.masks = len(data)

    def loss(self, lift):
        return (lift.occupancy.mean() - self.share).square()

    def metrics(self, lift):
        return {"masks": self.masks}


class Wrong(ShapePrior):
    def loss(self, lift):
        return lift.occupancy.mean((1, 2, 3))


class Breaks(ShapePrior):
    def loss(self, lift):
        return lift.colour


class Unready(ShapePrior):
    def __init__(self):
        self.share = 1

    def loss(self, lift):
        return lift.occupancy.mean()
"""


def test_a_prior_of_ones_own(fitted: tuple[Path, ShapeModel], here: Path) -> None:
    Path("my.py").write_text(MINE)
    model = trained(here / "run", "priors.mine.use=my.py:Mine", "priors.mine.weight=3", "priors.mine.share=0.9")
    assert not same(model, fitted[1])
    rows = [line.split(",") for line in (here / "run/metrics.csv").read_text().splitlines()[1:]]
    assert min(float(row[3]) for row in rows if row[2] == "mine") > 0
    assert {float(row[3]) for row in rows if row[2] == "mine_masks"} == {60.0}, "prepared with all masks, and logged"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Wrong", "priors.mine: loss.lift. returned shape .1,.*expected one number"),
        ("Breaks", r"priors.mine: .*loss failed in .*my.py, line 29: AttributeError"),
        ("Unready", r"must call super\(\).__init__\(\) first"),
        ("Absent", "no class 'Absent'"),
    ],
)
def test_a_prior_of_ones_own_that_is_wrong(name: str, says: str, here: Path) -> None:
    Path("my.py").write_text(MINE)
    with pytest.raises(UserError, match=says):
        trained(here / "run", f"priors.mine.use=my.py:{name}")


def test_weights_may_be_averaged(tmp_path: Path) -> None:
    assert not same(trained(tmp_path / "averaged", "teacher.average=0.9"), trained(tmp_path / "plain"))
