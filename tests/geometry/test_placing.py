"""The root's place in front of a known camera."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import body_arrays

from uplift.geometry.lens import place_roots

ARRAYS = body_arrays(60)
POSE, ROOT = (ARRAYS[name].astype(np.float64) for name in ("pose", "root"))
SEEN = POSE + ROOT[:, None]
RAYS = SEEN[..., :2] / SEEN[..., 2:]
SURE = np.ones(RAYS.shape[:2])


def test_the_true_pose_is_put_where_it_was():
    np.testing.assert_allclose(place_roots(POSE, RAYS, SURE), ROOT, rtol=1e-6)


def test_a_pose_twice_as_large_is_twice_as_far():
    np.testing.assert_allclose(place_roots(2 * POSE, RAYS, SURE), 2 * ROOT, rtol=1e-6)


def test_the_place_is_that_of_weighted_least_squares():
    rng = np.random.default_rng(1)
    rays, weight = RAYS + rng.normal(0, 0.01, RAYS.shape), rng.uniform(0, 1, SURE.shape).astype(np.float32)
    found = place_roots(POSE, rays, weight)
    for frame in range(60):
        # x + X = ray (z + Z), for x and y of each joint.
        left = np.array([row for x, y in rays[frame] for row in ((1, 0, -x), (0, 1, -y))])
        right = (rays[frame] * POSE[frame, :, 2:] - POSE[frame, :, :2]).ravel()
        root = np.sqrt(np.repeat(weight[frame].astype(float), 2))
        expected = np.linalg.lstsq(left * root[:, None], right * root, rcond=None)[0]
        np.testing.assert_allclose(found[frame], expected, rtol=1e-8)


def test_what_is_not_seen_has_no_say():
    rays, sure = RAYS.copy(), SURE.copy()
    rays[:, 4], sure[:, 4] = 77.0, 0
    rays[:, 5] = np.nan
    np.testing.assert_allclose(place_roots(POSE, rays, sure), ROOT, rtol=1e-6)


def test_noise_moves_it_little_and_doubtful_joints_less():
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.002, RAYS.shape)
    off = np.abs(place_roots(POSE, RAYS + noise, SURE) - ROOT).mean(0)
    assert (off[:2] < 20).all()
    assert off[2] < 200
    wild, sure = RAYS.copy(), SURE.copy()
    wild[:, 3] += 0.05
    sure[:, 3] = 0.05
    heavy, light = (np.abs(place_roots(POSE, wild, weight) - ROOT).mean() for weight in (SURE, sure))
    assert light < 0.2 * heavy


@pytest.mark.parametrize("seen", [0, 2])
def test_too_few_joints_have_no_place(seen: int):
    sure = SURE.copy()
    sure[1, seen:] = 0
    found = place_roots(POSE, RAYS, sure)
    assert np.isnan(found[1]).all()
    assert np.isfinite(np.delete(found, 1, 0)).all()


def test_joints_in_one_point_have_no_place():
    rays = RAYS.copy()
    rays[2] = 0.1
    assert np.isnan(place_roots(POSE, rays, SURE)[2]).all()
