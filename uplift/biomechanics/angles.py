"""Joint angles of poses, as a skeleton's ``angles:`` name them: flexion, abduction, rotation, by geometry alone.

Every angle measures one segment, a direction from one point of the body to another:

- ``from``: the angle between the segment and this direction, 0 to 180. With ``about``: the turn from it to the segment
  about that axis, right-handed, both projected onto the plane across the axis.
- ``towards``: the angle of the segment out of the plane across this direction, -90 to 90; with ``from`` the direction is
  first made perpendicular to that, so that a segment along ``from`` has 0.

A turn about an axis fixed in the proximal segment and an angle out of the plane across it are the first two rotations
of the joint coordinate system of Grood and Suntay (1983, J. Biomech. Eng. 105), which the recommendations of the ISB
(Wu et al. 2002, 2005, J. Biomech. 35, 38) use; a turn about the distal segment is the third.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from uplift.config.files import shipped_names
from uplift.errors import UserError, listed
from uplift.geometry.rigid import nearest_rotation
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.core import Angle, Way

__all__ = ["Angles", "angles_of", "joint_angles", "no_angles", "wrapped"]

_LEAST_SINE = np.sin(np.radians(10.0))
"""A direction closer to an axis than ten degrees leaves the turn about it to chance."""


@dataclass(frozen=True)
class Angles:
    """Joint angles of frames, degrees."""

    values: Float[np.ndarray, "frames angles"]
    """In (-180, 180]; NaN where a joint is missing or a direction is along the axis it would be turned about."""
    names: tuple[str, ...]
    uncertainty: Float[np.ndarray, "frames angles"] | None = None
    """The error to expect of each value (mean absolute), where that of the joints is known."""


def angles_of(skeleton: Skeleton) -> dict[str, Angle]:
    """Return the angles of a skeleton on both sides, none where it names none.

    A run that kept an older copy of a shipped skeleton, without angles, has those of the shipped one.
    """
    if not skeleton.angles and skeleton.name in shipped_names("skeletons"):
        newer = load_skeleton(skeleton.name)
        skeleton = newer if newer.joints == skeleton.joints else skeleton
    return skeleton.both_sides


def joint_angles(pose: Float[np.ndarray, "frames joints 3"] | Prediction, skeleton: Skeleton | None = None) -> Angles:
    """Return the angles that the skeleton names.

    Args:
        pose: a prediction; or poses of the skeleton's joints in level axes (x right, y down, z away), any unit, NaN
            where a joint is missing.
        skeleton: of poses that are an array; a prediction brings its own.

    The ``uncertainty`` of a prediction's angles is propagated from that of its joints' depths, and of the places of
    joints that were not seen. Errors of depth are taken to add up along the bones from the root, so that two joints of
    one limb share those of the bones before them. What the keypoints and the tilt of the camera are off is not in it.

    Raises:
        UserError: the skeleton names no angles, or joints are not there at all.
    """
    body = pose.skeleton if isinstance(pose, Prediction) else skeleton
    if body is None:
        raise ValueError("joint_angles: poses without a skeleton, expected skeleton=")
    wanted = angles_of(body)
    if not wanted:
        raise no_angles(body)
    joints = pose.joint_names if isinstance(pose, Prediction) else body.joints
    absent = sorted({joint for angle in wanted.values() for joint in _joints(angle)} - set(joints))
    if absent:
        raise UserError(f"skeleton '{body.name}': its angles need joints that are not there: {listed(absent)}.")
    parts = [slice(start, start + _ROWS) for start in range(0, max(len(pose), 1), _ROWS)]
    if not isinstance(pose, Prediction):
        level = np.eye(3)[None]
        values = [_all_measured(wanted, _scene(pose[part], joints, level)) for part in parts]
        return Angles(np.concatenate(values), tuple(wanted))
    found = [_of_prediction(wanted, pose.select(part)) for part in parts]
    values = np.concatenate([values for values, _ in found])
    spread = None if pose.uncertainty is None else np.concatenate([spread for _, spread in found])
    return Angles(values, tuple(wanted), spread)


def _of_prediction(wanted: Mapping[str, Angle], prediction: Prediction) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles of a few frames, and how far off each may be, 0 where that is not known."""
    scene = _scene_of(prediction)
    values = _all_measured(wanted, scene)
    if prediction.uncertainty is None:
        return values, np.zeros_like(values)
    spread = [_spread(angle, scene, prediction, values[:, k]) for k, angle in enumerate(wanted.values())]
    return values, np.where(np.isfinite(values), np.stack(spread, -1), np.nan).astype(np.float32)


def _all_measured(wanted: Mapping[str, Angle], scene: _Scene) -> Float[np.ndarray, "frames angles"]:
    return np.stack([_measured(angle, scene) for angle in wanted.values()], -1).astype(np.float32)


def no_angles(skeleton: Skeleton) -> UserError:
    """Return the error of a skeleton without angles."""
    return UserError(f"skeleton '{skeleton.name}' names no joint angles: write angles: in its YAML (docs/angles.md).")


def wrapped(degrees: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Return the same angles in (-180, 180]."""
    return 180.0 - (180.0 - degrees) % 360.0


# The body of every frame: joints by name, and the level frame in the same axes. Vectors are (3 ... frames) in here: sums
# over their first axis are several times as fast.

_ROWS = 2048
_Vectors = Float[np.ndarray, "3 *any frames"]
_Numbers = Float[np.ndarray, "*any frames"]


class _Scene(NamedTuple):
    points: dict[str, _Vectors]
    level: dict[str, _Vectors]
    """The directions of the level frame."""


def _scene(pose: np.ndarray, joints: Sequence[str], level: Float[np.ndarray, "frames_or_1 3 3"]) -> _Scene:
    """Return the scene of poses; ``level`` are rotations from their axes to the level frame."""
    pose = np.ascontiguousarray(np.asarray(pose, np.float64).transpose(1, 2, 0))
    pose = np.where(np.isfinite(pose).all(1, keepdims=True), pose, np.nan)
    # The rows of a rotation to the level frame are its axes.
    right, down = (np.broadcast_to(level[:, row].T, pose.shape[1:]) for row in (0, 1))
    names = {"up": -down, "down": down, "image_right": right, "image_left": -right}
    return _Scene(dict(zip(joints, pose, strict=True)), names)


def _scene_of(prediction: Prediction) -> _Scene:
    """Return the poses in their own axes: the camera's, in which the uncertainty is along z."""
    pose, level = (np.nan_to_num(np.asarray(of, np.float64)) for of in (prediction.pose, prediction.level_pose))
    rotation, _ = nearest_rotation(np.einsum("fji,fjk->fik", level, pose))
    return _scene(prediction.pose, prediction.joint_names, rotation)


def _joints(angle: Angle) -> set[str]:
    ways = [way for way in angle[:4] if way is not None and not isinstance(way, str)]
    return {joint for way in ways for end in way for joint in end}


# One angle.


def _measured(angle: Angle, scene: _Scene) -> _Numbers:
    """Return an angle in degrees, in (-180, 180]."""
    segment = _along(angle.segment, scene)
    start = np.zeros(3) if angle.start is None else _along(angle.start, scene)
    if angle.towards is not None:
        towards = _along(angle.towards, scene)
        towards = towards if angle.start is None else _unit(towards - _dot(towards, start) * start)
        found = np.pi / 2 - _between(segment, towards)
    elif angle.about is None:
        found = _between(segment, start)
    else:
        about = _along(angle.about, scene)
        segment, start = (_across(way, about) for way in (segment, start))
        found = np.arctan2(_dot(_cross(start, segment), about), _dot(start, segment))
    return wrapped(np.degrees(found) - angle.zero)


def _along(way: Way, scene: _Scene) -> np.ndarray:
    """Return a direction as unit vectors, NaN where it has no length."""
    if isinstance(way, str):
        return scene.level[way]
    start, *ends = (np.add.reduce([scene.points[joint] for joint in end]) / len(end) for end in way)
    return _unit(ends[0] - start if len(ends) == 1 else _cross(ends[0] - start, ends[1] - start))


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    (a, b, c), (x, y, z) = one, other
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x])


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.sqrt(_dot(vector, vector))
    return vector / np.where(length > 1e-9, length, np.nan)


def _across(way: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return what of a unit direction is across an axis; NaN where that is next to nothing."""
    rest = way - _dot(way, axis) * axis
    return np.where(_dot(rest, rest) >= _LEAST_SINE**2, rest, np.nan)


def _between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the angle between unit vectors, exact for small ones too (Kahan 2006)."""
    apart, along = one - other, one + other
    return 2 * np.arctan2(np.sqrt(_dot(apart, apart)), np.sqrt(_dot(along, along)))


# The error to expect.


def _spread(angle: Angle, scene: _Scene, prediction: Prediction, value: np.ndarray) -> Float[np.ndarray, " frames"]:
    """Return how far off an angle may be: what each independent part of the errors of its joints changes, in squares.

    Each part is added and taken away, and half of the difference counts; where one of the two has no angle, what the
    other changes.
    """
    joints = sorted(_joints(angle))
    steps = _steps(joints, prediction)
    points = {joint: np.tile(scene.points[joint][:, None, None], (1, 2, len(steps), 1)) for joint in joints}
    for step, (moved, axis, by) in enumerate(steps):
        for joint in moved:
            points[joint][axis, :, step] += np.stack([by, -by])
    level = {name: way[:, None, None] for name, way in scene.level.items()}
    changes = np.abs(wrapped(_measured(angle, _Scene(points, level)) - value))
    known = np.isfinite(changes)
    change = np.where(known, changes, 0).sum(0) / np.maximum(known.sum(0), 1)
    return np.sqrt((change**2).sum(0))


def _steps(joints: Sequence[str], prediction: Prediction) -> list[tuple[list[str], int, np.ndarray]]:
    """Return the independent parts of the errors of joints: which move together, along which axis, how far.

    Errors of depth add up along the bones from the root: a joint has its parent's, and what its own variance has
    more. Of a joint that was not seen the uncertainty is of its place, a length in 3D, and its own across the view.
    """
    assert prediction.uncertainty is not None
    parents, steps = prediction.skeleton.parents, []
    off = dict(zip(prediction.joint_names, np.asarray(prediction.uncertainty, np.float64).T, strict=True))
    if prediction.filled is not None:
        hidden = dict(zip(prediction.joint_names, np.asarray(prediction.filled, bool).T, strict=True))
        off = {joint: np.where(hidden[joint], by / np.sqrt(3), by) for joint, by in off.items()}
        for joint in (joint for joint in joints if hidden[joint].any()):
            steps += [([joint], axis, np.where(hidden[joint], off[joint], 0.0)) for axis in (0, 1)]
    beyond: dict[str, list[str]] = {}
    for joint in joints:
        at: str | None = joint
        while at is not None:
            beyond.setdefault(at, []).append(joint)
            at = parents[at]
    for joint, moved in beyond.items():
        parent = parents[joint]
        before = 0.0 if parent is None else off[parent]
        steps.append((moved, 2, np.sqrt(np.maximum(off[joint] ** 2 - before**2, 0))))
    return steps
