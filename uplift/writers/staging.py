"""What a page needs besides the poses: level rotations, truth at the pose's size, places of the roots."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from uplift.writers.clips import Clip

__all__ = ["beside", "level_rotations", "matched_truth", "scaled_error", "standing"]


def level_rotations(
    pose: Float[np.ndarray, "frames joints 3"], level_pose: Float[np.ndarray, "frames joints 3"]
) -> tuple[Float[np.ndarray, "frames 3 3"], float]:
    """Return the rotation that levels each pose, and the largest departure from one as a share of its size.

    Proper rotations by least squares (Kabsch, Acta Cryst. A32, 1976).
    """
    pose, level_pose = np.nan_to_num(pose.astype(np.float64)), np.nan_to_num(level_pose.astype(np.float64))
    u, _, vt = np.linalg.svd(np.einsum("fji,fjk->fik", level_pose, pose))
    u[:, :, -1] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotation = u @ vt
    departure = np.abs(np.einsum("fik,fjk->fji", rotation, pose) - level_pose).max(initial=0)
    return rotation, float(departure / max(np.abs(pose).max(initial=0), 1e-12))


def matched_truth(
    pose: Float[np.ndarray, "frames joints 3"], truth: Float[np.ndarray, "frames joints 3"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Return the truth at the scale that brings it nearest to each pose (least squares, never mirrored)."""
    return truth * _scale(truth, pose)[:, None, None]


def scaled_error(
    pose: Float[np.ndarray, "frames joints 3"], truth: Float[np.ndarray, "frames joints 3"]
) -> Float[np.ndarray, " frames"]:
    """Return each frame's ``n_mpjpe`` in the unit of the truth."""
    gap = np.linalg.norm(pose * _scale(pose, truth)[:, None, None] - truth, axis=-1)
    known = np.isfinite(gap)
    mean = np.where(known, gap, 0).sum(1) / np.maximum(known.sum(1), 1)
    return np.where(known.any(1), mean, np.nan)


def standing(
    root: Float[np.ndarray, "frames 3"], level: Float[np.ndarray, "frames 3 3"], clip: Clip
) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, "frames 3"]]:
    """Return where the roots of a clip are in the axes of the camera, and in level ones.

    ``level`` is one rotation for all of a clip, whose camera stands still: far from the camera a degree of tilt
    more or less would move a root by much. A place that is not known lies between those before and after it.
    """
    place = np.where(np.isfinite(root).all(-1, keepdims=True), root, np.nan)
    for one in range(len(clip.individual_names)):
        rows = np.flatnonzero(clip.individual == one)
        known = rows[np.isfinite(place[rows, 0])]
        for axis in range(3):
            found = np.interp(clip.moment[rows], clip.moment[known], place[known, axis]) if len(known) else 0.0
            place[rows, axis] = found
    return place, np.einsum("fik,fk->fi", level, place)


def beside(
    pose: Float[np.ndarray, "frames joints 3"],
    keypoints: Float[np.ndarray, "frames joints 2"],
    seen: Bool[np.ndarray, "frames joints"],
) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, "frames 3"]]:
    """Return where the roots stand across the image, in the pose's unit, centred on their median; on the floor where level.

    Weak perspective with one scale for all: for drawing several individuals side by side.
    """
    seen = seen & np.isfinite(pose).all(-1) & np.isfinite(keypoints).all(-1)
    weight = (seen / np.maximum(seen.sum(1, keepdims=True), 1))[..., None]
    flat = np.where(seen[..., None], pose[..., :2], 0.0)
    points = np.where(seen[..., None], keypoints, 0.0)
    flat_mean, point_mean = (flat * weight).sum(1), (points * weight).sum(1)
    size_3d = np.sqrt((((flat - flat_mean[:, None]) ** 2) * weight).sum((1, 2)))
    size_px = np.sqrt((((points - point_mean[:, None]) ** 2) * weight).sum((1, 2)))
    usable = size_px > 0
    scale = np.median(size_3d[usable] / size_px[usable]) if usable.any() else 0.0
    place = point_mean * scale - flat_mean
    anchor = np.median(place[usable], axis=0) if usable.any() else 0.0
    place = np.pad(np.where(usable[:, None], place - anchor, 0.0), ((0, 0), (0, 1)))
    return place, place * [1.0, 0.0, 0.0]


def _scale(moved: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Return s of the least |s moved - fixed| per frame; the ratio of sizes where that is not positive."""
    known = np.isfinite(moved) & np.isfinite(fixed)
    moved, fixed = np.where(known, moved, 0.0), np.where(known, fixed, 0.0)
    own, other = (moved**2).sum((1, 2)), (fixed**2).sum((1, 2))
    own = np.where(own > 0, own, 1.0)
    best = (moved * fixed).sum((1, 2)) / own
    return np.where(best > 0, best, np.sqrt(other / own))
