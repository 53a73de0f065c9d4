"""The metrics of poses, as pure functions: errors against the truth, and plausibility that needs none."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from uplift.metrics.alignment import Poses, Weights, align, clean_pair, length
from uplift.skeleton import Skeleton

__all__ = [
    "bone_cv", "bone_lengths", "facing_sign", "flip_depth", "frame_mean", "has_handedness",
    "joint_errors", "mpjve", "never_seen_so_long", "not_flipped", "share_above", "stress", "symmetry",
    "wrong_signs",
]  # fmt: skip

PerFrame = Float[np.ndarray, " frames"]


def has_handedness(skeleton: Skeleton) -> bool:
    """Return whether the skeleton gives front and left, and up or gravity."""
    given = skeleton.facing
    return "front" in given and "left" in given and ("up" in given or skeleton.gravity)


def facing_sign(pose: Poses, skeleton: Skeleton) -> PerFrame:
    """Return 1 where (up x front) . left is positive, else 0; NaN where a joint it needs is unknown.

    ``pose`` is in the camera frame, in the skeleton's order of joints; up is (0, -1, 0) where the
    skeleton has gravity and gives none. The angle loss of Kudo et al. 2018 with the sign that holds
    in this frame. A pose whose three vectors are coplanar scores 0.
    """
    front, left = (_direction(pose, skeleton, name) for name in ("front", "left"))
    up = _direction(pose, skeleton, "up") if "up" in skeleton.facing else np.array([0.0, -1.0, 0.0])
    hand = (np.cross(up, front) * left).sum(-1)
    return np.where(np.isfinite(hand), (hand > 0).astype(np.float64), np.nan)


def _direction(pose: Poses, skeleton: Skeleton, name: str) -> Float[np.ndarray, "frames 3"]:
    weights = skeleton.facing_matrix(name)
    used = np.flatnonzero(weights)
    return np.einsum("j,fjc->fc", weights[used], pose[:, used].astype(np.float64))


def bone_lengths(pose: Poses, skeleton: Skeleton) -> Float[np.ndarray, "frames bones"]:
    """Return the length of each bone in the order of the skeleton's bones; NaN where an end is unknown."""
    parent, child = skeleton.bone_indices.T
    return length(pose[:, child].astype(np.float64) - pose[:, parent])


def never_seen_so_long(pose: Poses, skeleton: Skeleton) -> float:
    """Return the share of bones that are mostly twice as long or longer than they ever look from the camera.

    Of a body that is seen from many sides every bone is across the line of sight now and then: its median length is
    near the 95th percentile of how long it looks. Where many bones never are, depth was not learned, or the body is
    only ever seen from one side. NaN where no bone is known.
    """
    parent, child = skeleton.bone_indices.T
    bones = pose[:, child].astype(np.float64) - pose[:, parent]
    known = np.isfinite(bones).all((1, 2))
    if not known.any():
        return float("nan")
    true_length = np.median(np.linalg.norm(bones[known], axis=-1), axis=0)
    apparent = np.quantile(np.linalg.norm(bones[known][..., :2], axis=-1), 0.95, axis=0)
    return float((true_length > 2 * np.maximum(apparent, 1e-9)).mean())


def bone_cv(lengths: Float[np.ndarray, "frames bones"], group: Int[np.ndarray, " frames"]) -> float:
    """Return standard deviation / mean of each bone over a subject, averaged over bones, then subjects.

    ``group`` numbers each frame's subject from 0. Bones seen fewer than twice in a subject, or of
    length 0, do not count; NaN if none does.
    """
    per_subject = []
    for number in range(int(group.max(initial=-1)) + 1):
        rows = lengths[group == number]
        seen = np.isfinite(rows)
        count = seen.sum(0)
        mean = np.where(seen, rows, 0).sum(0) / np.maximum(count, 1)
        spread = np.sqrt((np.where(seen, rows - mean, 0) ** 2).sum(0) / np.maximum(count, 1))
        usable = (count > 1) & (mean > 0)
        if usable.any():
            per_subject.append((spread[usable] / mean[usable]).mean())
    return float(np.mean(per_subject)) if per_subject else float("nan")


def symmetry(lengths: Float[np.ndarray, "frames bones"], pairs: Int[np.ndarray, "pairs 2"]) -> PerFrame:
    """Return the mean of |left - right| / their mean length over mirrored bones; NaN where none is known."""
    one, other = lengths[:, pairs[:, 0]], lengths[:, pairs[:, 1]]
    total = one + other
    share = np.divide(2 * np.abs(one - other), total, out=np.zeros_like(total), where=total > 0)
    known = np.isfinite(total)
    count = known.sum(1)
    mean = np.where(known, share, 0).sum(1) / np.maximum(count, 1)
    return np.where(count > 0, mean, np.nan)


# What the protocols that compare a predicted pose with the truth are made of.

AUC_THRESHOLDS_MM = np.linspace(0, 150, 31)

_TIE = 1 + 1e-9
"""Errors of a pose and its depth flip that differ by less than this factor are equal: a flat pose."""

PerJoint = Float[np.ndarray, "frames joints"]


def joint_errors(protocol: str, pose: Poses, truth: Poses, root: int, weight: Weights | None = None) -> PerJoint:
    """Return each joint's distance to the truth, aligned as ``protocol`` (see `align`) says; NaN where unknown."""
    return length(align(protocol, pose, truth, root, weight) - truth)


def frame_mean(values: PerJoint | Weights, weight: Weights) -> PerFrame:
    """Return the weighted mean over joints; NaN for a frame without weight."""
    total, sums = weight.sum(1), (np.where(weight > 0, values, 0) * weight).sum(1)
    return np.divide(sums, total, out=np.full(len(total), np.nan), where=total > 0)


def flip_depth(pose: Poses) -> Poses:
    """Return the pose with z negated: the ambiguity that a single view cannot settle."""
    return pose * np.array([1, 1, -1], pose.dtype)


def not_flipped(kept: PerFrame, flipped: PerFrame) -> PerFrame:
    """Return 1 where the `p_mpjpe` of a pose is at most that of its depth flip, else 0; a flat pose ties: 1."""
    return np.where(np.isfinite(kept), (kept <= flipped * _TIE).astype(np.float64), np.nan)


_OUT_OF_PLANE = 0.3
"""Share of its length by which a bone must leave the image plane for its depth sign to count."""


def wrong_signs(pose: Poses, truth: Poses, weight: Weights, skeleton: Skeleton) -> Float[np.ndarray, "frames bones"]:
    """Return 1 for each bone that leads to the wrong side of the image plane, 0 for the right one, 1/2 for none.

    NaN for bones that do not count: those with an unknown end, and those that leave the plane by at most 0.3 of
    their true length.
    """
    parent, child = skeleton.bone_indices.T
    true, found = truth[:, child] - truth[:, parent], pose[:, child, 2] - pose[:, parent, 2]
    counts = (weight[:, parent] > 0) & (weight[:, child] > 0)
    counts &= np.abs(true[..., 2]) > _OUT_OF_PLANE * length(true)
    return np.where(counts, (1 - np.sign(found) * np.sign(true[..., 2])) / 2, np.nan)


def share_above(errors_mm: PerJoint) -> PerJoint:
    """Return the share of the thresholds 0, 5, ..., 150 mm above each error (MPI-INF-3DHP); at most 30/31, as there."""
    return 1 - np.searchsorted(AUC_THRESHOLDS_MM, errors_mm, side="right") / len(AUC_THRESHOLDS_MM)


def stress(pose: Poses, truth: Poses, weight: Weights | None = None) -> PerFrame:
    """Return the mean absolute difference of all pairwise joint distances (C3DPO); NaN below two."""
    pose, truth, weight = clean_pair(pose, truth, weight)
    total, pairs = np.zeros(len(pose)), np.zeros(len(pose))
    for joint in range(pose.shape[1] - 1):
        found, true = (length(x[:, joint + 1 :] - x[:, joint, None]) for x in (pose, truth))
        both = weight[:, joint, None] * weight[:, joint + 1 :]
        total += (both * np.abs(found - true)).sum(1)
        pairs += both.sum(1)
    return np.divide(total, pairs, out=np.full(len(pose), np.nan), where=pairs > 0)


def mpjve(pose: Poses, truth: Poses, previous: Int[np.ndarray, " frames"], weight: Weights | None = None) -> PerFrame:
    """Return the mean joint error of the step from the previous frame (VideoPose3D); NaN without one.

    ``previous`` is, for each frame, the row of the one before it in its clip, or -1.
    """
    pose, truth, weight = clean_pair(pose, truth, weight)
    off = pose - truth
    both = weight * weight[previous] * (previous >= 0)[:, None]
    return frame_mean(length(off - off[previous]), both)
