"""Measures of a predicted pose that need no truth: handedness, steady bones, equal sides."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from uplift.evaluation.alignment import length
from uplift.skeleton import Skeleton

__all__ = [
    "bone_cv",
    "bone_lengths",
    "facing_sign",
    "has_handedness",
    "mirrored_bones",
    "never_seen_so_long",
    "symmetry",
]

Poses = Float[np.ndarray, "frames joints 3"]
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
    whole = np.median(np.linalg.norm(bones[known], axis=-1), axis=0)
    seen = np.quantile(np.linalg.norm(bones[known][..., :2], axis=-1), 0.95, axis=0)
    return float((whole > 2 * np.maximum(seen, 1e-9)).mean())


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


def mirrored_bones(skeleton: Skeleton) -> Int[np.ndarray, "pairs 2"]:
    """Return the numbers of the bones that are each other's mirror image, each pair once."""
    partner = skeleton.mirror_permutation
    number = {frozenset(map(int, bone)): place for place, bone in enumerate(skeleton.bone_indices)}
    pairs = []
    for place, bone in enumerate(skeleton.bone_indices):
        other = number.get(frozenset(int(partner[joint]) for joint in bone))
        if other is not None and place < other:
            pairs.append((place, other))
    return np.array(pairs, np.int64).reshape(-1, 2)


def symmetry(lengths: Float[np.ndarray, "frames bones"], pairs: Int[np.ndarray, "pairs 2"]) -> PerFrame:
    """Return the mean of |left - right| / their mean length over mirrored bones; NaN where none is known."""
    one, other = lengths[:, pairs[:, 0]], lengths[:, pairs[:, 1]]
    total = one + other
    share = np.divide(2 * np.abs(one - other), total, out=np.zeros_like(total), where=total > 0)
    known = np.isfinite(total)
    count = known.sum(1)
    mean = np.where(known, share, 0).sum(1) / np.maximum(count, 1)
    return np.where(count > 0, mean, np.nan)
