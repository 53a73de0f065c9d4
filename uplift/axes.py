"""Output frames by name: the camera's axes, gravity's, and those of the programs that poses are handed to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError, did_you_mean
from uplift.prediction import Prediction

__all__ = ["AXES", "FROM_LEVEL", "in_axes", "rotations_to"]

AXES = {
    "camera": "x right in the image, y down, z away from the camera",
    "level": "the camera's axes turned so that y is gravity: x right, y down, z away, level",
    "opencv": "another name of camera: x right in the image, y down, z away from the camera",
    "blender": "z up, x right, y away from the camera, level",
    "opensim": "y up, x right, z towards the camera, level",
}
"""The names `in_axes` knows and what they mean; all are right-handed, so left stays left."""

_AS_SEEN = ("camera", "opencv")
FROM_LEVEL = {
    "level": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "blender": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "opensim": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
}
"""Rotations from the level frame to the axes of other programs."""
_AGREES = 1e-3
"""Share of a body's size by which its level pose may miss what the tilt says."""


def in_axes(prediction: Prediction, name: str) -> Prediction:
    """Return the same poses, and places of the root where they are known, in the axes called ``name``.

    What is not in ``Prediction.axes`` stays as it is: ``level_pose``, the truth, the keypoints, and the
    spread, which is along the camera's line of sight. Raises UserError for an unknown name, ValueError
    for a prediction that is not in the camera's axes any more.
    """
    rotation = rotations_to(prediction, name)
    if name in _AS_SEEN:
        return replace(prediction, axes=name)
    rotation = rotation.astype(np.result_type(prediction.pose, np.float32))
    pose = prediction.pose @ rotation.transpose(0, 2, 1)
    root = prediction.root
    if root is not None:
        root = np.einsum("fik,fk->fi", rotation.astype(np.result_type(root, np.float32)), root)
    return replace(prediction, pose=pose, root=root, axes=name)


def rotations_to(prediction: Prediction, name: str) -> Float[np.ndarray, "frames 3 3"]:
    """Return the proper rotations R from the camera's axes to ``name``: a point p of a frame is at ``R @ p``.

    The frames of one clip share one rotation, by the median of their gravity: its camera stands, and a
    rotation of their own would shake the root's path. Rows of which nothing says that they are frames
    of one film (no ``sequence``, ``frame`` or frame rate) have their own. A skeleton without gravity
    has no level: its camera's axes are taken as level. Raises as `in_axes`.
    """
    if name not in AXES:
        raise UserError(f"axes={name}: no such axes.{did_you_mean(name, AXES)}")
    if prediction.axes not in _AS_SEEN:
        raise ValueError(f"prediction: in the axes '{prediction.axes}', expected the camera's: turn to axes only once")
    if name in _AS_SEEN or not prediction.skeleton.gravity:
        level = np.broadcast_to(np.eye(3), (len(prediction), 3, 3))
    else:
        level = _least_rotations(_steady(_gravities(prediction), prediction))
    return np.array(FROM_LEVEL.get(name, FROM_LEVEL["level"]), float) @ level


def _gravities(prediction: Prediction) -> Float[np.ndarray, "frames 3"]:
    """Return each frame's gravity in the camera's axes, NaN where neither tilt nor level pose tells it.

    The tilt's where the level pose agrees, else that of the rotation between pose and level pose.
    """
    from uplift.writers.staging import level_rotations  # here: the writers import this module

    known = np.asarray(np.isfinite(prediction.pose).all(-1) & np.isfinite(prediction.level_pose).all(-1))
    pose = np.where(known[..., None], prediction.pose, 0.0)
    levelled = np.where(known[..., None], prediction.level_pose, 0.0)
    size = np.abs(pose).max((1, 2), initial=0)
    told = np.full(len(prediction), np.nan) if prediction.tilt_deg is None else prediction.tilt_deg
    tilt = np.radians(told)
    gravity = np.stack([np.zeros(len(tilt)), np.cos(tilt), np.sin(tilt)], -1)
    gap = np.abs(np.einsum("fji,fi->fj", pose, gravity) - levelled[..., 1]).max(1, initial=0)
    differs = ~(gap <= _AGREES * size)
    if differs.any():
        gravity[differs] = level_rotations(pose[differs], levelled[differs])[0][:, 1]
        gravity[differs & (size == 0)] = np.nan
    return gravity


def _steady(gravity: np.ndarray, prediction: Prediction) -> Float[np.ndarray, "frames 3"]:
    """Return unit gravity, one for all frames of a clip; the camera's y where a clip has none."""
    from uplift.writers.clips import arrange

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


def _least_rotations(gravity: np.ndarray) -> Float[np.ndarray, "frames 3 3"]:
    """Return the least rotations that take unit ``gravity`` to y (Rodrigues' formula); a half turn in the image for -y."""
    x, y, z = gravity.T
    aside = x**2 + z**2
    above = np.where(y < 0, aside / (1 + np.abs(y)), 1 + y)  # 1 + y without cancellation
    turned = np.where(above > 0, above, 1.0)
    rows = [1 - x**2 / turned, -x, -x * z / turned, x, y, z, -x * z / turned, -z, 1 - z**2 / turned]
    rotation = np.stack(rows, -1).reshape(-1, 3, 3)
    rotation[above < 1e-12] = np.diag([-1.0, -1.0, 1.0])
    return rotation
