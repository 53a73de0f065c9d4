"""Virtual cameras: what is written projects to what is written, nobody leaves the image, y is nearly gravity."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uplift.data.datasets.cmu import Rig, film


def walk(frames: int = 30, stride_mm: float = 300.0, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    body = random.uniform([-400, 0, -300], [400, 1700, 300], (17, 3))
    path = np.arange(frames)[:, None, None] * stride_mm * np.array([0.6, 0, 0.8])
    return (body + path).astype(np.float32)


@given(
    cameras=st.integers(1, 6),
    stride=st.floats(0, 2000),
    width=st.integers(300, 4000),
    height=st.integers(300, 4000),
    focal=st.floats(300, 5000),
    seed=st.integers(0, 1000),
)
def test_every_joint_is_in_front_and_in_the_image(cameras, stride, width, height, focal, seed):
    rig = Rig(cameras=cameras, focal_px=focal, image_size=(width, height))
    views = film(walk(stride_mm=stride, seed=seed), rig, np.random.default_rng(seed))
    assert len(views) == cameras
    for view in views:
        points = view.pose.astype(np.float64) + view.root[:, None]
        assert points[..., 2].min() >= 499
        assert (view.keypoints > 0).all()
        assert (view.keypoints < [width, height]).all()
        again = focal * points[..., :2] / points[..., 2:] + np.array([width, height]) / 2
        assert np.abs(again - view.keypoints).max() < 1e-3
        assert not view.pose[:, 0].any()


def test_the_camera_turns_the_world_and_does_not_mirror_it():
    joints = walk()
    for view in film(joints, Rig(), np.random.default_rng(1)):
        world = (joints - joints[:, :1]).reshape(-1, 3).astype(np.float64)
        seen = view.pose.reshape(-1, 3).astype(np.float64)
        left, _, right = np.linalg.svd(seen.T @ world)
        turn = left @ right
        assert np.linalg.det(turn) > 0.99
        assert np.abs(world @ turn.T - seen).max() < 0.01
        tilt = np.deg2rad(view.tilt_deg)
        assert np.allclose(turn @ [0, -1, 0], [0, np.cos(tilt), np.sin(tilt)], atol=1e-4)


def test_cameras_stand_evenly_round_the_subject():
    rig = Rig(cameras=4, tilt_deg=0.0, tilt_sd_deg=0.0)
    joints = walk(stride_mm=0.0)
    looks = []
    for view in film(joints, rig, np.random.default_rng(2)):
        turn, _ = Rotation.align_vectors(view.pose[0, 1:], (joints - joints[:, :1])[0, 1:])
        looks.append(turn.inv().apply([0, 0, 1]))
    around = np.sort(np.rad2deg(np.arctan2([look[0] for look in looks], [look[2] for look in looks])) % 360)
    gaps = np.diff([*around, around[0] + 360])
    assert gaps.min() >= 60
    assert gaps.max() <= 120


@pytest.mark.parametrize("mean", [-10.0, 0.0, 8.0])
def test_tilts_spread_about_their_mean(mean: float):
    rig = Rig(cameras=2, tilt_deg=mean)
    joints = walk(2)
    tilts = [view.tilt_deg for seed in range(200) for view in film(joints, rig, np.random.default_rng(seed))]
    assert abs(np.mean(tilts) - mean) < 0.4
    assert 1.7 < np.std(tilts) < 2.3
