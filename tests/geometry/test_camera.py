"""Cameras: what is unprojected projects back, and nearness shows."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from uplift.errors import UserError
from uplift.geometry.camera import Orthographic, Perspective, build_camera

SEEDS = st.integers(0, 2**31 - 1)


def _case(seed: int, distance: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    keypoints = torch.from_numpy(rng.normal(size=(4, 9, 2)))
    depth = torch.from_numpy(rng.uniform(-0.85, 3, (4, 9)) * distance)
    return keypoints, depth, torch.full((4,), distance, dtype=torch.float64)


@pytest.mark.parametrize("camera", [Orthographic(), Perspective()], ids=["orthographic", "perspective"])
@given(seed=SEEDS, distance=st.floats(2, 1e4))
@settings(max_examples=30, deadline=None)
def test_round_trip(camera, seed, distance):
    keypoints, depth, far = _case(seed, distance)
    pose = camera.unproject(keypoints, depth, far)
    assert torch.equal(pose[..., 2], depth)
    torch.testing.assert_close(camera.project(pose, far), keypoints, rtol=1e-12, atol=1e-12)


def test_orthographic_keeps_x_and_y():
    keypoints, depth, far = _case(0, 5.0)
    assert torch.equal(Orthographic().unproject(keypoints, depth, far)[..., :2], keypoints)


@given(seed=SEEDS, distance=st.floats(3, 50))
@settings(max_examples=20, deadline=None)
def test_perspective_is_a_pinhole(seed, distance):
    """The pinhole equation u = f X / Z with f = Z(root) = distance, per frame."""
    rng = np.random.default_rng(seed)
    pose = rng.uniform(-2, 2, (3, 7, 3))
    far = np.array([distance, distance + 1, distance * 2])
    expected = far[:, None, None] * pose[..., :2] / (pose[..., 2:] + far[:, None, None])
    found = Perspective().project(torch.from_numpy(pose), torch.from_numpy(far))
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-12)


def test_what_is_behind_the_pinhole_stays_finite():
    pose = torch.tensor([[[1.0, 1, -10], [1, 1, -30], [0, 0, 0], [1, 1, -8.9]]], requires_grad=True)
    seen = Perspective().project(pose, torch.tensor([10.0]))
    torch.testing.assert_close(seen[0, :, 0], torch.tensor([10.0, 10, 0, 1 / 0.11]))  # as at a tenth of the distance
    seen.sum().backward()
    assert seen.isfinite().all()
    assert pose.grad is not None and pose.grad.isfinite().all()


def test_far_away_both_cameras_agree():
    keypoints, depth, _ = _case(1, 2.0)
    far = torch.full((4,), 1e9, dtype=torch.float64)
    one, other = (c.unproject(keypoints, depth, far) for c in (Orthographic(), Perspective()))
    torch.testing.assert_close(one, other, rtol=0, atol=1e-7)


def test_names():
    assert isinstance(build_camera("perspective"), Perspective)
    assert isinstance(build_camera("orthographic"), Orthographic)
    with pytest.raises(UserError, match="Did you mean 'perspective'"):
        build_camera("perspektive")
