"""Masks lifted with a shape that is known: where they stand, how good they are, and what moves nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import maximum_filter
from shape_mixtures import chair, masks_of, mixture_of, small

from uplift.config.files import read_torch, save_torch
from uplift.config.run import read_weights
from uplift.data.mask_tensors import as_tensor, to_mask_set
from uplift.data.masks import MaskData, Placed
from uplift.errors import UserError
from uplift.geometry.voxels import fill
from uplift.models.model import ShapeModel
from uplift.models.shape_lifter import LiftedShapes, choose_iso_threshold

R = 24


@pytest.fixture(scope="module")
def model() -> ShapeModel:
    """Return a model that knows one chair."""
    mixture = mixture_of((0,), small(parts=1, detail=24, crop=32))
    return ShapeModel(mixture, mixture.settings)


@pytest.fixture(scope="module")
def data() -> MaskData:
    return masks_of(chair(), 24)


@pytest.fixture(scope="module")
def lifted(model: ShapeModel, data: MaskData) -> LiftedShapes:
    return model.lift(data.masks, resolution=R)


def voxels() -> np.ndarray:
    """Return the centres (R R R 3) of the voxels, x, y, z."""
    at = (2 * np.arange(R) + 1) / R - 1
    z, y, x = np.meshgrid(at, at, at, indexing="ij")
    return np.stack([x, y, z], -1)


def seen_at(points: np.ndarray, placed: Placed | LiftedShapes, row: int) -> np.ndarray:
    """Return where points of the own frame are seen in the crop of an item, as `Placed` says."""
    view, scale, offset, distance = (
        np.asarray(getattr(placed, name)[row]) for name in ("view", "scale", "offset", "distance")
    )
    camera = scale * points @ view.T + np.append(offset, 0)
    return camera[:, :2] / (1 + camera[:, 2:] / distance)


def true_volume(placed: Placed, row: int, points: np.ndarray) -> np.ndarray:
    """Return which points of an item's camera frame are inside its true shape."""
    own = (points - np.append(placed.offset[row], 0)) @ placed.view[row] / placed.scale[row]
    grid = fill(placed.meshes[placed.shape[row]], 64)
    at = np.floor((own + 1) * 32).astype(int)
    inside = ((at >= 0) & (at < 64)).all(-1)
    x, y, z = np.clip(at, 0, 63).T
    return grid[z, y, x] & inside


def test_shapes_lie_in_their_masks_where_placed_says(lifted: LiftedShapes, data: MaskData) -> None:
    side = data.side
    points = voxels()
    for row in range(len(data)):
        occupied = points[lifted.occupancy[row].numpy() > 0.2]
        assert len(occupied) > 50
        at = np.floor((seen_at(occupied, lifted, row) + 1) / 2 * side).astype(int)
        assert at.min() >= 0
        assert at.max() < side
        assert np.mean(maximum_filter(data.masks[row], 3)[at[:, 1], at[:, 0]] > 60) > 0.98


def test_shapes_cover_their_masks(lifted: LiftedShapes, data: MaskData) -> None:
    cell = 8
    covered = []
    for row in range(len(data)):
        occupied = voxels()[lifted.occupancy[row].numpy() > 0.2]
        at = np.floor((seen_at(occupied, lifted, row) + 1) / 2 * data.side / cell).astype(int)
        drawn = np.zeros((data.side // cell,) * 2, bool)
        drawn[at[:, 1], at[:, 0]] = True
        wanted = data.masks[row].reshape(data.side // cell, cell, -1, cell).mean((1, 3)) > 128
        covered.append(np.mean(drawn[wanted]))
    assert np.mean(covered) > 0.9


def test_lifted_shapes_are_much_better_than_the_hull_of_the_mask(lifted: LiftedShapes, data: MaskData) -> None:
    assert data.truth is not None
    found, hull = [], []
    at = (2 * np.arange(R) + 1) / R - 1
    points = np.stack(np.meshgrid(at, at, at, indexing="ij"), -1).reshape(-1, 3)
    for row in range(len(data)):
        true = true_volume(data.truth, row, points)
        own = (points - np.append(lifted.offset[row], 0)) @ lifted.view[row].numpy() / float(lifted.scale[row])
        place = torch.from_numpy(own).float()[None, :, None, None]
        grid = torch.nn.functional.grid_sample(lifted.occupancy[row][None, None], place, align_corners=False)
        shape = grid.flatten().numpy() > 0.3
        image = np.floor((points[:, :2] / (1 + points[:, 2:] / float(lifted.distance[row])) + 1) / 2 * data.side)
        x, y = np.clip(image, 0, data.side - 1).astype(int).T
        extruded = (data.masks[row][y, x] > 128) & (np.abs(points[:, 2]) < 0.7)
        for scores, guess in ((found, shape), (hull, extruded)):
            scores.append(np.sum(guess & true) / np.sum(guess | true))
    assert np.mean(found) > 1.5 * np.mean(hull)
    assert np.median(found) > 0.35


def test_what_moves_a_mask_moves_its_shape(model: ShapeModel) -> None:
    masks = np.zeros((2, 64, 64), np.uint8)
    source = masks_of(chair(), 1, side=40).masks[0]
    masks[0, 12:52, 12:52] = source
    masks[1, 18:58, 4:44] = source
    still, moved = (model.lift(masks[row : row + 1], resolution=12) for row in (0, 1))
    assert torch.allclose(moved.view, still.view)
    assert torch.allclose(moved.scale, still.scale, atol=1e-3)
    assert (moved.offset - still.offset)[0].tolist() == pytest.approx([-8 / 32, 6 / 32], abs=0.01)
    # Perspective is that of the place, so voxels at an edge may differ.
    assert float((moved.occupancy - still.occupancy).abs().mean()) < 0.03


def test_each_mask_is_lifted_for_itself(model: ShapeModel, data: MaskData, lifted: LiftedShapes) -> None:
    order = np.random.default_rng(0).permutation(len(data))[:7]
    again = model.lift(data.masks[order], resolution=R)
    assert torch.allclose(again.occupancy, lifted.occupancy[order], atol=1e-4)
    assert torch.allclose(again.offset, lifted.offset[order], atol=1e-4)


def test_a_mask_of_nothing_and_of_everything_gives_numbers(model: ShapeModel) -> None:
    masks = np.stack([np.zeros((32, 32)), np.full((32, 32), 255)]).astype(np.uint8)
    found = model.lift(masks, resolution=10)
    for name in ("occupancy", "view", "scale", "offset", "distance"):
        assert bool(torch.isfinite(getattr(found, name)).all())
    assert float(found.occupancy[0].max()) == 0


@pytest.mark.parametrize("more", [{"gravity": False}, {"symmetric": False}])
def test_other_views_and_other_shapes(more: dict) -> None:
    mixture = mixture_of((0,), small(parts=1, **more))
    data = masks_of(chair(), 6)
    found = ShapeModel(mixture, mixture.settings).lift(data.masks, resolution=10)
    assert float(found.occupancy.amax((1, 2, 3)).min()) > 0.2
    assert torch.allclose(found.view @ found.view.mT, torch.eye(3).expand(6, 3, 3), atol=1e-5)


def test_a_prediction_is_what_was_lifted(model: ShapeModel, data: MaskData, tmp_path) -> None:
    model.lifter.level.fill_(0.3)
    found = model.predict(data.select(np.arange(3)), "chairs")
    assert found.occupancy.shape == (3, 32, 32, 32)
    assert found.occupancy.min() >= 0
    assert found.occupancy.max() <= 1
    assert found.level == pytest.approx(0.3)
    assert found.title == "chairs"
    assert found.names == data.names[:3]
    with pytest.raises(UserError, match="no mask to lift"):
        model.predict(data.select(np.arange(0)))
    model.save(tmp_path / "lifter.pt")
    loaded = ShapeModel.from_weights(read_weights(tmp_path / "lifter.pt"))
    loaded.lifter.projector = model.lifter.projector  # the same, and it takes a while to make
    again = loaded.predict(data.select(np.arange(3)))
    assert np.array_equal(again.occupancy, found.occupancy)
    assert again.level == found.level


def test_a_lifter_saved_before_settings_were_renamed_loads(model: ShapeModel, tmp_path: Path) -> None:
    path = tmp_path / "lifter.pt"
    model.save(path)
    state = read_torch(path, "lifter")
    shape = state["shape"]
    shape["hot"], shape["cold"] = shape.pop("temperature_start"), shape.pop("temperature_end")
    save_torch(state, path)
    assert ShapeModel.from_weights(read_weights(path)).settings == model.settings
    shape["warm"] = 1
    save_torch(state, path)
    with pytest.raises(UserError, match="warm"):
        ShapeModel.from_weights(read_weights(path))


def test_the_level_of_fainter_shapes_is_lower(model: ShapeModel, data: MaskData) -> None:
    found = model.lift(data.masks, resolution=24)
    masks, levels = as_tensor(data.masks), []
    for share in (1, 0.5, 0.25):
        levels.append(choose_iso_threshold(replace(found, occupancy=found.occupancy * share), masks))
    assert levels[0] >= levels[1] >= levels[2]
    assert levels[0] > levels[2]


def test_known_views_and_shapes_of_labelled_masks(data: MaskData, model: ShapeModel) -> None:
    labelled = np.arange(len(data)) % 3 == 0
    told = MaskData(**{**vars(data), "labelled": labelled})
    found = to_mask_set(told, model.settings)
    assert found.labelled.tolist() == labelled.tolist()
    assert data.truth is not None
    assert np.array_equal(found.view[labelled], data.truth.view[labelled].astype(np.float32))
    assert not found.view[~labelled].any(), "no truth of the others is looked at"
    assert not found.shape.any()
    assert found.shapes.shape == (1, 24, 24, 24)
    assert 0.01 < float(found.shapes.mean()) < 0.5
    assert not to_mask_set(data, model.settings).labelled.any()
