"""Several masks of one object lifted together, and the frame whose front has a name."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from uplift.config.settings import ShapeSettings
from uplift.data.masks import MaskData
from uplift.data.synthetic.masks import simulate_masks
from uplift.errors import UserError
from uplift.models.front import front_at, front_of_views, turned_grids
from uplift.models.model import ShapeModel
from uplift.models.prediction import view_angles_deg
from uplift.models.shape_space import ShapeSpace
from uplift.models.silhouettes import view_of

SMALL = {"detail": 12, "resolution": 12, "code": 4, "hidden": 16, "pixels": 12, "refine": 6}


def model_of(**more: object) -> ShapeModel:
    """Return an untrained lifter whose shapes differ by their codes."""
    torch.manual_seed(3)
    chosen = ShapeSettings(**{**SMALL, **more})  # type: ignore[arg-type]
    space = ShapeSpace(chosen)
    torch.nn.init.normal_(space.last.weight, std=1.0)
    return ShapeModel(space.eval().requires_grad_(False), chosen)


@pytest.fixture(scope="module")
def data() -> MaskData:
    return simulate_masks("chairs", 8, seed=1, side=32, views_per_shape=4).without_truth()


def test_masks_of_a_group_have_one_shape_and_each_its_pose(data: MaskData) -> None:
    model, group = model_of(), ["b", "a", "b", "a", "b", "c", "b", "a"]
    found = model.predict(data, group=group)
    for row, name in enumerate(group):
        first = group.index(name)
        assert np.array_equal(found.occupancy[row], found.occupancy[first])
    assert len({found.occupancy[group.index(name)].tobytes() for name in "abc"}) == 3
    assert len(np.unique(found.view.reshape(8, 9), axis=0)) == 8
    order = np.random.default_rng(0).permutation(8)
    again = model.predict(data.select(order), group=[group[row] for row in order])
    np.testing.assert_allclose(again.view, found.view[order], atol=2e-3)
    # Voxels at the edge of a mask are cut off or not.
    assert np.abs(again.occupancy - found.occupancy[order]).mean() < 0.02


def test_more_masks_leave_less_open(data: MaskData) -> None:
    model = model_of()
    spread = [
        model.lift(data.masks[:4], group=np.array(group)).uncertainty.sum() for group in ([0, 1, 2, 3], [0, 0, 0, 0])
    ]
    assert spread[1] < 0.8 * spread[0]


def test_a_group_of_more_masks_than_are_refined_at_a_time(data: MaskData) -> None:
    many = data.select(np.arange(60) % 8)
    found = model_of(refine=1).predict(many, group=np.zeros(60))
    assert np.isfinite(found.view).all()
    assert np.array_equal(found.occupancy[0], found.occupancy[59])


def test_groups_that_do_not_fit(data: MaskData) -> None:
    with pytest.raises(UserError, match=r"group has shape \(3,\), expected one name or number for each of 8 masks"):
        model_of().predict(data, group=[1, 2, 3])


def test_probabilities_of_views(data: MaskData) -> None:
    found = model_of().predict(data)
    assert found.probability is not None
    assert found.second_probability is not None
    assert (found.probability + found.second_probability <= 1 + 1e-5).all()
    assert (found.probability > 0).all()


@pytest.mark.parametrize("more", [{}, {"symmetric": False}, {"gravity": False}])
def test_a_half_turn_moves_no_silhouette(more: dict[str, bool], data: MaskData) -> None:
    model = model_of(**more)
    one, other = model.predict(data), model.facing(180).predict(data)
    moved = np.abs(other.occupancy - one.occupancy[:, ::-1, :, ::-1]) > 1e-3
    assert moved.mean() < 0.01  # voxels at the edge of a mask
    half = np.diag([-1.0, 1.0, -1.0])
    np.testing.assert_allclose(other.view, one.view @ half, atol=1e-6)
    if model.settings.gravity:
        turned = (one.azimuth_deg - other.azimuth_deg) % 360
        np.testing.assert_allclose(turned, 180, atol=1e-3)
        np.testing.assert_allclose(other.elevation_deg, one.elevation_deg, atol=1e-3)


def test_any_turn_of_shapes_without_symmetry() -> None:
    at = (2 * torch.arange(24) + 1) / 24 - 1
    z, y, x = torch.meshgrid(at, at, at, indexing="ij")

    def ball(front: torch.Tensor) -> torch.Tensor:
        middle = front @ torch.tensor([0.5, 0.1, 0.0])
        return torch.sigmoid(20 * (0.3 - torch.stack([x - middle[0], y - middle[1], z - middle[2]]).norm(dim=0)))

    chosen = ShapeSettings(symmetric=False)
    for degrees in (0.0, 30.0, 90.0, 180.0, -110.0):
        front = front_at(degrees, chosen)
        turned = turned_grids(ball(torch.eye(3))[None], front)[0]
        assert float((turned - ball(front)).abs().max()) < 0.12, degrees
    with pytest.raises(UserError, match="front=30: shapes of this lifter are their own mirror image"):
        front_at(30, ShapeSettings())


@settings(deadline=None, max_examples=25)
@given(st.floats(-3, 3), st.booleans(), st.booleans(), st.integers(0, 99))
def test_the_front_is_found_from_a_few_views(turn: float, gravity: bool, symmetric: bool, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    angles = torch.rand(5, 3, generator=generator) * torch.tensor([6.0, 1.0, 0.5])
    known = view_of(*angles.unbind(1))
    zero = torch.zeros(1)
    if gravity:
        front = view_of(torch.tensor([np.pi * (turn > 0) if symmetric else turn]).float(), zero, zero)[0]
    else:
        around = torch.tensor([np.pi * (turn > 1) if symmetric else turn]).float()
        front = (
            view_of(zero, torch.tensor([turn]), zero if symmetric else zero + 0.4)[0] @ view_of(around, zero, zero)[0]
        )
    found = known @ front  # as a lifter sees them in its own frame
    chosen = ShapeSettings(gravity=gravity, symmetric=symmetric)
    torch.testing.assert_close(front_of_views(found, known, chosen), front, atol=1e-4, rtol=0)


@given(st.floats(-179, 179), st.floats(-89, 89), st.floats(-179, 179))
def test_angles_are_those_of_the_view(azimuth: float, elevation: float, roll: float) -> None:
    view = view_of(*(torch.tensor([np.deg2rad(angle)]) for angle in (azimuth, elevation, roll))).numpy()
    np.testing.assert_allclose(np.concatenate(view_angles_deg(view)), [azimuth, elevation, roll], atol=1e-6)


@pytest.mark.parametrize(
    ("azimuth", "towards"), [(0, (0, 0, -1)), (90, (-1, 0, 0)), (-90, (1, 0, 0)), (180, (0, 0, 1))]
)
def test_azimuths_as_data_render_has_them(azimuth: int, towards: tuple[int, ...]) -> None:
    from uplift.data.synthetic.masks import ViewChoice

    views = ViewChoice(azimuth_deg=(azimuth, azimuth), elevation_mean_deg=0, elevation_sd_deg=0)
    truth = simulate_masks("chairs", 1, seed=0, side=16, views=views).truth
    assert truth is not None
    np.testing.assert_allclose(truth.view[0] @ [0, 0, -1], towards, atol=1e-6)  # the front, in the image
    assert float(view_angles_deg(truth.view)[0][0] - azimuth) % 360 == pytest.approx(0, abs=1e-4)
