"""Wrong settings of a fit that lifts masks: one clear error each, and no run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bodies import refusal
from mask_files import blob, save
from shape_stand_in import stand_in

from uplift.config.loading import load_settings
from uplift.data.load_masks import load_masks

pytestmark = pytest.mark.usefixtures("here")

DEMO = ("task=masks_demo", "data.simulate=20", "data.family=chairs", "data.side=32")


@pytest.fixture(autouse=True)
def lifter(monkeypatch: pytest.MonkeyPatch) -> list:
    return stand_in(monkeypatch)


@pytest.fixture
def masks(here: Path) -> Path:
    save(here / "masks/0.png", (255 * blob()).astype(np.uint8))
    return here / "masks"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("lifts=mask",), "Did you mean 'masks'?"),
        (("skeleton=h36m17",), "skeleton is set, but this fit lifts masks"),
        (("data.layout=coco17",), "data.layout is set, but this fit lifts masks"),
        (("data.focal_px=900",), "data.focal_px is set"),
        (("shape.resolution=4",), "shape.resolution=4: expected a number from 8 to 256"),
        (("shape.resolution=4096",), "shape.resolution=4096"),
        (("shape.elevation_deg=120,3",), "shape.elevation_deg[0]=120.0: expected a number from -90 to 90"),
        (("shape.distance=1",), "shape.distance=1"),
        (("shape.parts=0",), "shape.parts=0: expected a number from 1 to 64"),
        (("shape.splits=1",), "shape.splits[0]=1: expected a number from 2 to 64"),
        (("shape.splits=4,65",), "shape.splits[1]=65: expected a number from 2 to 64"),
        (("shape.splits=-2",), "shape.splits[0]=-2: expected a number from 2 to 64"),
        (("shape.splits=2,some",), "'shape.splits[1]': Value 'some'"),
        (("shape.splits=2,2.5",), "'shape.splits[1]': Value '2.5'"),
        (("shape.parts=4", "shape.splits=32,33"), "ask for 4,224 shapes, expected at most 4,096"),
        (("data.side=4",), "data.side=4"),
        (("data.side=2000",), "data.side=2000"),
        (("data.border=crop",), "data.border='crop'"),
        (("data.pieces=all",), "data.pieces='all'"),
        (("data.simulate=10000000",), "GB: ask for fewer"),
        (("data.family=char",), "Did you mean 'chairs'?"),
        (("data.most=10",), "data.most goes with files of masks"),
        (("data.select.subjects=S1",), "it goes with keypoints. Choose by categories, fraction."),
        (("data.select.categories=lamp",), "no mask with category 'lamp'"),
        (("data.hold_out.fraction=0.1",), "data.hold_out are both set"),
        (("data.labelled.only=true",), "data.labelled.only is on"),
        (("data.labelled.fraction=0.01",), "less than one"),
        (("data.labelled.fraction=2",), "at most 1"),
        (("data.simulate=0",), "No training masks: set data.train=FOLDER"),
        (("data.simulate=0", "data.train=empty"), "is an empty folder"),
        (("data.simulate=0", "data.train=nowhere"), "uplift fit task=masks_demo` needs no data"),
        (("data.simulate=0", "data.train=body.npz"), "its arrays: keypoints"),
        (("data.simulate=0", "data.train=masks", "data.labelled.fraction=1"), "holds no true shapes to learn from"),
        (("data.simulate=0", "data.train=masks", "data.images=photos"), "no such folder"),
    ],
)
def test_fit_refuses(words: tuple[str, ...], says: str, masks: Path, capsys) -> None:
    Path("empty").mkdir()
    np.savez("body.npz", keypoints=np.zeros((3, 17, 2)))
    assert says in refusal(capsys, "fit", *DEMO, *words)
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("shape.resolution=64",), "this fit lifts keypoints: it goes with masks. Start from task=masks"),
        (("data.family=cars",), "data.family is set"),
        (("shape.splits=2",), "shape.splits is set, but this fit lifts keypoints"),
        (
            ("data.select.categories=cow",),
            "it goes with masks. Choose by subjects, actions, sequences, cameras, fraction, of_each_clip.",
        ),
    ],
)
def test_fits_of_keypoints_refuse_what_is_of_masks(words: tuple[str, ...], says: str, capsys) -> None:
    assert says in refusal(capsys, "fit", "task=demo", *words)


@pytest.mark.parametrize(("word", "splits"), [("", []), ("3", [3]), ("32,32", [32, 32]), ("[2,64]", [2, 64])])
def test_splits_that_may_be(word: str, splits: list[int]) -> None:
    assert load_settings("masks_demo", [f"shape.splits={word}", "shape.parts=4"]).shape.splits == splits


def test_masks_that_are_given_win_over_what_a_task_simulates(masks: Path) -> None:
    found = load_masks(load_settings("masks_demo", ["data.train=masks"]))
    assert found.notes[0] == "data.train is given: what task 'masks_demo' simulates is not used"
    assert "simulated" not in found.train.source
