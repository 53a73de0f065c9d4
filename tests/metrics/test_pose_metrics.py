"""Every protocol against a slow loop of its own, and the properties that make a figure trustworthy."""

from __future__ import annotations

import itertools
import math
from functools import partial

import numpy as np
import pytest
import roma
import torch
from beartype import beartype
from jaxtyping import TypeCheckError, jaxtyped
from scipy.linalg import orthogonal_procrustes

from uplift.metrics import pose_metrics as metrics
from uplift.metrics.alignment import ALIGNED_ERRORS, counted, least_squares_scale, norm_scale
from uplift.metrics.pose_metrics import facing_sign, has_handedness
from uplift.metrics.scores import Matched, score
from uplift.skeleton import Skeleton
from uplift.skeleton.core import mirrored_bones

ROOT = 2
BODY = Skeleton.from_dict(
    {
        "name": "stick",
        "joints": ["nose", "rhand", "root", "lhand", "neck", "top"],
        "root": "root",
        "bones": [["root", "neck"], ["neck", "nose"], ["neck", "rhand"], ["neck", "lhand"], ["neck", "top"]],
        "mirror": [["rhand", "lhand"]],
        "facing": {"front": [["neck"], ["nose"]], "left": [["rhand"], ["lhand"]]},
        "gravity": True,
    }
)


def protocol(name: str, pose: np.ndarray, truth: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """Return one protocol, frame by frame, of poses in mm."""
    unseen = np.zeros(pose.shape[:2])
    matched = Matched(pose, truth, counted(pose, truth, weight), unseen, BODY, metric=True, pck=True)
    return score(matched).frames[name]


FLIPPED = ("mpjpe_gt_scale_best_of_flip", "n_mpjpe_best_of_flip", "p_mpjpe_best_of_flip")
ERRORS = {name: partial(protocol, name) for name in (*ALIGNED_ERRORS, *FLIPPED)}
OTHERS = {name: partial(protocol, name) for name in ("pck@150", "pck_z@150", "auc", "stress", "facing")}
SCALED = {name: metric for name, metric in ERRORS.items() if name != "mpjpe"}


def some_poses(frames: int = 30) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pose, truth and weight with at least four joints of six in each frame."""
    rng = np.random.default_rng(3)
    truth = rng.normal(size=(frames, 6, 3)) * 200
    truth -= truth[:, ROOT, None]
    pose = truth + rng.normal(size=truth.shape) * 120
    weight = np.ones((frames, 6))
    for row in weight[::2]:
        row[rng.permutation(6)[:2]] = 0
    return pose, truth, weight


def slow_error(name: str, x: np.ndarray, y: np.ndarray, seen: list[int]) -> float:
    """Return one frame's error by the definition, joint by joint."""
    if name.endswith("_best_of_flip"):
        base = name.removesuffix("_best_of_flip")
        return min(slow_error(base, x, y, seen), slow_error(base, x * [1, 1, -1], y, seen))
    x, y = x[seen], y[seen]
    if name.startswith("p_"):
        return slow_procrustes(x, y, name == "p_mpjpe_reflect")
    others = [place for place, joint in enumerate(seen) if joint != ROOT]
    scale = {
        "mpjpe": 1.0,
        "mpjpe_gt_scale": math.fsum(math.hypot(*y[j, :2]) for j in others)
        / math.fsum(math.hypot(*x[j, :2]) for j in others),
        "n_mpjpe": np.vdot(x, y) / np.vdot(x, x),
        "n_mpjpe_norm": np.linalg.norm(y) / np.linalg.norm(x),
    }[name]
    return sum(math.dist(scale * a, b) for a, b in zip(x, y, strict=True)) / len(seen)


def slow_procrustes(x: np.ndarray, y: np.ndarray, reflect: bool) -> float:
    """Return the error after alignment: scipy's where reflections are allowed, else roma's."""
    x, y = x - x.mean(0), y - y.mean(0)
    if reflect:
        turn = orthogonal_procrustes(x, y)[0]
    else:
        turn = roma.rigid_vectors_registration(torch.from_numpy(x), torch.from_numpy(y)).numpy().T
    scale = np.vdot(x @ turn, y) / np.vdot(x, x)
    return sum(math.dist(a, b) for a, b in zip(scale * x @ turn, y, strict=True)) / len(x)


@pytest.mark.parametrize("name", ERRORS)
def test_errors_are_those_of_a_loop(name):
    pose, truth, weight = some_poses()
    found = ERRORS[name](pose, truth, weight=weight)
    expected = [
        slow_error(name, x, y, [joint for joint in range(6) if w[joint]])
        for x, y, w in zip(pose, truth, weight, strict=True)
    ]
    assert np.allclose(found, expected)


def test_shares_and_stress_are_those_of_a_loop():
    pose, truth, weight = some_poses()
    found = {name: metric(pose, truth, weight=weight) for name, metric in OTHERS.items()}
    for frame, (x, y, w) in enumerate(zip(pose, truth, weight, strict=True)):
        seen = [joint for joint in range(6) if w[joint]]
        off = [math.dist(x[j], y[j]) for j in seen]
        pairs = [abs(math.dist(x[i], x[j]) - math.dist(y[i], y[j])) for i, j in itertools.combinations(seen, 2)]
        curve = [sum(e < t for e in off) / len(off) for t in range(0, 151, 5)]
        assert found["pck@150"][frame] == pytest.approx(curve[-1])
        assert found["auc"][frame] == pytest.approx(sum(curve) / 31)
        assert found["pck_z@150"][frame] == pytest.approx(sum(abs(x[j, 2] - y[j, 2]) < 150 for j in seen) / len(seen))
        assert found["stress"][frame] == pytest.approx(sum(pairs) / len(pairs))
        kept, flipped = (slow_error("p_mpjpe", p, y, seen) for p in (x, x * [1, 1, -1]))
        assert found["facing"][frame] == (kept <= flipped)


def test_signs_are_those_of_a_loop_over_bones_that_leave_the_plane():
    pose, truth, weight = some_poses()
    pose[3, BODY.index("nose"), 2] = pose[3, BODY.index("neck"), 2]
    found = metrics.wrong_signs(pose, truth, weight, BODY)
    for frame, bone in itertools.product(range(len(pose)), range(len(BODY.bones))):
        one, other = (BODY.index(joint) for joint in BODY.bones[bone])
        dx, dy, dz = truth[frame, other] - truth[frame, one]
        counts = weight[frame, one] and weight[frame, other] and abs(dz) > 0.3 * math.hypot(dx, dy, dz)
        depth = pose[frame, other, 2] - pose[frame, one, 2]
        expected = (0.5 if depth == 0 else float((depth > 0) != (dz > 0))) if counts else math.nan
        assert found[frame, bone] == pytest.approx(expected, nan_ok=True)
    assert 0.5 in found and {0, 1} < set(found[np.isfinite(found)])


def test_a_depth_flip_turns_every_sign_and_size_turns_none():
    pose, truth, weight = some_poses()
    found = metrics.wrong_signs(pose, truth, weight, BODY)
    np.testing.assert_array_equal(metrics.wrong_signs(metrics.flip_depth(pose), truth, weight, BODY), 1 - found)
    np.testing.assert_array_equal(metrics.wrong_signs(7 * pose, truth / 9, weight, BODY), found)
    assert np.nansum(metrics.wrong_signs(truth, truth, weight, BODY)) == 0


def test_mpjve_is_that_of_a_loop_and_needs_a_frame_before():
    pose, truth, weight = some_poses(8)
    previous = np.array([-1, 0, 1, -1, 3, 2, -1, 0])
    found = metrics.mpjve(pose, truth, previous, weight)
    for frame, before in enumerate(previous):
        seen = [j for j in range(6) if weight[frame, j] and weight[before, j]]
        steps = [math.dist(pose[frame, j] - pose[before, j], truth[frame, j] - truth[before, j]) for j in seen]
        assert math.isnan(found[frame]) if before < 0 else found[frame] == pytest.approx(sum(steps) / len(steps))


@pytest.mark.parametrize("name", SCALED)
def test_the_truth_at_any_scale_has_no_error(name):
    _, truth, _ = some_poses()
    assert np.allclose(SCALED[name](truth / 321, truth), 0, atol=1e-8)


def test_a_mirrored_pose_costs_unless_the_name_says_otherwise():
    _, truth, _ = some_poses()
    for axis in range(3):
        mirrored = truth.copy()
        mirrored[..., axis] *= -1
        assert (protocol("p_mpjpe", mirrored, truth) > 20).all()
        assert np.allclose(protocol("p_mpjpe_reflect", mirrored, truth), 0, atol=1e-8)
    flipped = metrics.flip_depth(truth)
    assert protocol("facing", truth, truth).all()
    assert not protocol("facing", flipped, truth).any()
    assert np.allclose(protocol("p_mpjpe_best_of_flip", flipped, truth), 0, atol=1e-8)
    assert np.allclose(protocol("n_mpjpe_best_of_flip", flipped, truth), 0, atol=1e-8)


def test_alignment_takes_out_rotation_and_place_only_where_it_says_so():
    pose, truth, _ = some_poses()
    turned = pose @ roma.rotvec_to_rotmat(torch.tensor([0.4, -1.0, 2.0])).double().numpy() + 50
    assert np.allclose(protocol("p_mpjpe", turned, truth), protocol("p_mpjpe", pose, truth))
    assert np.allclose(protocol("p_mpjpe_reflect", turned, truth), protocol("p_mpjpe_reflect", pose, truth))
    assert (protocol("n_mpjpe", turned, truth) > protocol("n_mpjpe", pose, truth)).all()
    deeper = pose + np.array([0, 0, 500])
    assert (protocol("mpjpe_gt_scale", deeper, truth) > protocol("mpjpe_gt_scale", pose, truth)).all()


@pytest.mark.parametrize("metric", [*ERRORS, *OTHERS])
def test_order_of_joints_does_not_matter(metric):
    pose, truth, weight = some_poses()
    order = np.array([5, 1, ROOT, 0, 3, 4])
    function = {**ERRORS, **OTHERS}[metric]
    permuted = function(pose[:, order], truth[:, order], weight=weight[:, order])
    assert np.allclose(permuted, function(pose, truth, weight=weight))


@pytest.mark.parametrize("metric", [*ERRORS, *OTHERS])
@pytest.mark.parametrize("kind", ["zeros", "one point", "line", "flat", "tiny"])
def test_degenerate_predictions_give_numbers(metric, kind):
    _, truth, _ = some_poses()
    pose = {
        "zeros": np.zeros_like(truth),
        "one point": np.full_like(truth, 17.3),
        "line": truth[..., :1] * np.array([1.0, 2.0, -1.0]),
        "flat": truth * [1, 1, 0],
        "tiny": truth * 1e-30,
    }[kind]
    function = {**ERRORS, **OTHERS}[metric]
    assert np.isfinite(function(pose, truth)).all()
    assert np.isfinite(function(truth, pose)).all()
    assert np.isfinite(function(pose.astype(np.float32), truth.astype(np.float32))).all()


def test_a_prediction_of_zeros_scores_the_extent_of_the_truth():
    _, truth, _ = some_poses()
    extent = np.linalg.norm(truth, axis=-1).mean(1)
    centred = np.linalg.norm(truth - truth.mean(1, keepdims=True), axis=-1).mean(1)
    for name, metric in ERRORS.items():
        assert np.allclose(metric(np.zeros_like(truth), truth), centred if name.startswith("p_") else extent)


def test_unknown_joints_do_not_count_and_empty_frames_are_nan():
    pose, truth, _ = some_poses()
    truth[0, 1], pose[1, 3], pose[2] = np.nan, np.inf, np.nan
    weight = counted(pose, truth)
    for metric in (*ERRORS.values(), *OTHERS.values()):
        values = metric(pose, truth)
        assert np.isnan(values[2])
        assert np.isfinite(np.delete(values, 2)).all()
        assert np.allclose(values, metric(pose, truth, weight=weight), equal_nan=True)


def body(turn: float = 0.0) -> np.ndarray:
    """Return one upright body facing the camera, turned about the vertical axis."""
    points = {
        "nose": [0, -10, -1],
        "rhand": [-5, -5, 0],
        "root": [0, 0, 0],
        "lhand": [5, -5, 0],
        "neck": [0, -10, 0],
        "top": [0, -12, 0],
    }
    cos, sin = np.cos(turn), np.sin(turn)
    pose = np.array([points[name] for name in BODY.joints], float)
    return (pose @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]]))[None]


def test_facing_sign_knows_left_from_right_from_every_side():
    assert has_handedness(BODY)
    for turn in np.linspace(0, 2 * np.pi, 9):
        assert facing_sign(body(turn), BODY) == 1
        assert facing_sign(metrics.flip_depth(body(turn)), BODY) == 0
        assert facing_sign(body(turn)[:, BODY.mirror_permutation], BODY) == 0
    unknown = body()
    unknown[0, BODY.index("lhand")] = np.nan
    assert np.isnan(facing_sign(unknown, BODY)).all()


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_facing_sign_does_not_depend_on_the_unit(unit):
    pose = np.random.default_rng(0).normal(size=(200, 6, 3))
    found = facing_sign(pose, BODY)
    assert 0.3 < found.mean() < 0.7
    np.testing.assert_array_equal(facing_sign(pose * unit, BODY), found)


def test_bone_cv_and_symmetry_are_those_of_a_loop():
    rng = np.random.default_rng(5)
    pose = body().repeat(12, 0) + rng.normal(size=(12, 6, 3))
    group = np.array([0, 1, 2] * 4)
    lengths = metrics.bone_lengths(pose, BODY)
    slow = np.array([[math.dist(p[BODY.index(a)], p[BODY.index(b)]) for a, b in BODY.bones] for p in pose])
    assert np.allclose(lengths, slow)
    each = [[slow[group == g, b].std() / slow[group == g, b].mean() for b in range(5)] for g in range(3)]
    assert metrics.bone_cv(lengths, group) == pytest.approx(np.mean(each))
    pairs = mirrored_bones(BODY)
    assert [[BODY.bones[b][1] for b in pair] for pair in pairs] == [["rhand", "lhand"]]
    expected = [abs(row[2] - row[3]) / ((row[2] + row[3]) / 2) for row in slow]
    assert np.allclose(metrics.symmetry(lengths, pairs), expected)
    assert metrics.symmetry(np.zeros((2, 5)), pairs).tolist() == [0, 0]
    assert math.isnan(metrics.bone_cv(lengths[:1], group[:1]))


def test_shapes_are_those_of_the_signatures():
    pose, truth, weight = some_poses()
    for metric in (metrics.stress, least_squares_scale, norm_scale):
        checked = jaxtyped(typechecker=beartype)(metric)
        assert checked(pose, truth, weight).shape == (30,)
        with pytest.raises(TypeCheckError):
            checked(pose, truth[:, :4], weight)
