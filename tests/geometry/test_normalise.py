"""Normalisation: radius 1, nothing moves it but the pose, missing joints count for nothing, cameras look at the root."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uplift.geometry.camera import Perspective
from uplift.geometry.normalise import Intrinsics, normalise, renormalise

SEEDS = st.integers(0, 2**31 - 1)
ROOT = 2


def _frames(seed: int, missing: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    keypoints = rng.normal(500, 120, (5, 9, 2))
    confidence = (rng.random((5, 9)) >= missing).astype(float)
    confidence[:, [ROOT, 4]] = 1
    return torch.from_numpy(keypoints), torch.from_numpy(confidence)


def _radius(points: np.ndarray, confidence: np.ndarray, *, count_root: bool) -> np.ndarray:
    weight = confidence.copy()
    weight[:, ROOT] *= count_root
    return (np.linalg.norm(points, axis=-1) * weight).sum(1) / weight.sum(1)


@pytest.mark.parametrize("count_root", [True, False])
@given(seed=SEEDS, missing=st.floats(0, 0.8))
@settings(max_examples=25, deadline=None)
def test_root_at_0_and_mean_radius_1(count_root, seed, missing):
    keypoints, confidence = _frames(seed, missing)
    normal = normalise(keypoints, confidence, ROOT, count_root=count_root)
    assert not normal.keypoints[:, ROOT].any()
    radius = _radius(normal.keypoints.numpy(), confidence.numpy(), count_root=count_root)
    np.testing.assert_allclose(radius, 1, atol=1e-7)
    assert not normal.keypoints[confidence == 0].any()
    assert normal.rotation is None and (normal.distance == 10).all()


def test_dividing_by_all_or_without_the_root():
    """The paper divides by the mean over N joints, the authors' code by that over N - 1."""
    keypoints, confidence = _frames(0)
    distances = (keypoints - keypoints[:, ROOT, None]).norm(dim=-1).sum(1)
    for count_root, count in ((True, 9), (False, 8)):
        scale = normalise(keypoints, confidence, ROOT, count_root=count_root).scale_px
        torch.testing.assert_close(scale, distances / count, rtol=1e-9, atol=0)


@given(seed=SEEDS, factor=st.floats(0.05, 20), x=st.floats(-3e3, 3e3), y=st.floats(-3e3, 3e3))
@settings(max_examples=25, deadline=None)
def test_place_and_size_in_the_image_do_not_matter(seed, factor, x, y):
    keypoints, confidence = _frames(seed, 0.3)
    before = normalise(keypoints, confidence, ROOT)
    after = normalise(keypoints * factor + torch.tensor([x, y], dtype=torch.float64), confidence, ROOT)
    torch.testing.assert_close(after.keypoints, before.keypoints, rtol=0, atol=1e-8)
    torch.testing.assert_close(after.scale_px, before.scale_px * factor, rtol=1e-8, atol=0)


@pytest.mark.parametrize("intrinsics", [None, Intrinsics(1100.0, (512.0, 480.0))], ids=["unknown", "known"])
def test_missing_joints_have_no_influence(intrinsics):
    keypoints, confidence = _frames(1, 0.5)
    moved = torch.where(confidence[..., None] > 0, keypoints, keypoints * -3 + 1e4)
    before, after = (normalise(k, confidence, ROOT, intrinsics=intrinsics) for k in (keypoints, moved))
    assert torch.equal(before.keypoints, after.keypoints)
    assert torch.equal(before.scale_px, after.scale_px) and torch.equal(before.distance, after.distance)


def test_confidence_is_the_weight_of_a_joint():
    keypoints, confidence = _frames(2)
    confidence[:, 5] = 0.25
    normal = normalise(keypoints, confidence, ROOT)
    np.testing.assert_allclose(_radius(normal.keypoints.numpy(), confidence.numpy(), count_root=True), 1, atol=1e-7)


@given(seed=SEEDS)
@settings(max_examples=30, deadline=None)
def test_known_camera_looks_at_the_root(seed):
    """A body seen off-centre becomes what a pinhole turned straight to its root would see."""
    rng = np.random.default_rng(seed)
    focal, centre = rng.uniform(500, 2000), rng.uniform(300, 700, 2)
    body = rng.normal(0, 300, (4, 9, 3))
    body[:, ROOT] = 0
    root = np.stack([*rng.uniform(-2500, 2500, (2, 4)), rng.uniform(3000, 8000, 4)], 1)
    points = body + root[:, None]
    assume((points[..., 2] > 800).all())
    keypoints = points[..., :2] / points[..., 2:] * focal + centre
    intrinsics = Intrinsics(float(focal), (float(centre[0]), float(centre[1])))
    confidence = torch.ones(4, 9, dtype=torch.float64)
    normal = normalise(torch.from_numpy(keypoints), confidence, ROOT, intrinsics=intrinsics)

    # The least turn of the camera: about the axis normal to both rays, by the angle between them.
    axis = np.cross(root, [0, 0, 1.0])
    angle = np.arctan2(np.linalg.norm(axis, axis=1), root[:, 2])
    rotation = Rotation.from_rotvec(axis / np.linalg.norm(axis, axis=1, keepdims=True) * angle[:, None]).as_matrix()
    turned = np.einsum("fij,fnj->fni", rotation, points)
    assume((turned[..., 2] > 800).all())
    seen = turned[..., :2] / turned[..., 2:] * focal
    radius = _radius(seen, confidence.numpy(), count_root=True)
    assert normal.rotation is not None
    np.testing.assert_allclose(normal.rotation.numpy(), rotation, atol=1e-9)
    np.testing.assert_allclose(normal.keypoints.numpy(), seen / radius[:, None, None], atol=1e-7)
    np.testing.assert_allclose(normal.scale_px.numpy(), radius, rtol=1e-7)

    # And the body itself, in units and at the distance found, projects to exactly these keypoints.
    unit = radius * np.linalg.norm(root, axis=1) / focal
    np.testing.assert_allclose(normal.distance.numpy(), np.linalg.norm(root, axis=1) / unit, rtol=1e-7)
    pose = torch.from_numpy((turned - turned[:, [ROOT]]) / unit[:, None, None])
    torch.testing.assert_close(Perspective().project(pose, normal.distance), normal.keypoints, rtol=0, atol=1e-7)


def test_rotation_is_proper_and_nothing_at_the_centre():
    keypoints, confidence = _frames(3)
    rotation = normalise(keypoints, confidence, ROOT, intrinsics=Intrinsics(900.0, (10.0, 990.0))).rotation
    assert rotation is not None
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3, dtype=torch.float64).expand(5, 3, 3))
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(5, dtype=torch.float64))
    centred = keypoints - keypoints[:, ROOT, None] + 500
    rotation = normalise(centred, confidence, ROOT, intrinsics=Intrinsics(900.0, (500.0, 500.0))).rotation
    assert rotation is not None
    torch.testing.assert_close(rotation, torch.eye(3, dtype=torch.float64).expand(5, 3, 3))


@given(seed=SEEDS)
@settings(max_examples=20, deadline=None)
def test_renormalise_leaves_what_is_normal(seed):
    keypoints, confidence = _frames(seed, 0.3)
    normal = normalise(keypoints, confidence, ROOT).keypoints
    again, radius = renormalise(normal, confidence, ROOT)
    torch.testing.assert_close(radius, torch.ones(5, dtype=torch.float64), rtol=0, atol=1e-7)
    torch.testing.assert_close(again, normal, rtol=0, atol=1e-7)
    moved, radius = renormalise(normal * 3 + 1, confidence, ROOT)
    torch.testing.assert_close(radius, torch.full((5,), 3.0, dtype=torch.float64), rtol=1e-6, atol=0)
    seen = confidence[..., None] > 0
    torch.testing.assert_close(moved * seen, normal, rtol=0, atol=1e-7)


def test_a_frame_without_extent_stays_finite():
    keypoints = torch.full((2, 9, 2), 7.0)
    for confidence in (torch.ones(2, 9), torch.zeros(2, 9)):
        normal = normalise(keypoints, confidence, ROOT, intrinsics=Intrinsics(900.0, (500.0, 500.0)))
        assert normal.keypoints.isfinite().all() and normal.distance.isfinite().all()


def test_what_is_behind_the_turned_camera_is_held_at_a_twentieth_of_the_focal_length():
    """A root 60 degrees to the right, joints 60 and 80 degrees to the left: 120 and 140 degrees apart."""
    off = torch.tensor([[60.0, -60, -80, 0]], dtype=torch.float64).deg2rad()
    keypoints = torch.stack([100 * off.tan(), torch.zeros(1, 4)], -1)
    normal = normalise(keypoints, torch.ones(1, 4).double(), 0, intrinsics=Intrinsics(100.0, (0.0, 0.0)))
    x = (off - off[0, 0]).sin() / off.cos()  # of rays (tan, 0, 1), turned
    expected = 100 * x / ((off - off[0, 0]).cos() / off.cos()).clamp_min(0.05)
    torch.testing.assert_close(normal.keypoints[..., 0] * normal.scale_px, expected, rtol=1e-6, atol=1e-6)
