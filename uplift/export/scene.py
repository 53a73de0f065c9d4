"""The scene around poses: axes by name, level rotations, places of roots, the truth at a pose's size."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from uplift.errors import UserError, did_you_mean
from uplift.export.clips import Clip, arrange
from uplift.geometry.gravity import gravity_at
from uplift.geometry.rigid import least_turn, nearest_rotation, quaternion_matrix
from uplift.models.prediction import Prediction
from uplift.skeleton.core import bone_sides, joint_sides

__all__ = [
    "AS_SEEN",
    "AXES",
    "FROM_LEVEL",
    "SIDE_COLOURS",
    "Body",
    "beside",
    "body_of",
    "from_y_down",
    "held",
    "in_axes",
    "in_metres",
    "known_points",
    "level_rotations",
    "linear",
    "rotations_to",
    "row_places",
    "scaled_error",
    "shown_truth",
    "standing",
]  # fmt: skip

SIDE_COLOURS = {"centre": (0x4A, 0x50, 0x58), "left": (0x1F, 0x77, 0xB8), "right": (0xD9, 0x63, 0x0F)}
"""sRGB, 0 to 255, in the order of `uplift.skeleton.core.joint_sides`."""


def linear(rgb: tuple[int, int, int]) -> Float[np.ndarray, "3"]:
    """Return an sRGB colour, 0 to 255, in linear light, 0 to 1, as 3D files have it."""
    colour = np.asarray(rgb) / 255
    return np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


class Body(NamedTuple):
    """Bones as indices of joints, and the side of each joint and bone, a place in `SIDE_COLOURS`."""

    bones: Int[np.ndarray, "bones 2"]
    joint_sides: list[int]
    bone_sides: list[int]


def body_of(prediction: Prediction) -> Body:
    """Return the bones and sides of a prediction's skeleton."""
    bones, sides = prediction.bone_indices, joint_sides(prediction.skeleton, prediction.joint_names)
    return Body(bones, sides, bone_sides(sides, bones.tolist()))


# Axes by name: the camera's, gravity's, and those of programs that read poses.

AXES = {
    "camera": "x right in the image, y down, z away from the camera",
    "level": "the camera's axes turned so that y is gravity: x right, y down, z away, level",
    "opencv": "another name of camera: x right in the image, y down, z away from the camera",
    "blender": "z up, x right, y away from the camera, level",
    "opensim": "y up, x right, z towards the camera, level",
    "unity": "y up, x right, z away from the camera, level; left-handed, as Unity is",
}
"""The names `in_axes` knows and what they mean; all but unity are right-handed. Left stays left, in Unity too."""

AS_SEEN = ("camera", "opencv")
"""Axes of the camera itself."""
FROM_LEVEL = {
    "level": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "blender": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "opensim": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "unity": [[1, 0, 0], [0, -1, 0], [0, 0, 1]],
}
"""From the level frame to the axes of other programs: rotations, and a mirror image for left-handed ones."""
_BLOCK = 1 << 14
_AGREES = 1e-3  # share of a body's size by which its level pose may differ from what the tilt says


def in_axes(prediction: Prediction, name: str) -> Prediction:
    """Return the same poses, and places of the root where they are known, in the axes called ``name``.

    What is not in ``Prediction.axes`` stays as it is: ``level_pose``, gravity, the truth, the keypoints, and the
    uncertainty, which is along the camera's line of sight. Raises UserError for an unknown name, ValueError
    for a prediction that is not in the camera's axes any more.
    """
    rotation = rotations_to(prediction, name)
    if name in AS_SEEN:
        return replace(prediction, axes=name)
    rotation = rotation.astype(np.result_type(prediction.pose, np.float32))
    pose, hypotheses = prediction.pose @ rotation.transpose(0, 2, 1), prediction.hypotheses
    if hypotheses is not None:
        hypotheses = hypotheses @ rotation.transpose(0, 2, 1)[:, None]
    root = prediction.root
    if root is not None:
        root = np.einsum("fik,fk->fi", rotation.astype(np.result_type(root, np.float32)), root)
    ground = prediction.ground
    if ground is not None:
        point, normal = (np.einsum("fik,fk->fi", rotation, one) for one in (ground.point, ground.normal))
        ground = replace(ground, point=point, normal=normal)
    return replace(prediction, pose=pose, hypotheses=hypotheses, root=root, ground=ground, axes=name)


def rotations_to(prediction: Prediction, name: str) -> Float[np.ndarray, "frames 3 3"]:
    """Return the rotations R from the camera's axes to ``name``, mirrored for left-handed ones: a point p of a frame is at ``R @ p``.

    The frames of one clip share one rotation, by the median of their gravity: its camera is fixed, and a
    rotation for each frame would shake the root's path. Rows that nothing marks as frames of one film (no
    ``sequence``, ``frame`` or frame rate) have one each. A skeleton without gravity
    has no level: its camera's axes are taken as level. Raises as `in_axes`.
    """
    if name not in AXES:
        raise UserError(f"axes={name}: no such axes.{did_you_mean(name, AXES)}")
    if prediction.axes not in AS_SEEN:
        raise ValueError(f"prediction: in the axes '{prediction.axes}', expected the camera's: turn to axes only once")
    if name in AS_SEEN or not prediction.skeleton.gravity:
        level = np.broadcast_to(np.eye(3), (len(prediction), 3, 3))
    else:
        parts = (slice(start, start + _BLOCK) for start in range(0, max(len(prediction), 1), _BLOCK))
        gravity = _steady(np.concatenate([_gravities(prediction.select(part)) for part in parts]), prediction)
        level = quaternion_matrix(least_turn(gravity, np.array([0.0, 1.0, 0.0])))
        level[gravity[:, 1] < -1 + 1e-12] = np.diag([-1.0, -1.0, 1.0])  # a camera upside down: a half turn in the image
    return np.array(FROM_LEVEL.get(name, FROM_LEVEL["level"]), float) @ level


def _gravities(prediction: Prediction) -> Float[np.ndarray, "frames 3"]:
    """Return each frame's gravity in the camera's axes, NaN where neither the prediction nor its level pose gives it.

    What the prediction says where the level pose agrees, else that of the rotation between pose and level pose.
    """
    known = np.asarray(np.isfinite(prediction.pose).all(-1) & np.isfinite(prediction.level_pose).all(-1))
    pose = np.where(known[..., None], prediction.pose, 0.0)
    levelled = np.where(known[..., None], prediction.level_pose, 0.0)
    size = np.abs(pose).max((1, 2), initial=0)
    if prediction.gravity is not None:
        gravity = prediction.gravity.astype(np.float64)
    else:
        gravity = gravity_at(np.full(len(prediction), np.nan) if prediction.tilt_deg is None else prediction.tilt_deg)
    gap = np.abs(np.einsum("fji,fi->fj", pose, gravity) - levelled[..., 1]).max(1, initial=0)
    differs = ~(gap <= _AGREES * size)
    if differs.any():
        gravity[differs] = level_rotations(pose[differs], levelled[differs])[0][:, 1]
        gravity[differs & (size == 0)] = np.nan
    return gravity


def _steady(gravity: np.ndarray, prediction: Prediction) -> Float[np.ndarray, "frames 3"]:
    """Return unit gravity, one for all frames of a clip; the camera's y where a clip has none."""
    steady = gravity.copy()
    identity = prediction.identity
    if prediction.fps is not None or {"sequence", "frame", "image"} & set(identity):
        for clip in arrange(identity, len(gravity)):
            known = gravity[clip.rows]
            known = known[np.isfinite(known).all(-1)]
            if len(known):
                middle = np.median(known, axis=0)
                steady[clip.rows] = middle if np.linalg.norm(middle) > 0.1 else known[0]
            else:
                steady[clip.rows] = np.nan
    steady[~np.isfinite(steady).all(-1)] = (0, 1, 0)
    return steady / np.linalg.norm(steady, axis=-1, keepdims=True)


def from_y_down(axes: str) -> Float[np.ndarray, "3 3"]:
    """Return what takes axes with x right, y down and z away to those of a name of `uplift.export.scene`."""
    return np.array(FROM_LEVEL.get(axes, FROM_LEVEL["level"]), float)


def level_rotations(
    pose: Float[np.ndarray, "frames joints 3"], level_pose: Float[np.ndarray, "frames joints 3"]
) -> tuple[Float[np.ndarray, "frames 3 3"], float]:
    """Return the rotation that levels each pose, and the largest departure from one as a share of its size.

    Proper rotations by least squares (Kabsch, Acta Cryst. A32, 1976).
    """
    pose, level_pose = np.nan_to_num(pose.astype(np.float64)), np.nan_to_num(level_pose.astype(np.float64))
    rotation, _ = nearest_rotation(np.einsum("fji,fjk->fik", level_pose, pose))
    departure = np.abs(np.einsum("fik,fjk->fji", rotation, pose) - level_pose).max(initial=0)
    return rotation, float(departure / max(np.abs(pose).max(initial=0), 1e-12))


def row_places(prediction: Prediction, clip: Clip) -> Float[np.ndarray, "rows 3"]:
    """Return where the root of each row is, in the prediction's axes and unit, NaN where that is not known.

    The prediction's root; else several individuals stand side by side as in the image, and one is at 0.
    """
    if prediction.root is not None:
        return known_points(prediction.root[:, None])[:, 0]
    found = np.zeros((len(prediction), 3))
    if len(clip.individual_names) > 1:
        turn = from_y_down(prediction.axes)
        seen = np.nan_to_num(np.asarray(prediction.confidence, float)) > 0
        pose = np.asarray(prediction.pose, float) @ turn
        found = beside(pose, np.asarray(prediction.keypoints, float), seen)[0] @ turn.T
    return found


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


def known_points(
    pose: Float[np.ndarray, "frames joints 3"], kind: type | None = np.float64
) -> Float[np.ndarray, "frames joints 3"]:
    """Return the pose as ``kind`` (None: as it is) with all coordinates of a joint NaN where one is not finite."""
    pose = np.array(pose, kind)
    pose[~np.isfinite(pose).all(-1)] = np.nan
    return pose


_PERSON_M = 1.7


def in_metres(prediction: Prediction) -> tuple[float, float]:
    """Return what takes the prediction's unit to metres, and how large a body is in them: without a known size, about 1.7.

    The size of a body is the median over frames of the largest side of its box, 1 of the unit where there is none.
    """
    largest = np.empty(len(prediction))
    for start in range(0, len(prediction), _BLOCK):
        pose = known_points(prediction.pose[start : start + _BLOCK])
        known = np.isfinite(pose)
        sides = np.where(known, pose, -np.inf).max(1) - np.where(known, pose, np.inf).min(1)
        largest[start : start + _BLOCK] = sides.max(-1)
    usable = largest[np.isfinite(largest) & (largest > 0)]
    body = float(np.median(usable)) if len(usable) else 1.0
    scale = 0.001 if prediction.unit == "mm" else _PERSON_M / body
    return scale, body * scale


def held(values: Float[np.ndarray, "frames axes"]) -> Float[np.ndarray, "frames axes"]:
    """Return values with NaN replaced by what was last known, at the start by what is known first, 0 without any."""
    known = np.isfinite(values).all(1)
    if not known.any():
        return np.zeros_like(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return values[np.where(last < 0, int(np.argmax(known)), last)]


def shown_truth(
    prediction: Prediction, pose: Float[np.ndarray, "frames joints 3"], truth: Float[np.ndarray, "frames joints 3"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Return the truth as it is if it and the poses are in mm, else at the scale nearest to each pose (least squares)."""
    metric = prediction.unit == prediction.truth_unit == "mm"
    return truth if metric else truth * _scale(truth, pose)[:, None, None]


def scaled_error(
    pose: Float[np.ndarray, "frames joints 3"], truth: Float[np.ndarray, "frames joints 3"]
) -> Float[np.ndarray, " frames"]:
    """Return each frame's ``n_mpjpe`` in the unit of the truth."""
    gap = np.linalg.norm(pose * _scale(pose, truth)[:, None, None] - truth, axis=-1)
    known = np.isfinite(gap)
    mean = np.where(known, gap, 0).sum(1) / np.maximum(known.sum(1), 1)
    return np.where(known.any(1), mean, np.nan)


def _scale(moved: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Return s of the least |s moved - fixed| per frame; the ratio of sizes where that is not positive."""
    known = np.isfinite(moved) & np.isfinite(fixed)
    moved, fixed = np.where(known, moved, 0.0), np.where(known, fixed, 0.0)
    norm = (moved**2).sum((1, 2))
    norm = np.where(norm > 0, norm, 1.0)
    best = (moved * fixed).sum((1, 2)) / norm
    return np.where(best > 0, best, np.sqrt((fixed**2).sum((1, 2)) / norm))
