"""Alignments against independent implementations, and what they do when there is nothing to align."""

from __future__ import annotations

import numpy as np
import pytest
import roma
import torch

from uplift.errors import UserError
from uplift.metrics.alignment import (
    ALIGNED_ERRORS,
    align,
    counted,
    least_squares_scale,
    norm_scale,
    procrustes,
    xy_scale,
)

JOINTS = 9


def poses(kind: str, frames: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Return (pose, truth) of a kind that makes alignment hard."""
    rng = np.random.default_rng(7)
    truth = rng.normal(size=(frames, JOINTS, 3)) * 300
    pose = truth / 250 + rng.normal(size=truth.shape) * 0.3
    match kind:
        case "unrelated":
            pose = rng.normal(size=truth.shape)
        case "mirrored":
            pose = pose * [1, 1, -1]
        case "nearly flat":
            pose[..., 2] *= 1e-6
        case "flat":
            pose[..., 2] = 0
        case "nearly on a line":
            pose[..., 1:] *= 1e-5
        case "far off":
            pose = pose + 1e4
    return pose, truth


KINDS = ["close", "unrelated", "mirrored", "nearly flat", "flat", "nearly on a line", "far off"]


def mean_error(pose: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.sqrt(((pose - truth) ** 2).sum(-1)).mean(1)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "nearly on a line"])
def test_procrustes_is_that_of_skimage(kind):
    transform = pytest.importorskip("skimage.transform").SimilarityTransform
    pose, truth = poses(kind)
    expected = np.stack([transform.from_estimate(x, y)(x) for x, y in zip(pose, truth, strict=True)])
    assert np.allclose(procrustes(pose, truth), expected, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_procrustes_is_that_of_roma(kind):
    pose, truth = poses(kind)
    x, y = torch.from_numpy(pose), torch.from_numpy(truth)
    turn, shift, scale = roma.rigid_points_registration(x, y, compute_scaling=True)
    expected = scale[:, None, None] * (x @ turn.transpose(1, 2)) + shift[:, None]
    assert np.allclose(mean_error(procrustes(pose, truth), truth), mean_error(expected.numpy(), truth), rtol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_procrustes_moves_by_a_proper_similarity(kind):
    pose, truth = poses(kind)
    moved = procrustes(pose, truth)
    before, after = (np.linalg.norm(x[:, :, None] - x[:, None], axis=-1) for x in (pose, moved))
    scale = (before * after).sum((1, 2)) / (before**2).sum((1, 2))
    assert np.allclose(after, scale[:, None, None] * before, atol=1e-6)
    volume_before, volume_after = (np.linalg.det(x[:, 1:4] - x[:, :1]) for x in (pose, moved))
    solid = np.abs(volume_before) > 1e-6
    assert (np.sign(volume_before) == np.sign(volume_after))[solid].all()


def test_no_other_similarity_is_nearer():
    pose, truth = poses("unrelated")
    least = ((procrustes(pose, truth) - truth) ** 2).sum((1, 2))
    moved = procrustes(pose, truth)
    for turn in roma.random_rotvec(200).mul(0.05):
        other = (moved - moved.mean(1, keepdims=True)) @ roma.rotvec_to_rotmat(turn).double().numpy()
        other = other * (1 + 0.1 * float(turn[0])) + moved.mean(1, keepdims=True)
        assert (((other - truth) ** 2).sum((1, 2)) >= least * (1 - 1e-6)).all()


def test_reflection_is_undone_only_where_allowed():
    _, truth = poses("close")
    mirrored = truth * [1, 1, -1] / 7 + 3
    assert np.allclose(procrustes(mirrored, truth, reflect=True), truth)
    assert (mean_error(procrustes(mirrored, truth), truth) > 50).all()


def test_scales_are_those_of_a_loop():
    pose, truth = poses("unrelated")
    weight = (np.random.default_rng(1).random(pose.shape[:2]) > 0.3).astype(float)
    for x, y, w, xy, least, norm in zip(
        pose,
        truth,
        weight,
        xy_scale(pose, truth, 4, weight),
        least_squares_scale(pose, truth, weight),
        norm_scale(pose, truth, weight),
        strict=True,
    ):
        seen = [j for j in range(JOINTS) if w[j]]
        others = [j for j in seen if j != 4]
        assert np.isclose(xy, sum(np.hypot(*y[j, :2]) for j in others) / sum(np.hypot(*x[j, :2]) for j in others))
        assert np.isclose(least, sum(x[j] @ y[j] for j in seen) / sum(x[j] @ x[j] for j in seen))
        assert np.isclose(norm, np.linalg.norm(y[seen]) / np.linalg.norm(x[seen]))


@pytest.mark.parametrize("protocol", ALIGNED_ERRORS)
def test_weight_zero_is_the_joint_left_out(protocol):
    pose, truth = poses("close")
    weight = np.ones(pose.shape[:2])
    weight[:, 5:] = 0
    spoilt = truth.copy()
    spoilt[:, 5:7], spoilt[:, 7:] = 1e6, np.nan
    aligned = align(protocol, pose, spoilt, 0, weight)
    assert np.allclose(aligned[:, :5], align(protocol, pose[:, :5], truth[:, :5], 0))
    assert np.isfinite(aligned).all()


@pytest.mark.parametrize("protocol", [name for name in ALIGNED_ERRORS if name != "mpjpe"])
@pytest.mark.parametrize("factor", [1e-4, 3.0, 1e5])
def test_scale_of_the_prediction_does_not_matter(protocol, factor):
    pose, truth = poses("close")
    assert np.allclose(align(protocol, pose * factor, truth, 0), align(protocol, pose, truth, 0))


@pytest.mark.parametrize("protocol", ALIGNED_ERRORS)
@pytest.mark.parametrize("fill", [0.0, 100.1, -3e7], ids=["zeros", "one point", "one point far off"])
def test_poses_without_extent_stay_finite(protocol, fill):
    _, truth = poses("close")
    aligned = align(protocol, np.full_like(truth, fill), truth, 0)
    assert np.isfinite(aligned).all()
    if protocol.startswith("p_"):
        assert np.allclose(aligned, truth.mean(1, keepdims=True))
    assert np.isfinite(align(protocol, truth, np.full_like(truth, fill), 0)).all()
    assert np.isfinite(align(protocol, truth, truth, 0, np.zeros(truth.shape[:2]))).all()


def test_unknown_protocol_is_refused_with_the_nearest_name():
    pose, truth = poses("close")
    with pytest.raises(UserError, match=r"'pmpjpe'.*'p_mpjpe'"):
        align("pmpjpe", pose, truth, 0)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("odd", [np.nan, np.inf])
def test_a_joint_that_lacks_one_coordinate_does_not_count(axis, odd):
    pose, truth = np.ones((2, 3, 4, 3))
    pose[0, 1, axis], truth[2, 3, axis] = odd, odd
    expected = np.ones((3, 4))
    expected[0, 1] = expected[2, 3] = 0
    np.testing.assert_array_equal(counted(pose, truth), expected)
    np.testing.assert_array_equal(counted(pose, truth, np.full((3, 4), 0.5)), expected / 2)
    np.testing.assert_array_equal(counted(pose, truth, np.full((3, 4), -1.0)), expected * 0)
