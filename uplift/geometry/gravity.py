"""Gravity in a camera's frame as two angles: the camera's tilt and its roll."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

__all__ = ["angle_deg", "gravity_at", "roll_of", "tilt_of"]

Angles = Float[np.ndarray, " frames"]
Gravity = Float[np.ndarray, "frames 3"]


def tilt_of(gravity: Gravity) -> Angles:
    """Return how far the camera looks down, degrees: asin(z) of unit vectors in its frame (x right, y down, z away)."""
    return np.degrees(np.arcsin(np.clip(gravity[:, 2], -1, 1)))


def roll_of(gravity: Gravity) -> Angles:
    """Return the camera's roll, degrees: how far the image's "up" leans to the right, 0 for an upright camera.

    atan2(-x, y) of gravity in the camera's frame; without meaning for a camera that looks straight up or down.
    """
    return np.degrees(np.arctan2(0 - gravity[:, 0], gravity[:, 1]))


def angle_deg(one: Gravity, other: Gravity) -> Angles:
    """Return the angle between unit vectors, degrees; exact for small ones, too."""
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(one - other, axis=-1) / 2, 0, 1)))


def gravity_at(tilt_deg: Angles, roll_deg: Angles | float = 0.0) -> Gravity:
    """Return the unit vectors of gravity in the frame of cameras with this tilt and roll, degrees."""
    tilt, roll = np.radians(tilt_deg), np.radians(roll_deg)
    return np.stack([-np.sin(roll) * np.cos(tilt), np.cos(roll) * np.cos(tilt), np.sin(tilt)], -1)
