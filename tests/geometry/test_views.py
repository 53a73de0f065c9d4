"""Views: rotations that are rotations, about the right axes, with roma and scipy as oracles."""

from __future__ import annotations

import math

import numpy as np
import roma
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uplift.geometry.rotation import about_x, about_y, level, random_rotations, turn, views_about_gravity

ANGLES = st.floats(-math.pi, math.pi)
EYE = torch.eye(3, dtype=torch.float64)


def _tensor(*angles: float) -> torch.Tensor:
    return torch.tensor(angles, dtype=torch.float64)


@given(angle=ANGLES)
@settings(max_examples=30, deadline=None)
def test_axes_against_scipy(angle):
    np.testing.assert_allclose(about_x(_tensor(angle))[0], Rotation.from_euler("x", angle).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(about_y(_tensor(angle))[0], Rotation.from_euler("y", angle).as_matrix(), atol=1e-12)


@given(angle=ANGLES, x=st.floats(-2, 2), y=st.floats(-2, 2), z=st.floats(-2, 2))
@settings(max_examples=20, deadline=None)
def test_turning_is_the_papers_equation(angle, x, y, z):
    """x' = x cos + z sin, y' = y (Kudo et al. 2018, eq. 1)."""
    turned = turn(_tensor(x, y, z).reshape(1, 1, 3), about_y(_tensor(angle)))[0, 0]
    expected = _tensor(x * math.cos(angle) + z * math.sin(angle), y, z * math.cos(angle) - x * math.sin(angle))
    torch.testing.assert_close(turned, expected, rtol=0, atol=1e-12)


@given(seed=st.integers(0, 2**31 - 1))
@settings(max_examples=20, deadline=None)
def test_turning_there_and_back(seed):
    rng = np.random.default_rng(seed)
    pose = torch.from_numpy(rng.normal(size=(6, 11, 3)))
    view = torch.from_numpy(Rotation.random(6, random_state=seed).as_matrix())
    turned = turn(pose, view)
    torch.testing.assert_close(turn(turned, view.mT), pose)
    torch.testing.assert_close(turned[3, 5], view[3] @ pose[3, 5])
    torch.testing.assert_close(turned.norm(dim=-1), pose.norm(dim=-1))


@given(tilt=st.floats(-1.5, 1.5))
@settings(max_examples=30, deadline=None)
def test_level_sends_gravity_to_y(tilt):
    gravity = _tensor(0, math.cos(tilt), math.sin(tilt)).reshape(1, 1, 3)
    torch.testing.assert_close(turn(gravity, level(_tensor(tilt)))[0, 0], EYE[1], rtol=0, atol=1e-12)


@given(tilt=st.floats(-1.5, 1.5), new=st.floats(-1.5, 1.5), azimuth=ANGLES)
@settings(max_examples=30, deadline=None)
def test_views_about_gravity(tilt, new, azimuth):
    """Gravity as the old camera sees it goes to gravity as the new one does; nothing changes without a change."""
    view = views_about_gravity(_tensor(tilt), _tensor(azimuth), _tensor(new))[0]
    before, after = (_tensor(0, math.cos(t), math.sin(t)) for t in (tilt, new))
    torch.testing.assert_close(view @ before, after, rtol=0, atol=1e-12)
    torch.testing.assert_close(view @ view.T, EYE, rtol=0, atol=1e-12)
    assert torch.linalg.det(view) > 0
    same = views_about_gravity(_tensor(tilt), _tensor(0.0), _tensor(tilt))[0]
    torch.testing.assert_close(same, EYE, rtol=0, atol=1e-12)


@given(tilt=st.floats(-1.5, 1.5), azimuth=ANGLES)
@settings(max_examples=20, deadline=None)
def test_walking_round_turns_by_the_azimuth(tilt, azimuth):
    view = views_about_gravity(_tensor(tilt), _tensor(azimuth), _tensor(tilt))
    assert abs(float(roma.rotmat_geodesic_distance(view, EYE[None])) - abs(azimuth)) < 1e-6


def test_random_rotations_are_proper_and_uniform():
    torch.manual_seed(0)
    rotations = random_rotations(40_000).double()
    torch.testing.assert_close(rotations @ rotations.mT, EYE.expand_as(rotations), rtol=0, atol=1e-5)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(40_000, dtype=torch.float64), atol=1e-5, rtol=0)
    assert rotations.mean(0).abs().max() < 0.015  # each entry has variance 1/3
    torch.testing.assert_close(rotations.square().mean(0), torch.full((3, 3), 1 / 3).double(), rtol=0, atol=0.01)
    # The angle of a uniform rotation has the density (1 - cos) / pi.
    angle = roma.rotmat_geodesic_distance(rotations, EYE[None]).numpy()
    for quantile in (0.1, 0.5, 0.9):
        at = float(np.quantile(angle, quantile))
        assert abs((at - math.sin(at)) / math.pi - quantile) < 0.01
    torch.manual_seed(1)
    assert not torch.equal(random_rotations(3), random_rotations(3))
