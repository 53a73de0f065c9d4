"""Random perspective cameras and their projection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from uplift.simulator.kinematics import rotation_about

__all__ = ["CENTRE_PX", "FOCAL_PX", "IMAGE_SIZE", "Cameras", "project", "random_cameras", "random_rotations"]

FOCAL_PX = 1145.0
CENTRE_PX = 500.0
IMAGE_SIZE = (1000, 1000)


@dataclass(frozen=True)
class Cameras:
    """One camera a clip: the rotation from the world (y along gravity) and what it looks at."""

    rotation: Float[np.ndarray, "clips 3 3"]
    distance: Float[np.ndarray, " clips"]
    """From the body's middle, body heights."""
    aim: Float[np.ndarray, "clips 2"]
    """Where in the image the body's middle is, share of the focal length."""
    tilt_deg: Float[np.ndarray, " clips"] | None
    """Down-tilt; None where there is no gravity."""


def random_cameras(
    rng: np.random.Generator, clips: int, gravity: bool, tilt_deg: tuple[float, float], distance: tuple[float, float]
) -> Cameras:
    """Return cameras of azimuth uniform and down-tilt normal (mean, deviation); uniform on SO(3) without gravity."""
    if gravity:
        tilt = rng.normal(*tilt_deg, clips).clip(-80, 80)
        azimuth = rotation_about((0.0, 1.0, 0.0), rng.uniform(0, 2 * np.pi, clips))
        rotation = rotation_about((1.0, 0.0, 0.0), np.radians(tilt)) @ azimuth
    else:
        tilt, rotation = None, random_rotations(rng, clips)
    return Cameras(rotation, rng.uniform(*distance, clips), rng.uniform(-0.06, 0.06, (clips, 2)), tilt)


def random_rotations(rng: np.random.Generator, count: int) -> Float[np.ndarray, "count 3 3"]:
    """Return rotations uniform on SO(3), from unit quaternions (Shoemake 1992)."""
    w, x, y, z = (q := rng.normal(size=(4, count))) / np.linalg.norm(q, axis=0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def project(points: Float[np.ndarray, "*frames 3"]) -> Float[np.ndarray, "*frames 2"]:
    """Return the pixels of points in the camera frame."""
    return points[..., :2] / points[..., 2:] * FOCAL_PX + CENTRE_PX
