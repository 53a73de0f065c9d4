"""Errors of views after one common turn: what it may be, and what it may not hide."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shape_scenes import views

from uplift.metrics.view_errors import (
    azimuth_errors_deg,
    elevation_errors_deg,
    is_upright,
    rotation_errors_deg,
    view_errors_deg,
)

RNG = np.random.default_rng(0)
AZIMUTHS = RNG.uniform(0, 360, 40)
TRUTH = views(AZIMUTHS)
ANYHOW = Rotation.random(40, random_state=0).as_matrix()


def test_another_front_of_all_shapes_is_no_error():
    turned = TRUTH @ views([70.0], 0.0)[0]
    errors = view_errors_deg(turned, TRUTH)
    assert errors is not None and errors.max() < 0.51
    assert np.median(elevation_errors_deg(turned, TRUTH)) == pytest.approx(0, abs=1e-6)
    assert np.median(elevation_errors_deg(views(AZIMUTHS, 32.0), TRUTH)) == pytest.approx(12)
    assert (view_errors_deg(views(RNG.uniform(0, 360, 40)), TRUTH) <= 20).mean() < 0.4


def test_views_that_are_not_found_do_not_pull_at_the_turn():
    # 75 views are a degree or two wrong, 43 by 80 degrees, all the same way, 2 by 22: the mean error is least elsewhere.
    azimuths = RNG.uniform(0, 360, 120)
    errors = np.concatenate([RNG.uniform(-2, 2, 75), np.full(43, 80.0), [22.0, 22.0]])
    found = view_errors_deg(views(azimuths + errors + 123.0), views(azimuths))
    assert (found <= 20).mean() == pytest.approx(75 / 120)
    assert found[:75].max() < 3.5 and np.abs(found[75:118] - 80).max() < 2


def test_half_of_the_views_from_behind_are_half_found():
    flipped = np.where(np.arange(40) < 22, 0.0, 180.0)
    found = view_errors_deg(views(AZIMUTHS + flipped), TRUTH)
    assert (found <= 20).mean() == pytest.approx(22 / 40) and found.max() > 179


def test_without_gravity_the_common_turn_is_any_rotation():
    assert is_upright(TRUTH) and not is_upright(ANYHOW)
    common = Rotation.from_rotvec([0.5, -1.0, 2.0]).as_matrix()
    assert view_errors_deg(ANYHOW @ common, ANYHOW).max() < 1e-3
    # Each off by a known angle about an axis of its own; a quarter is anywhere.
    axes = RNG.normal(size=(40, 3))
    degrees = np.tile([0.0, 4.0, 9.0, 14.0], 10)
    off = Rotation.from_rotvec(np.radians(degrees)[:, None] * axes / np.linalg.norm(axes, axis=1)[:, None]).as_matrix()
    off[30:] = Rotation.random(10, random_state=5).as_matrix()
    found = view_errors_deg(off @ ANYHOW @ common, ANYHOW)
    np.testing.assert_allclose(found[:30], degrees[:30], atol=4)
    np.testing.assert_allclose(found, rotation_errors_deg(off @ ANYHOW @ common, ANYHOW))
    assert (found <= 20).mean() == pytest.approx(0.75, abs=0.03)


def test_shapes_in_the_frame_of_the_camera_have_no_view():
    same = np.repeat(np.eye(3)[None], 40, 0)
    for errors in (view_errors_deg, azimuth_errors_deg, elevation_errors_deg, rotation_errors_deg):
        assert errors(same, TRUTH) is None
