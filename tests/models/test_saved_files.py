"""Files that earlier versions wrote are read, and lift as they did; others are refused, as are mixtures of shapes."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from shape_spaces import tiny_space

import uplift
from uplift.config.files import save_torch
from uplift.config.run import read_weights
from uplift.errors import UserError
from uplift.models.model import Model, ShapeModel, load_poses, load_shapes

FILES = Path(__file__).parent / "files"
KEYPOINTS, MIXTURE = FILES / "lifter_keypoints_3.pt", FILES / "lifter_masks_1.pt"
"""Written before the two models shared their file's code, the second by a lifter of masks that there is no more."""
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


def test_an_old_file_of_masks_is_refused() -> None:
    with pytest.raises(UserError, match="uplift_format is 1, .*expected 2"):
        uplift.load(MIXTURE)


@pytest.fixture(scope="module")
def masks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file of a lifter of masks as it is written now."""
    space = tiny_space()
    path = tmp_path_factory.mktemp("masks") / "lifter.pt"
    ShapeModel(space, space.settings).save(path)
    return path


@pytest.fixture(params=["keypoints", "masks"])
def path(request: pytest.FixtureRequest, masks: Path) -> Path:
    """Return a file of each kind."""
    return KEYPOINTS if request.param == "keypoints" else masks


def test_what_is_saved_again_is_the_same(path: Path, tmp_path: Path) -> None:
    uplift.load(path).save(tmp_path / "lifter.pt")
    old, new = (torch.load(file, weights_only=True) for file in (path, tmp_path / "lifter.pt"))
    assert old.keys() == new.keys()
    assert old["uplift_format"] == new["uplift_format"]
    assert all(torch.equal(old["state"][name], new["state"][name]) for name in old["state"] | new["state"])


def test_each_kind_is_refused_where_the_other_is_expected(masks: Path) -> None:
    assert isinstance(load_poses(KEYPOINTS), Model)
    assert isinstance(load_shapes(masks), ShapeModel)
    with pytest.raises(UserError, match="lifts masks, expected a run that lifts keypoints"):
        load_poses(masks)
    with pytest.raises(UserError, match="lifts keypoints, expected a run that lifts masks"):
        load_shapes(KEYPOINTS)
    with pytest.raises(UserError, match="not a lifter of keypoints .* lifts masks, expected 3"):
        Model.from_weights(read_weights(masks))
    with pytest.raises(UserError, match="not a lifter of masks .* lifts keypoints, expected 2"):
        ShapeModel.from_weights(read_weights(KEYPOINTS))


@pytest.mark.parametrize("version", [0, 1, 4, None])
def test_another_format_is_refused(path: Path, version: int | None, tmp_path: Path) -> None:
    state = torch.load(path, weights_only=True)
    save_torch({**state, "uplift_format": version}, tmp_path / "lifter.pt")
    with pytest.raises(UserError, match="that this version can read: uplift_format is"):
        uplift.load(tmp_path / "lifter.pt")
