"""Files that earlier versions wrote are read, and lift as they did; others are refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import uplift
from uplift.config.files import save_torch
from uplift.config.run import read_weights
from uplift.errors import UserError
from uplift.models.model import Model, ShapeModel, load_poses, load_shapes

FILES = Path(__file__).parent / "files"
KEYPOINTS, MASKS = FILES / "lifter_keypoints_3.pt", FILES / "lifter_masks_1.pt"
"""Written before the two models shared their file's code; `expected.pt` has what they lifted."""
EXPECTED = torch.load(FILES / "expected.pt", weights_only=True)


@pytest.mark.parametrize("version", [2, 3])
def test_an_old_file_of_keypoints(version: int, tmp_path: Path) -> None:
    path = KEYPOINTS
    if version == 2:  # before bodies had a size
        state = torch.load(KEYPOINTS, weights_only=True)
        del state["state"]["bone_mm"]
        path = tmp_path / "lifter.pt"
        save_torch({**state, "uplift_format": 2}, path)
    model = uplift.load(path)
    assert isinstance(model, Model)
    assert not model.lifter.training
    assert not model.lifter.bone_mm.any()
    model.products = "highest"  # the record has no rounded products
    torch.testing.assert_close(model(EXPECTED["keypoints"]), EXPECTED["pose"], rtol=1e-4, atol=1e-3)


def test_an_old_file_of_masks() -> None:
    model = uplift.load(MASKS)
    assert isinstance(model, ShapeModel)
    found = model.lift(EXPECTED["masks"].numpy()).occupancy
    torch.testing.assert_close(found, EXPECTED["occupancy"], rtol=1e-4, atol=1e-4)
    assert float(model.lifter.level) == pytest.approx(0.3)


@pytest.mark.parametrize("path", [KEYPOINTS, MASKS])
def test_what_is_saved_again_is_the_same(path: Path, tmp_path: Path) -> None:
    uplift.load(path).save(tmp_path / "lifter.pt")
    old, new = (torch.load(file, weights_only=True) for file in (path, tmp_path / "lifter.pt"))
    assert old.keys() == new.keys()
    assert old["uplift_format"] == new["uplift_format"]
    assert all(torch.equal(old["state"][name], new["state"][name]) for name in old["state"] | new["state"])


def test_each_kind_is_refused_where_the_other_is_expected() -> None:
    assert isinstance(load_poses(KEYPOINTS), Model)
    assert isinstance(load_shapes(MASKS), ShapeModel)
    with pytest.raises(UserError, match="lifts masks, expected a run that lifts keypoints"):
        load_poses(MASKS)
    with pytest.raises(UserError, match="lifts keypoints, expected a run that lifts masks"):
        load_shapes(KEYPOINTS)
    with pytest.raises(UserError, match="not a lifter of keypoints .* lifts masks, expected 3"):
        Model.from_weights(read_weights(MASKS))
    with pytest.raises(UserError, match="not a lifter of masks .* lifts keypoints, expected 1"):
        ShapeModel.from_weights(read_weights(KEYPOINTS))


@pytest.mark.parametrize("path", [KEYPOINTS, MASKS])
@pytest.mark.parametrize("version", [0, 1, 4, None])
def test_another_format_is_refused(path: Path, version: int | None, tmp_path: Path) -> None:
    state = torch.load(path, weights_only=True)
    if path == MASKS and version == 1:
        version = 2
    save_torch({**state, "uplift_format": version}, tmp_path / "lifter.pt")
    with pytest.raises(UserError, match="that this version can read: uplift_format is"):
        uplift.load(tmp_path / "lifter.pt")
