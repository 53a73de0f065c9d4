"""Masks lifted with shapes that are known: where they stand, how good they are, and what moves nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter
from shape_mixtures import chair, masks_of
from shape_spaces import SPACE, KnownShapes, grids_of, known_space, tiny_space
from torch import Tensor

from uplift.config.files import read_torch, save_torch
from uplift.config.run import read_weights
from uplift.config.settings import ShapeSettings
from uplift.data.mask_tensors import as_tensor, to_mask_set
from uplift.data.masks import MaskData, Placed
from uplift.data.synthetic.masks import ViewChoice, simulate_masks
from uplift.errors import UserError
from uplift.geometry.voxels import fill
from uplift.models.model import ShapeModel
from uplift.models.shape_lifter import LiftedShapes, choose_iso_threshold, fill_rays, pick_views
from uplift.models.silhouettes import ObjectPose
from uplift.models.view_hypotheses import ViewHypotheses

R, COUNT = 24, 14


@pytest.fixture(scope="module")
def model() -> ShapeModel:
    """Return a model that knows two chairs, of seeds 0 and 4."""
    space = known_space(detail=R, pixels=24, resolution=R)
    return ShapeModel(space, space.settings)


@pytest.fixture(scope="module")
def data() -> MaskData:
    """Return masks of both of them."""
    views = ViewChoice(elevation_mean_deg=20, elevation_sd_deg=4)
    return simulate_masks([chair(0), chair(4)], COUNT, seed=1, side=48, views=views)


@pytest.fixture(scope="module")
def lifted(model: ShapeModel, data: MaskData) -> LiftedShapes:
    return model.lift(data.masks, refine=40)


def angles_between(found: Tensor, true: Tensor) -> Tensor:
    """Return the angles between rotations, in degrees."""
    cosine = ((found.mT @ true).diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    return cosine.clamp(-1, 1).arccos().rad2deg()


def true_views(data: MaskData) -> Tensor:
    """Return the rotations that masks were made with."""
    assert data.truth is not None
    return torch.from_numpy(data.truth.view).float()


def iou_of(space: KnownShapes, found: LiftedShapes, masks: np.ndarray) -> float:
    """Return the mean overlap of the masks and the silhouettes of what was lifted, carving and all."""
    pose = ObjectPose.of(found.view, found.scale, found.offset)
    seen = space.seen(torch.logit(found.occupancy.clamp(1e-4, 0.95)), pose, 32) > 0.4
    wanted = torch.nn.functional.interpolate(as_tensor(masks)[:, None], (32, 32), mode="area")[:, 0] > 0.5
    return float(((seen & wanted).sum((1, 2)) / (seen | wanted).sum((1, 2))).mean())


def test_view_scale_and_shape_come_back(model: ShapeModel, data: MaskData, lifted: LiftedShapes) -> None:
    assert data.truth is not None
    first = model.lift(data.masks, refine=0)
    off, off_before = (angles_between(found.view, true_views(data)) for found in (lifted, first))
    assert float((off < 20).float().mean()) > 0.85
    assert float(off.median()) < 5 < float(off_before.median()) + 3
    right = off < 20
    stretch = lifted.scale[right] / torch.from_numpy(data.truth.scale).float()[right]
    assert float((stretch.log().abs()).median()) < 0.06  # soft grids look a little larger than they are
    away = (lifted.offset - torch.from_numpy(data.truth.offset).float())[right].norm(dim=1)
    assert float(away.median()) < 0.04
    assert torch.allclose(lifted.distance, lifted.scale * model.settings.distance)
    space = model.lifter
    assert isinstance(space, KnownShapes)
    assert iou_of(space, lifted, data.masks) > iou_of(space, first, data.masks) + 0.03
    assert iou_of(space, lifted, data.masks) > 0.75
    # Which of the two chairs it is: the one that what was lifted is more like.
    true = torch.sigmoid(grids_of((0, 4), R))
    like = torch.stack([torch.minimum(lifted.occupancy, one).sum((1, 2, 3)) / one.sum() for one in true], 1)
    which = torch.from_numpy(np.asarray(data.truth.shape)) == 1
    assert float(((like[:, 1] > like[:, 0]) == which)[right].float().mean()) > 0.85


def test_uncertainty_is_that_of_samples_of_the_code(lifted: LiftedShapes) -> None:
    assert float(lifted.uncertainty.min()) >= 0
    assert float(lifted.uncertainty.max()) <= 0.5 + 1e-5, "of numbers between 0 and 1"
    assert float(lifted.uncertainty.max()) > 0.01
    assert not lifted.uncertainty[lifted.occupancy == 0].any(), "none where the mask is not"


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


def test_each_mask_is_lifted_for_itself(model: ShapeModel, data: MaskData, lifted: LiftedShapes) -> None:
    order = np.random.default_rng(0).permutation(len(data))[:5]
    again = model.lift(data.masks[order], refine=40)
    for name in ("occupancy", "uncertainty", "view", "scale", "offset"):
        assert torch.allclose(getattr(again, name), getattr(lifted, name)[order], atol=2e-3), name


def test_a_mask_of_nothing_and_of_everything_gives_numbers() -> None:
    masks = np.stack([np.zeros((32, 32)), np.full((32, 32), 255)]).astype(np.uint8)
    space = tiny_space()
    found = ShapeModel(space, space.settings).lift(masks, resolution=10, refine=3)
    for name in ("occupancy", "uncertainty", "view", "scale", "offset", "distance"):
        assert bool(torch.isfinite(getattr(found, name)).all())
    assert found.occupancy.shape == found.uncertainty.shape == (2, 10, 10, 10)
    assert float(found.occupancy[0].max()) == 0


def test_without_gravity_views_lean() -> None:
    masks = masks_of(chair(), 6).masks
    turned = np.ascontiguousarray(np.rot90(masks, axes=(1, 2)))
    space = known_space(gravity=False)
    found, other = (ShapeModel(space, space.settings).lift(some, refine=10) for some in (masks, turned))
    assert torch.allclose(found.view @ found.view.mT, torch.eye(3).expand(6, 3, 3), atol=1e-5)
    # The picture turned by a quarter is the same shape, and its camera leans by a quarter more.
    lean = other.view @ found.view.mT
    quarter = torch.tensor([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert float(angles_between(lean, quarter.expand(6, 3, 3)).median()) < 60  # of rotations by chance: 126


@pytest.fixture(scope="module")
def picked(model: ShapeModel, data: MaskData) -> ViewHypotheses:
    """Return the views of all masks as the space itself finds them."""
    return pick_views(model.lifter, torch.from_numpy(data.masks), None, 3)


def test_views_are_picked_by_what_explains_the_mask(picked: ViewHypotheses, data: MaskData) -> None:
    views = ObjectPose(*(part.flatten(0, 1) for part in picked.poses)).view.view(len(data), 3, 3, 3)
    best = angles_between(views[:, 0], true_views(data))
    assert float((best < 15).float().mean()) > 0.8
    assert torch.equal(picked.weight[:, 0], torch.ones(COUNT))
    assert bool((picked.weight.diff(dim=1) <= 1e-6).all()), "the likeliest first"
    for one, other in ((0, 1), (0, 2), (1, 2)):
        apart = angles_between(views[:, one], views[:, other])
        assert float(apart[picked.weight[:, other] > 0].min()) > 25
    assert float((picked.elevation[:, 0].rad2deg() - 20).abs().max()) < 15


def test_views_that_were_known_are_kept_and_wrong_ones_found_out(
    model: ShapeModel, picked: ViewHypotheses, data: MaskData, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = data.truth
    assert truth is not None
    true = ObjectPose.of(true_views(data), *(torch.from_numpy(a).float() for a in (truth.scale, truth.offset)))
    back = true._replace(azimuth=true.azimuth + torch.pi)
    before = ViewHypotheses(
        *(torch.stack([wrong, right], 1) for wrong, right in zip(back, true, strict=True)),
        torch.tensor([[0.9, 0.1]] * COUNT),
    )
    # Without any views of its own the space can still tell which of the two it is.
    monkeypatch.setattr(model.lifter, "view_logits", lambda features: torch.zeros(len(features), 24))
    found = pick_views(model.lifter, torch.from_numpy(data.masks), before, 2)
    best = ObjectPose(*(part[:, 0] for part in found.poses)).view
    assert float((angles_between(best, true.view) < 15).float().mean()) > 0.85
    assert before.weight.shape == found.weight.shape == (COUNT, 2)


def rays_of(lifted: LiftedShapes) -> np.ndarray:
    """Return which pixel of 32 by 32 each voxel is seen in (items voxels 2), as `Placed` says; -1 outside."""
    points, found = voxels().reshape(-1, 3), []
    for row in range(len(lifted.scale)):
        at = np.floor((seen_at(points, lifted, row) + 1) / 2 * 32).astype(int)
        found.append(np.where(((at >= 0) & (at < 32)).all(1, keepdims=True), at, -1))
    return np.stack(found)


@pytest.mark.parametrize("level", [0.1, 0.3])
def test_every_ray_of_the_mask_reaches_the_level(level: float, lifted: LiftedShapes, data: MaskData) -> None:
    torch.manual_seed(0)
    faint = LiftedShapes(**{**vars(lifted), "occupancy": 0.04 + 0.1 * torch.rand_like(lifted.occupancy)})
    masks = as_tensor(data.masks)
    filled = fill_rays(faint, masks, level, symmetric=False).flatten(1).numpy()
    before = faint.occupancy.flatten(1).numpy()
    covered = torch.nn.functional.interpolate(masks[:, None], (32, 32), mode="area")[:, 0].numpy() > 0.5
    for row, at in enumerate(rays_of(faint)):
        inside = (at >= 0).all(1) & covered[row][at[:, 1], at[:, 0]]
        assert np.array_equal(filled[row][~inside], before[row][~inside]), "nothing outside of the mask is raised"
        top = np.zeros((32, 32))
        np.maximum.at(top, (at[inside, 1], at[inside, 0]), filled[row][inside])
        reached = top[at[inside, 1], at[inside, 0]]
        assert reached.min() >= level
        assert np.all(filled[row][inside] >= before[row][inside])
    reaching = LiftedShapes(**{**vars(lifted), "occupancy": torch.full_like(lifted.occupancy, 0.9)})
    assert torch.equal(fill_rays(reaching, masks, level, symmetric=False), reaching.occupancy), "what reaches it stays"
    both = fill_rays(faint, masks, level, symmetric=True)
    assert torch.equal(both, both.flip(-1)), "shapes that are their own mirror images still are"


@given(st.integers(0, 10_000), st.floats(0.1, 0.8), st.floats(0.4, 3))
@settings(max_examples=8)
def test_the_level_is_the_lowest_with_nearly_the_best_iou_over_draws(seed: int, share: float, sure: float) -> None:
    """Shapes are drawn from their probabilities; no other threshold does much better on them, and no lower one as well."""
    torch.manual_seed(seed)
    blob = torch.nn.functional.interpolate(torch.randn(3, 1, 4, 4, 4), (8, 8, 8), mode="trilinear")[:, 0]
    probability = torch.sigmoid((blob - 0.3) * 4 * sure) * share
    drawn = torch.rand(400, *probability.shape) < probability
    scores = {}
    for threshold in (*np.arange(0.04, 0.2, 0.02), *np.arange(0.2, 0.51, 0.05), choose_iso_threshold(probability)):
        guess = (probability > threshold)[None]
        overlap = (drawn & guess).sum((2, 3, 4)) / (drawn | guess).sum((2, 3, 4)).clamp_min(1)
        scores[threshold] = float(overlap.mean())
    chosen = choose_iso_threshold(probability)
    assert scores[chosen] > 0.965 * max(scores.values())
    lower = [score for threshold, score in scores.items() if threshold < chosen - 0.06]
    assert max(lower, default=0.0) < max(scores.values())


def test_the_level_of_fainter_shapes_is_lower(lifted: LiftedShapes) -> None:
    levels = [choose_iso_threshold(lifted.occupancy * share) for share in (1, 0.5, 0.25)]
    assert levels[0] >= levels[1] >= levels[2]
    assert levels[0] > levels[2]


def test_a_prediction_is_what_was_lifted_with_its_rays_filled(model: ShapeModel, data: MaskData) -> None:
    model.lifter.level.fill_(0.3)
    some = data.select(np.arange(3))
    found = model.predict(some, "chairs", refine=2)
    lifted = model.lift(some.masks, refine=2)
    assert found.occupancy.shape == (3, R, R, R)
    assert found.uncertainty is not None
    assert found.uncertainty.shape == found.occupancy.shape
    assert found.occupancy.max() <= 1
    filled = fill_rays(lifted, as_tensor(some.masks), 0.3, symmetric=True)
    np.testing.assert_allclose(found.occupancy, filled.numpy(), atol=1e-6)
    assert found.level == pytest.approx(0.3)
    assert found.title == "chairs"
    assert found.names == data.names[:3]
    with pytest.raises(UserError, match="no mask to lift"):
        model.predict(data.select(np.arange(0)))


def test_a_lifter_saved_before_settings_were_renamed_loads(tmp_path: Path) -> None:
    space = tiny_space()
    model = ShapeModel(space, space.settings)
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


def test_known_views_and_shapes_of_labelled_masks(data: MaskData) -> None:
    labelled = np.arange(len(data)) % 3 == 0
    told = MaskData(**{**vars(data), "labelled": labelled})
    chosen = ShapeSettings(**SPACE)
    found = to_mask_set(told, chosen, 20)
    assert found.labelled.tolist() == labelled.tolist()
    assert data.truth is not None
    for name in ("view", "scale", "offset"):
        true, seen = getattr(data.truth, name), getattr(found, name)
        assert np.array_equal(seen[labelled], true[labelled].astype(np.float32)), name
        assert not seen[~labelled].any(), "no truth of the others is looked at"
    assert sorted(set(found.shape.tolist())) == [0, 1]
    assert found.shapes.shape == (2, 20, 20, 20)
    assert 0.01 < float(found.shapes.mean()) < 0.5
    assert not to_mask_set(data, chosen, 20).labelled.any()
