"""The ground: an exact walk with noisy depths, turned cameras, and motions that have no ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from walks import FEET, FPS, GRAVITY, HIP, SKELETON, walk

from uplift.data.poses import PoseData
from uplift.models.ground import Grounded, contact_joints, put_on_ground
from uplift.skeleton import Skeleton


def data_of(points: np.ndarray, **changed) -> PoseData:
    frames = len(points)
    identity = {"sequence": np.full(frames, "walk"), "frame": np.arange(frames)}
    ones = np.ones((frames, 17), np.float32)
    data = PoseData(np.zeros((frames, 17, 2), np.float32), ones, SKELETON.joints, identity=identity, fps=FPS)
    return replace(data, **changed)


def grounded(points: np.ndarray, seen: np.ndarray, gravity: np.ndarray = GRAVITY, **changed) -> Grounded:
    """Return lifted ``points`` on the ground, keypoints those of ``seen``."""
    root = points[:, HIP]
    rays = seen[..., :2] / seen[..., 2:]
    down = np.tile(gravity, (len(points), 1))
    return put_on_ground(points - root[:, None], root, down, data_of(points, **changed), rays, SKELETON)


def noisy(exact: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return points whose depths are wrong as those of lifters are: roots by 60 mm, joints by 40, from frame to frame alike."""
    random = np.random.default_rng(seed)
    smooth = [np.exp(-0.5 * (np.arange(-9, 10) / 3) ** 2)]
    smooth = smooth[0] / np.linalg.norm(smooth[0])
    frames = len(exact)
    of_root = np.convolve(random.normal(size=frames + 18), smooth, "valid") * 60
    of_joint = np.stack([np.convolve(random.normal(size=frames + 18), smooth, "valid") for _ in range(17)], 1) * 40
    of_joint[:, HIP] = 0
    far = np.linalg.norm(exact, axis=-1, keepdims=True)
    return exact * (1 + (of_root[:, None] + of_joint)[..., None] / far)


def bones(points: np.ndarray) -> np.ndarray:
    one, other = SKELETON.bone_indices.T
    return np.linalg.norm(points[:, other] - points[:, one], axis=-1)


def slides(points: np.ndarray, stands: np.ndarray) -> float:
    """Return the mean way of a foot in steps in which it stands in both frames."""
    way = np.linalg.norm(np.diff(points[:, FEET], axis=0), axis=-1)
    return float(way[stands[1:] & stands[:-1]].mean())


def error(points: np.ndarray, true: np.ndarray) -> float:
    """Return the mean error of paths after the best shift."""
    off = points - true
    return float(np.linalg.norm(off - off.mean(0), axis=-1).mean())


@pytest.mark.parametrize("seed", [0, 1])
def test_feet_of_a_noisy_walk_stay_bones_keep_and_the_root_gets_better(seed: int):
    exact, stands, height = walk()
    lifted = noisy(exact, seed)
    found = grounded(lifted, exact)
    points = found.pose + found.root[:, None]
    assert found.ground is not None
    contact = found.ground.contact[:, FEET]
    assert (contact == stands).mean() > 0.9
    assert slides(lifted, stands) > 10
    assert slides(points, stands & contact) < 0.2
    assert slides(points, stands) < 3
    np.testing.assert_allclose(bones(points), bones(lifted), atol=0.5)
    assert error(found.root, exact[:, HIP]) < 0.75 * error(lifted[:, HIP], exact[:, HIP])
    assert error(points[:, FEET], exact[:, FEET]) < 0.75 * error(lifted[:, FEET], exact[:, FEET])
    seen = np.linalg.norm(points[..., :2] / points[..., 2:] - exact[..., :2] / exact[..., 2:], axis=-1)
    assert 1145 * seen.mean() < 6  # px
    np.testing.assert_allclose(found.ground.normal, found.ground.normal[:1].repeat(len(points), 0))
    assert np.degrees(np.arccos(-found.ground.normal[0] @ GRAVITY)) < 2
    assert abs(-found.ground.point[0] @ found.ground.normal[0] - height) < 60
    assert not (points[:, FEET] @ -found.ground.normal[0] > height + 120).any()
    assert found.notes[0].startswith("ground: 1,") and "sliding" in found.notes[0]


def test_an_exact_walk_stays_as_it_is():
    exact, stands, height = walk()
    found = grounded(exact, exact)
    assert found.ground is not None
    assert np.abs(found.pose + found.root[:, None] - exact).max() < 15
    assert (found.ground.contact[:, FEET] == stands).mean() > 0.93
    assert abs(-found.ground.point[0] @ found.ground.normal[0] - height) < 10


def test_turning_the_camera_turns_the_result():
    exact, _, _ = walk(60)
    lifted, turn = noisy(exact), Rotation.from_euler("xyz", [0.15, -0.2, 0.3])
    seen_turned = turn.apply(exact.reshape(-1, 3)).reshape(exact.shape)
    straight = grounded(lifted, exact)
    turned = grounded(turn.apply(lifted.reshape(-1, 3)).reshape(exact.shape), seen_turned, turn.apply(GRAVITY))
    assert straight.ground is not None and turned.ground is not None
    np.testing.assert_array_equal(turned.ground.contact, straight.ground.contact)
    np.testing.assert_allclose(turned.root, turn.apply(straight.root), atol=0.05)
    np.testing.assert_allclose(turned.ground.normal, turn.apply(straight.ground.normal), atol=1e-5)
    np.testing.assert_allclose(turned.pose, turn.apply(straight.pose.reshape(-1, 3)).reshape(exact.shape), atol=0.05)


def test_outliers_and_missing_joints_do_not_move_standing_feet():
    exact, stands, _ = walk()
    random = np.random.default_rng(2)
    seen = exact.copy()
    wild = random.random(exact.shape[:2]) < 0.03
    seen[wild] += random.normal(size=(int(wild.sum()), 3)) * [200, 200, 0]
    confidence = (random.random(exact.shape[:2]) > 0.1).astype(np.float32)
    lifted = noisy(exact)
    lifted[50] = np.nan  # a frame that was not lifted
    found = grounded(lifted, seen, confidence=confidence)
    assert found.ground is not None and not found.ground.contact[50].any()
    assert np.isnan(found.pose[50]).all()
    known = np.arange(len(exact)) != 50
    contact = stands & found.ground.contact[:, FEET]
    assert contact[known].sum() > 0.6 * stands[known].sum()
    points = found.pose + found.root[:, None]
    way = np.linalg.norm(np.diff(points[:, FEET], axis=0), axis=-1)[contact[1:] & contact[:-1]]
    assert np.median(way) < 0.2


def swimming(frames: int = 80) -> np.ndarray:
    """Return a body whose limbs never rest."""
    exact = walk(frames).points
    time = np.arange(frames)[:, None] / FPS
    sway = np.stack(
        [np.sin(6 * time + np.arange(17)), np.cos(5 * time + np.arange(17)), np.sin(4 * time)[:, [0] * 17]], -1
    )
    return exact + 400 * sway


@pytest.mark.parametrize(
    ("points", "changed", "why"),
    [
        (swimming(), {}, "no foot stands still for long"),
        (walk(40).points, {"identity": {}}, "no clip has 5 frames"),
        (walk(40).points, {"stills": True}, "no clip has 5 frames"),
        (walk(3).points, {}, "no clip has 5 frames"),
    ],
)
def test_what_has_no_ground_stays_as_it_was_and_says_why(points: np.ndarray, changed: dict, why: str):
    found = grounded(points, points, **changed)
    assert found.ground is None
    np.testing.assert_allclose(found.pose, points - points[:, [HIP]])
    np.testing.assert_allclose(found.root, points[:, HIP])
    assert len(found.notes) == 1 and why in found.notes[0]


def test_clips_are_solved_apart():
    exact = walk(60).points
    lifted = np.concatenate([noisy(exact), swimming(60)])
    seen = np.concatenate([exact, swimming(60)])
    identity = {"sequence": np.repeat(["walk", "swim"], 60), "frame": np.tile(np.arange(60), 2)}
    both, alone = grounded(lifted, seen, identity=identity), grounded(noisy(exact), exact)
    assert both.ground is not None and alone.ground is not None
    np.testing.assert_allclose(both.root[:60], alone.root, atol=5)
    assert np.isnan(both.ground.point[60:]).all() and not both.ground.contact[60:].any()
    assert "1 of 2 clips are as lifted: no foot stands still for long" in both.notes[-1]


def test_without_contacts_the_lowest_ends_of_limbs_are_taken():
    points, gravity = walk(50).points, np.tile(GRAVITY, (50, 1))
    bare = replace(SKELETON, contacts=())
    assert contact_joints(bare, points, gravity).tolist() == sorted(FEET)
    assert contact_joints(SKELETON, points, gravity).tolist() == FEET
    chain = Skeleton("chain", ("a", "b", "c"), "b", (("b", "a"), ("b", "c")))
    upright = np.array([[[0, 100.0, 0], [0, 0, 0], [0, -100, 0]]])
    assert contact_joints(chain, upright, np.array([[0, 1.0, 0]])).tolist() == [0]


def test_without_a_frame_rate_one_is_assumed_and_said():
    exact = walk().points
    found = grounded(exact, exact, fps=None)
    assert found.ground is not None and "the frame rate is not known" in found.notes[1]
