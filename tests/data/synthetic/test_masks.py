"""Simulated masks: repeatable, views as asked for, truth beside them, clear errors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from uplift.data.synthetic.masks import ViewChoice, draw_views, make_shapes, simulate_masks
from uplift.errors import UserError
from uplift.geometry.rotation import level


def test_one_shape_an_item_and_the_same_for_a_seed() -> None:
    first, again = (simulate_masks("chairs", 6, seed=4, side=32) for _ in range(2))
    np.testing.assert_array_equal(first.masks, again.masks)
    assert first.truth is not None
    assert len(first.truth.meshes) == 6
    assert first.side == 32
    assert first.category is not None
    assert set(first.category) == {"chair"}
    assert len(set(first.names)) == 6
    other = simulate_masks("chairs", 6, seed=5, side=32)
    assert (other.masks != first.masks).any((1, 2)).all()


def test_several_views_of_a_shape_and_shapes_of_ones_own() -> None:
    found = simulate_masks("chairs", 7, seed=1, side=16, views_per_shape=3)
    assert found.truth is not None
    assert found.truth.shape.tolist() == [0, 0, 0, 1, 1, 1, 2]
    own = simulate_masks(make_shapes("tables", 2, 0), 5, seed=1, side=16)
    assert own.truth is not None
    assert own.truth.shape.tolist() == [0, 1, 0, 1, 0]


def test_masks_keep_clear_of_the_border_and_fill_the_crop() -> None:
    masks = simulate_masks("furniture", 20, seed=2).masks
    assert not masks[:, [0, -1]].any()
    assert not masks[:, :, [0, -1]].any()
    longer = np.maximum(masks.any(1).sum(1), masks.any(2).sum(1))
    assert (np.abs(longer - 0.85 * 64) <= 2).all()


def test_upright_views_lean_as_asked() -> None:
    view, distance = draw_views(4000, ViewChoice(), 0)
    down = view @ np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(down[:, 0], 0, atol=1e-12)  # the camera is never rolled
    tilt = np.degrees(np.arctan2(down[:, 2], down[:, 1]))
    assert tilt.mean() == pytest.approx(15, abs=0.7)
    assert tilt.std() == pytest.approx(10, abs=0.7)
    assert tilt.min() >= -10 - 1e-9
    front = view @ np.array([0.0, 0.0, -1.0])
    azimuth = np.arctan2(front[:, 0], -front[:, 2])
    assert abs(np.exp(1j * azimuth).mean()) < 0.05
    assert 4 <= distance.min() < 4.1 < 7.9 < distance.max() <= 8


def test_an_object_that_faces_the_camera_shows_its_front_and_a_high_camera_its_top() -> None:
    views = ViewChoice(azimuth_deg=(0, 0), elevation_deg=(30, 30), elevation_mean_deg=None, distance=(np.inf, np.inf))
    view, distance = draw_views(2, views, 0)
    assert np.isinf(distance).all()
    expected = level(torch.tensor([np.pi / 6], dtype=torch.float64))[0].T.numpy()
    np.testing.assert_allclose(view[0], expected, atol=1e-12)
    up, front = view[0] @ (0, -1, 0), view[0] @ (0, 0, -1)
    assert up[2] < 0  # the top leans towards the camera
    assert front[2] < 0
    assert front[1] > 0  # what faces the camera from below it is lower in the image


def test_views_all_over_the_sphere() -> None:
    view, _ = draw_views(3000, ViewChoice(upright=False), 0)
    np.testing.assert_allclose(view @ view.transpose(0, 2, 1), np.broadcast_to(np.eye(3), view.shape), atol=1e-5)
    assert np.abs(view.mean(0)).max() < 0.05
    again, _ = draw_views(3000, ViewChoice(upright=False), 0)
    np.testing.assert_array_equal(view, again)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"azimuth_deg": (10.0, -10.0)}, "azimuth_deg goes from 10 to -10"),
        ({"elevation_deg": (-120.0, 0.0)}, "expected -90 to 90"),
        ({"distance": (1.0, 4.0)}, "distance starts at 1, expected 2 or more"),
        ({"elevation_sd_deg": -1.0}, "expected 0 or more"),
        ({"distance": (float("nan"), 4.0)}, "expected the lower number first"),
    ],
)
def test_absurd_views_are_told(change: dict, message: str) -> None:
    with pytest.raises(UserError, match=message):
        ViewChoice(**change)


def test_absurd_amounts_are_told() -> None:
    with pytest.raises(UserError, match="0 masks of 1 views a shape asked for"):
        simulate_masks("chairs", 0, seed=0)
    with pytest.raises(UserError, match="Masks of 4 x 4 pixels"):
        simulate_masks("chairs", 1, seed=0, side=4)
    with pytest.raises(UserError, match="No meshes"):
        simulate_masks([], 1, seed=0)
    with pytest.raises(UserError, match="No family of shapes 'animal'"):
        simulate_masks("animal", 1, seed=0)
