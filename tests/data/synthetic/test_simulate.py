"""Bodies that hold together, before cameras that see them exactly, for every shipped skeleton."""

from __future__ import annotations

import numpy as np
import pytest

from uplift.config.files import shipped_names
from uplift.data.synthetic.human_motion import ACTIONS
from uplift.data.synthetic.simulate import build_body, rest_pose, simulate
from uplift.errors import UserError
from uplift.skeleton import Skeleton, load_skeleton

NAMES = [name for name in shipped_names("skeletons") if load_skeleton(name).body]
HUMANS = [name for name in NAMES if build_body(load_skeleton(name)).unit == "mm"]
FRAMES = 1500


@pytest.fixture(scope="module", params=NAMES)
def case(request):
    skeleton = load_skeleton(request.param)
    return skeleton, simulate(skeleton, FRAMES, seed=3)


def handedness(skeleton: Skeleton, pose: np.ndarray) -> np.ndarray:
    """Return the sign of (up x front) . left."""
    vectors = {name: np.einsum("j,fjk->fk", skeleton.facing_matrix(name), pose) for name in skeleton.facing}
    up = vectors.get("up", np.array([0.0, -1.0, 0.0]))
    return np.sign((np.cross(up, vectors["front"]) * vectors["left"]).sum(-1))


def bone_lengths(skeleton: Skeleton, pose: np.ndarray) -> np.ndarray:
    parent, child = skeleton.bone_indices.T
    return np.linalg.norm(pose[:, child] - pose[:, parent], axis=-1)


def test_layout(case):
    skeleton, data = case
    assert len(data) == FRAMES
    assert data.joint_names == skeleton.joints
    assert data.pose.shape == (FRAMES, len(skeleton.joints), 3)
    assert np.abs(data.pose[:, skeleton.root_index]).max() == 0
    assert all(np.isfinite(value).all() for value in (data.keypoints, data.pose, data.root))
    assert set(data.identity) == {"subject", "action", "sequence", "camera", "frame"}
    assert len(np.unique(data.clips())) == FRAMES // 30


def test_projection_is_exact(case):
    _, data = case
    points = (data.pose + data.root[:, None]).astype(float)
    assert points[..., 2].min() > 0
    seen = points[..., :2] / points[..., 2:] * data.focal_px + 500
    assert np.abs(seen - data.keypoints).max() < 1e-3


def test_the_body_is_in_the_picture(case):
    _, data = case
    assert data.keypoints.min() >= 0
    assert data.keypoints.max() <= 1000


def test_handedness(case):
    skeleton, data = case
    assert (handedness(skeleton, data.pose) > 0).mean() > 0.99
    mirrored = data.pose * np.array([1, 1, -1])
    assert (handedness(skeleton, mirrored) > 0).mean() < 0.01


def test_the_same_seed_gives_the_same_frames(case):
    skeleton, data = case
    again, other = simulate(skeleton, FRAMES, seed=3), simulate(skeleton, FRAMES, seed=4)
    np.testing.assert_array_equal(again.keypoints, data.keypoints)
    np.testing.assert_array_equal(again.pose, data.pose)
    assert np.abs(other.keypoints - data.keypoints).mean() > 1


def test_rest_pose_is_upright_and_mirror_symmetric(case):
    skeleton, _ = case
    rest = rest_pose(skeleton)
    assert handedness(skeleton, rest[None])[0] > 0
    for right, left in skeleton.mirror:
        one, other = rest[skeleton.index(right)], rest[skeleton.index(left)]
        middle = rest[[skeleton.index(joint) for pair in skeleton.mirror for joint in pair], 0].mean()
        np.testing.assert_allclose(one - [middle, 0, 0], (other - [middle, 0, 0]) * [-1, 1, 1], atol=1e-6)


@pytest.mark.parametrize("name", ["h36m17", "quadruped28", "rat23", "hand21", "chair10"])
def test_limbs_are_rigid_within_a_body_and_differ_between_bodies(name):
    skeleton = load_skeleton(name)
    data = simulate(skeleton, 600, seed=1, subjects=4)
    lengths = bone_lengths(skeleton, data.pose.astype(float))
    if name == "h36m17":
        limbs = [i for i, (_, child) in enumerate(skeleton.bones) if child[0] in "rl" and "shoulder" not in child]
        lengths = lengths[:, limbs]
    if name == "rat23":
        tree = [i for i, (parent, child) in enumerate(skeleton.bones) if skeleton.parents[child] == parent]
        lengths = lengths[:, tree]
    means = []
    for subject in np.unique(data.identity["subject"]):
        own = lengths[data.identity["subject"] == subject]
        assert (own.std(0) / own.mean(0)).max() < 1e-4
        means.append(own.mean(0) / own.mean())
    assert len(means) > 1
    assert np.std(means, axis=0).max() > 0.005


def test_left_and_right_differ_by_little():
    skeleton = load_skeleton("h36m17")
    data = simulate(skeleton, 900, seed=2)
    lengths = dict(zip([bone[1] for bone in skeleton.bones], bone_lengths(skeleton, data.pose).T, strict=True))
    for joint in ("knee", "ankle", "elbow", "wrist"):
        difference = np.abs(lengths[f"l{joint}"] / lengths[f"r{joint}"] - 1)
        assert 0 < difference.mean() < 0.03


def test_gravity_is_where_the_tilt_says():
    data = simulate(load_skeleton("openpose25"), 3000, seed=0, mode=["stand"], tilt_deg=(20.0, 8.0))
    assert abs(data.tilt_deg.mean() - 20) < 2.5
    tilt = np.radians(data.tilt_deg)
    gravity = np.stack([np.zeros_like(tilt), np.cos(tilt), np.sin(tilt)], -1)
    place = data.joint_names.index
    down = data.pose[:, [place("LHeel"), place("RHeel")]].mean(1) - data.pose[:, place("Neck")]
    upright = (down * gravity).sum(-1) / np.linalg.norm(down, axis=-1)
    assert upright.mean() > 0.97
    assert (down / np.linalg.norm(down, axis=-1, keepdims=True)).mean(0)[2] > 0.25


def test_no_gravity_views_turn_every_way():
    data = simulate(load_skeleton("hand21"), 6000, seed=0)
    assert data.tilt_deg is None
    finger = data.pose[:, data.joint_names.index("middle_mcp")]
    direction = finger / np.linalg.norm(finger, axis=-1, keepdims=True)
    assert np.abs(direction.mean(0)).max() < 0.15
    np.testing.assert_allclose((direction**2).mean(0), 1 / 3, atol=0.08)


def test_azimuth_is_uniform():
    data = simulate(load_skeleton("h36m17"), 9000, seed=0)
    across = data.pose[:, data.joint_names.index("lhip")] - data.pose[:, data.joint_names.index("rhip")]
    angle = np.arctan2(across[:, 2], across[:, 0])
    counts = np.histogram(angle, 8, (-np.pi, np.pi))[0]
    assert counts.min() > 0.6 * counts.mean()


def test_frames_follow_smoothly():
    data = simulate(load_skeleton("h36m17"), 3000, seed=0, fps=30.0, clip_seconds=2.0)
    joints = data.pose + data.root[:, None]
    same = data.identity["sequence"][1:] == data.identity["sequence"][:-1]
    step = np.linalg.norm(np.diff(joints, axis=0), axis=-1)[same]
    # A fist or a foot reaches 10 m/s and more in sport.
    assert np.quantile(step, 0.99) < 15e3 / 30
    assert step.max() < 35e3 / 30
    assert np.median(step) > 1


@pytest.mark.parametrize("name", HUMANS)
def test_a_person_has_human_proportions(name):
    skeleton = load_skeleton(name)
    rest, names = rest_pose(skeleton), {joint.lower().replace("left_", "l"): joint for joint in skeleton.joints}
    place = [skeleton.index(names[key]) for key in ("lhip", "lknee", "lankle", "lshoulder", "lelbow", "lwrist")]
    hip, knee, ankle, shoulder, elbow, wrist = rest[place]
    assert np.linalg.norm(hip - knee) == pytest.approx(0.245, abs=0.015)
    assert np.linalg.norm(knee - ankle) == pytest.approx(0.246, abs=0.015)
    assert 0.5 < np.linalg.norm(elbow - wrist) / np.linalg.norm(shoulder - elbow) < 1


def test_knees_bend_one_way_only():
    data = simulate(load_skeleton("h36m17"), 6000, seed=5, mode=[name for name in ACTIONS if name != "lie"])
    at = {name: data.pose[:, place].astype(float) for place, name in enumerate(data.joint_names)}
    across = at["lhip"] - at["rhip"]
    for side in "rl":
        thigh, shank = at[f"{side}knee"] - at[f"{side}hip"], at[f"{side}ankle"] - at[f"{side}knee"]
        cosine = (thigh * shank).sum(-1) / np.linalg.norm(thigh, axis=-1) / np.linalg.norm(shank, axis=-1)
        assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < 147
        # Turned outward or lifted aside, the hinge leaves the pelvis's axis: not every frame, but nearly.
        assert ((np.cross(thigh, shank) * across).sum(-1) > 0).mean() > 0.97


def test_feet_are_on_the_floor():
    data = simulate(load_skeleton("openpose25"), 1200, seed=0, mode=["walk", "stand", "squat"], tilt_deg=(0.0, 0.0))
    feet = [place for place, name in enumerate(data.joint_names) if "Heel" in name or "Toe" in name]
    height = (data.pose + data.root[:, None])[..., 1]
    lowest = height[:, feet].max(1)
    assert (lowest >= height.max(1) - 1).mean() > 0.98
    for clip in np.unique(data.identity["sequence"]):
        assert np.ptp(lowest[data.identity["sequence"] == clip]) < 25


def test_every_action_and_its_name():
    skeleton = load_skeleton("h36m17")
    for name in ACTIONS:
        data = simulate(skeleton, 30, seed=0, mode=[name])
        assert set(data.identity["action"]) == {name}
    assert set(simulate(skeleton, 20000, seed=0).identity["action"]) == set(ACTIONS)


def test_noise_and_missing():
    skeleton = load_skeleton("h36m17")
    clean = simulate(skeleton, 900, seed=0)
    noisy = simulate(skeleton, 900, seed=0, noise_px=3.0, missing=0.2)
    np.testing.assert_array_equal(noisy.pose, clean.pose)
    seen = noisy.confidence > 0
    assert abs((~seen).mean() - 0.2) < 0.02
    assert (noisy.keypoints[~seen] == 0).all()
    assert abs((noisy.keypoints - clean.keypoints)[seen].std() - 3) < 0.2


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"mode": ["wlak"]}, "Did you mean 'walk'"),
        ({"mode": []}, "empty list"),
        ({"frames": 0}, "frames=0"),
        ({"missing": 1.0}, "missing=1.0"),
        ({"tilt_deg": (5.0, -1.0)}, "tilt_deg"),
        ({"clip_seconds": 0.0}, "clip_seconds=0"),
    ],
)
def test_wrong_settings(settings, words):
    with pytest.raises(UserError, match=words.replace("(", r"\(")):
        simulate(load_skeleton("h36m17"), **{"frames": 30, **settings})
