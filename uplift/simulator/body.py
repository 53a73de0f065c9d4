"""A body that can be posed: points with a rest position, the angles that turn them and how far those go.

A skeleton's YAML gives one in either of two ways.

A person in any layout stands on the simulator's own human body (`uplift.simulator.human`), which
brings lengths, limits and motion; a list is a mean::

    limits: {hip: {human: pelvis}, rknee: {human: right_knee}, neck: {human: [left_shoulder, right_shoulder]}}

Anything else spells out its own body. The rest frame is that of a body facing the camera: x its
left, y down, z behind it; lengths are shares of the body height (or of any other body unit)::

    proportions: {head: 0.1, left_knee: 0.2}                 # length of the bone from the parent
    rest: {head: [0, -1, -0.2], left_knee: [0.3, 1, 0]}      # direction of that bone in the rest pose
    limits:                                                  # degrees; optional
      left_knee: {flexion: [-120, 0]}                        # a hinge: the angles not named stay 0
      neck: {flexion: [-40, 40], abduction: [-30, 30], rotation: [-60, 60]}
      finger_tip: {flexion: [0, 60], follows: finger_mid}    # goes through its range together with it

A limit belongs to the joint that bends and moves everything beyond it. Flexion swings the bone
beyond it forward (a bone that points forward: up), abduction away from the midline (on the
midline: to the left), rotation turns it about itself, inward (on the midline: to the left). A
joint without limits takes those of its mirror partner, else `DEFAULT_LIMITS` (the root: none); the
order of the rotations is flexion, abduction, rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from uplift.errors import UserError, did_you_mean
from uplift.skeleton import Skeleton

__all__ = ["DEFAULT_LIMITS", "ROOT_ANGLES", "Body", "angle_axes", "joint_weights", "rest_positions"]

DEFAULT_LIMITS = {"flexion": (-25.0, 25.0), "abduction": (-15.0, 15.0), "rotation": (-10.0, 10.0)}
"""Degrees, where a skeleton gives no limits."""

ROOT_ANGLES = {"turn": (0.0, -1.0, 0.0), "pitch": (1.0, 0.0, 0.0), "roll": (0.0, 0.0, 1.0)}
"""Axes of the root's own rotation: turn to its left, pitch forward, roll to its left, in that order."""

_FRONT, _UP = np.array([0.0, 0.0, -1.0]), np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True)
class Body:
    """Points in tree order (parents first), the rotations at them, and how skeleton joints sit on them."""

    points: tuple[str, ...]
    parents: Int[np.ndarray, " points"]
    """-1 for the root."""
    offsets: Float[np.ndarray, "points 3"]
    """From the parent, rest frame, body heights."""
    groups: tuple[str, ...]
    """Points of one group share a between-body length factor."""
    spread: float
    """Standard deviation of that factor."""
    angles: tuple[str, ...]
    """Names such as ``left_knee flexion``."""
    low_deg: Float[np.ndarray, " angles"]
    high_deg: Float[np.ndarray, " angles"]
    steps: tuple[tuple[int, int, tuple[float, float, float]], ...]
    """Rotations in the order they are applied: (point, angle, axis)."""
    joints: Float[np.ndarray, "joints points"]
    """Weights: each skeleton joint is a point or a mean of points."""
    scaled_axes: Bool[np.ndarray, " 3"]
    """Axes along which whole bodies are stretched (rigid objects)."""
    height: tuple[float, float] = (1000.0, 0.0)
    """Mean and standard deviation of the body height, in ``unit``."""
    unit: str = "relative"

    def angle(self, point: str, name: str) -> int:
        """Return the place of one angle of one point."""
        return self.angles.index(f"{point} {name}")


def rest_positions(
    parents: Int[np.ndarray, " points"], offsets: Float[np.ndarray, "*bodies points 3"]
) -> Float[np.ndarray, "*bodies points 3"]:
    """Return the points of the rest pose, root at the origin."""
    positions = np.array(offsets, dtype=float)
    for point, parent in enumerate(parents):
        positions[..., point, :] = 0.0 if parent < 0 else positions[..., parent, :] + offsets[..., point, :]
    return positions


def angle_axes(direction: Float[np.ndarray, " 3"], side: float) -> dict[str, tuple[float, float, float]]:
    """Return the axes of flexion, abduction and rotation of a bone along ``direction`` in the rest frame.

    ``side`` is +1 for the body's left and its midline, -1 for its right.
    """
    along = direction / np.linalg.norm(direction)
    left = np.array([side, 0.0, 0.0])
    flexion = np.cross(along, _FRONT if abs(along @ _FRONT) < 0.9 else _UP)
    abduction = np.cross(along, left) if abs(along @ left) < 0.9 else np.cross(along, _UP)
    axes = {"flexion": flexion, "abduction": abduction}
    axes = {name: axis / np.linalg.norm(axis) for name, axis in axes.items()}
    axes["rotation"] = side * along * np.sign(along @ -_UP or 1.0)
    return {name: (float(axis[0]), float(axis[1]), float(axis[2])) for name, axis in axes.items()}


def joint_weights(
    skeleton: Skeleton, parts: dict[str, tuple[str, ...]], points: tuple[str, ...], place: str
) -> Float[np.ndarray, "joints points"]:
    """Return the weights that make each joint of the skeleton the mean of its body points.

    Raises UserError where a joint has none or names a point the body lacks.
    """
    weights = np.zeros((len(skeleton.joints), len(points)))
    for row, joint in enumerate(skeleton.joints):
        names = parts.get(joint)
        if not names:
            raise UserError(
                f"Skeleton '{skeleton.name}', {place}: found nothing for joint '{joint}'; expected a point of the "
                f"body or a list of points. Add for example '{joint}: {points[0]}'."
            )
        for name in names:
            if name not in points:
                raise UserError(
                    f"Skeleton '{skeleton.name}', {place}: the body has no point '{name}' (joint '{joint}')."
                    + did_you_mean(name, points)
                )
            weights[row, points.index(name)] += 1 / len(names)
    return weights
