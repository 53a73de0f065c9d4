"""Millimetres from a known length, a height, or the camera's height over the ground; and constant bones."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import body_arrays

from uplift.data.synthetic.simulate import simulate
from uplift.errors import UserError
from uplift.geometry.lens import place_roots
from uplift.models.metric_scale import (
    CameraHeight,
    KnownLength,
    median_by_body,
    mm_by_camera_height,
    mm_per_unit,
    size_from,
)
from uplift.models.predict import with_constant_bones
from uplift.skeleton import Skeleton, load_skeleton

SKELETON = load_skeleton("h36m17")
ARRAYS = body_arrays(60)
POSE = ARRAYS["pose"].astype(np.float64)


def lengths(pose: np.ndarray) -> np.ndarray:
    return np.linalg.norm(pose[:, SKELETON.bone_indices[:, 1]] - pose[:, SKELETON.bone_indices[:, 0]], axis=-1)


def test_a_known_bone_brings_poses_of_any_scale_back():
    scale = np.random.default_rng(0).uniform(0.1, 3, 60)
    thighs = [np.linalg.norm(POSE[0, SKELETON.index(k)] - POSE[0, SKELETON.index(h)]) for h, k in
              (("rhip", "rknee"), ("lhip", "lknee"))]  # fmt: skip
    size = KnownLength(("rhip", "rknee"), float(np.mean(thighs)))  # of a way and its mirror image the mean counts
    factor = mm_per_unit(POSE * scale[:, None, None], SKELETON, np.zeros(60, int), size)
    np.testing.assert_allclose(factor * scale, 1, rtol=1e-5)


def test_one_wrong_frame_does_not_change_the_size_of_the_others():
    pose, size = POSE.copy(), KnownLength(("hip", "spine", "thorax"), 500.0)
    before = mm_per_unit(pose, SKELETON, np.zeros(60, int), size)
    pose[3, SKELETON.index("spine")] += 1000
    after = mm_per_unit(pose, SKELETON, np.zeros(60, int), size)
    np.testing.assert_allclose(np.delete(after, 3), np.delete(before, 3), rtol=1e-9)


def test_bodies_of_other_proportions_have_their_own_share():
    pose = np.concatenate([POSE, POSE])
    knee, hip, ankle = (SKELETON.index(name) for name in ("rknee", "rhip", "rankle"))
    move = 0.5 * (pose[60:, knee] - pose[60:, hip])
    pose[60:, knee] += move
    pose[60:, ankle] += move
    body = np.repeat([0, 1], 60)
    size = KnownLength(("rhip", "rknee"), 400.0)
    both, alone = mm_per_unit(pose, SKELETON, body, size), mm_per_unit(POSE, SKELETON, body[:60], size)
    np.testing.assert_allclose(both[:60], alone, rtol=1e-9)
    assert (both[60:] < 0.9 * alone).all()


def test_frames_without_a_pose_stay_without_a_size():
    pose = POSE.copy()
    pose[5] = np.nan
    factor = mm_per_unit(pose, SKELETON, np.zeros(60, int), KnownLength(("rhip", "rknee"), 400.0))
    assert np.isnan(factor[5])
    assert np.isfinite(np.delete(factor, 5)).all()


def test_the_height_of_the_camera_tells_the_size_of_those_who_stand():
    data = simulate(SKELETON, 600, seed=3)
    assert data.pose is not None and data.root is not None and data.tilt_deg is not None
    pose, rays = data.pose.astype(np.float64), data.rays()
    assert rays is not None
    tilt = np.radians(data.tilt_deg)
    gravity = np.stack([np.zeros_like(tilt), np.cos(tilt), np.sin(tilt)], -1)
    feet = np.einsum("fjc,fc->fj", pose + data.root[:, None], gravity).max(1)
    clips = data.clips()
    heights = np.array([np.median(feet[clips == clip]) for clip in clips])
    shrunk = pose * np.random.default_rng(1).uniform(0.2, 0.4, len(pose))[:, None, None]
    place = shrunk + place_roots(shrunk, rays, data.confidence)[:, None]
    found = []
    for clip in np.unique(clips):
        rows = clips == clip
        if rows.sum() < 20 or np.ptp(feet[rows]) > 100 or feet[rows].min() < 300:
            continue
        size = CameraHeight(float(heights[rows][0]))
        factor = mm_by_camera_height(shrunk[rows], place[rows], gravity[rows], SKELETON, clips[rows], size)
        found.append(np.median(lengths(shrunk[rows] * factor[:, None, None]).sum(1) / lengths(pose[rows]).sum(1)))
    assert len(found) > 2
    assert np.abs(np.array(found) - 1).max() < 0.06


def test_the_size_is_the_median_over_the_frames_of_a_body_that_are_below_the_camera():
    """Frame by frame: a size in mm is all bones' length times the camera's height over how far the lowest joint is below."""
    rng = np.random.default_rng(4)
    pose = POSE[:8] * rng.uniform(0.5, 2, (8, 1, 1))
    body = np.array([0, 0, 0, 0, 1, 1, 1, 2])
    gravity = np.array([0.0, 0.8, 0.6])
    place = pose + rng.uniform(500, 3000, (8, 1))[..., None] * gravity + [3000, 0, 0]
    place[1] -= 9000 * gravity  # above the camera
    place[3, 5] = np.nan  # one joint without a place
    place[7] -= 9000 * gravity  # a body that is always above it: the median of the others
    total, sizes = lengths(pose).sum(1), np.full(8, np.nan)
    for frame in range(8):
        below = max(float(joint @ gravity) for joint in place[frame] if np.isfinite(joint).all())
        sizes[frame] = 1600 / below * total[frame] if below > 0 else np.nan
    expected = [np.nanmedian(sizes[body == one]) if one < 2 else np.nanmedian(sizes) for one in body]
    found = mm_by_camera_height(pose, place, np.tile(gravity, (8, 1)), SKELETON, body, CameraHeight(1600.0))
    np.testing.assert_allclose(found, expected / total)


def test_half_of_the_frames_below_the_camera_are_enough():
    gravity = np.tile([0.0, 1.0, 0.0], (4, 1))
    place = POSE[:4] + np.array([[[0, 9000.0, 0]], [[0, 9000, 0]], [[0, -9000, 0]], [[0, -9000, 0]]])
    size = CameraHeight(1500.0)
    assert np.isfinite(mm_by_camera_height(POSE[:4], place, gravity, SKELETON, np.arange(4), size)).all()
    with pytest.raises(UserError, match="above the camera"):
        mm_by_camera_height(POSE[1:4], place[1:], gravity[1:], SKELETON, np.arange(3), size)


def test_medians_are_of_what_is_known_of_a_body():
    values = np.array([[1.0, 5], [3, np.nan], [8, 7], [np.nan, np.nan]])
    found = median_by_body(values, np.array([0, 0, 0, 1]))
    np.testing.assert_array_equal(found[:3], [[3, 6]] * 3)
    assert np.isnan(found[3]).all()


def test_bodies_over_the_camera_tell_no_size():
    place = POSE + np.array([0, -9000.0, 3000.0])
    gravity = np.tile([0.0, 1.0, 0.0], (60, 1))
    with pytest.raises(UserError, match="above the camera in most frames"):
        mm_by_camera_height(POSE, place, gravity, SKELETON, np.zeros(60, int), CameraHeight(1500.0))


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"bone": ("rhip", "rknee")}, "go together"),
        ({"bone_mm": 400.0}, "go together"),
        ({"bone": ("rhip", "rkne"), "bone_mm": 400.0}, "no joint 'rkne'. Did you mean 'rknee'"),
        ({"bone": ("rhip",), "bone_mm": 400.0}, "two or more"),
        ({"bone": ("rhip", "rknee"), "bone_mm": -4.0}, "positive length"),
        ({"bone": ("rhip", "rknee"), "bone_mm": 400.0, "camera_height_mm": 1500.0}, "one of them"),
        ({"camera_height_mm": float("nan")}, "positive length"),
    ],
)
def test_sizes_that_say_nothing(given: dict, says: str):
    with pytest.raises(UserError, match=says):
        size_from(SKELETON, **given)


def test_sizes_of_the_skeleton_file():
    plain = SKELETON.to_dict()
    own = Skeleton.from_dict({**plain, "size": {"along": ["rhip", "rknee"], "mm": 12.5}})
    assert Skeleton.from_dict(own.to_dict()) == own
    assert size_from(own) == KnownLength(("rhip", "rknee"), 12.5)
    assert size_from(own, bone=("lhip", "lknee"), bone_mm=3.0) == KnownLength(("lhip", "lknee"), 3.0)
    tall = Skeleton.from_dict({**plain, "size": {"along": ["rhip", "rknee", "rankle"], "of_height": 0.49}})
    assert size_from(tall) is None
    found = size_from(tall, height_mm=1700.0)
    assert isinstance(found, KnownLength) and found.mm == pytest.approx(833)
    with pytest.raises(UserError, match="does not relate height to its joints"):
        size_from(Skeleton.from_dict({**plain, "size": {}}), height_mm=1700.0)


@pytest.mark.parametrize(
    ("size", "says"),
    [
        ({"along": ["rhip"], "mm": 3}, "two or more"),
        ({"along": ["rhip", "rkne"], "mm": 3}, "'rknee'"),
        ({"along": ["rhip", "rknee"]}, "one of mm, of_height"),
        ({"along": ["rhip", "rknee"], "mm": 3, "of_height": 1}, "one of mm, of_height"),
        ({"along": ["rhip", "rknee"], "mm": "long"}, "positive number"),
        ({"along": ["rhip", "rhip"], "mm": 3}, "twice in a row"),
        ({"lenght": 3}, "unknown key"),
        ([3], "a mapping"),
    ],
)
def test_faults_of_a_size(size: object, says: str):
    with pytest.raises(UserError, match=says):
        Skeleton.from_dict({**SKELETON.to_dict(), "size": size})


def test_bones_become_constant_and_poses_nearer_the_truth():
    noisy = POSE + np.random.default_rng(2).normal(0, 20, POSE.shape)
    noisy -= noisy[:, :1]
    made = with_constant_bones(noisy, SKELETON, np.zeros(60, int))
    share = lengths(made) / lengths(made).sum(1, keepdims=True)
    assert share.std(0).max() < 1e-9
    np.testing.assert_allclose(lengths(made).sum(1), lengths(noisy).sum(1), rtol=1e-9)
    assert (made[:, SKELETON.root_index] == 0).all()
    off = np.linalg.norm(noisy - POSE, axis=-1).mean()
    assert np.linalg.norm(made - POSE, axis=-1).mean() < 0.95 * off  # true bones: what is constant is nearer the truth
    again = with_constant_bones(made, SKELETON, np.zeros(60, int))
    np.testing.assert_allclose(again, made, atol=1e-6)


def test_bones_that_close_loops_are_refused():
    chair = load_skeleton("chair10")
    with pytest.raises(UserError, match="form loops"):
        with_constant_bones(np.ones((2, len(chair.joints), 3)), chair, np.zeros(2, int))
