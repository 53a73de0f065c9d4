"""Virtual cameras round a motion: fixed, level but for a down-tilt, far enough that nobody leaves the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Rig", "View", "film"]

_USED = 0.96  # of the half image, by the joints
_NEAREST_MM = 500.0
_JITTER = 0.1


@dataclass(frozen=True)
class Rig:
    """How many cameras there are and what they are like."""

    cameras: int = 4
    tilt_deg: float = 8.0
    """Mean down-tilt."""
    tilt_sd_deg: float = 2.0
    distance_m: float = 5.0
    """From the middle of the motion; farther where that takes a joint out of the image."""
    focal_px: float = 1145.0
    image_size: tuple[int, int] = (1000, 1000)


@dataclass(frozen=True)
class View:
    """A motion as one camera sees it."""

    keypoints: Float[np.ndarray, "frames joints 2"]
    """Pixels."""
    pose: Float[np.ndarray, "frames joints 3"]
    """mm, camera frame, relative to the first joint."""
    root: Float[np.ndarray, "frames 3"]
    tilt_deg: float


def film(joints: Float[np.ndarray, "frames joints 3"], rig: Rig, random: np.random.Generator) -> list[View]:
    """Return what the cameras see of ``joints`` (mm, world, y up), the first of which is the root.

    They stand evenly round the middle of the motion, the first anywhere, each up to 15 degrees off its
    place when there are four.
    """
    spin = random.uniform(0, 360)
    views = []
    middle = (joints.max((0, 1)).astype(np.float64) + joints.min((0, 1))) / 2
    for camera in range(rig.cameras):
        share = 360 / rig.cameras
        azimuth = spin + share * (camera + random.uniform(-1, 1) / 6)
        tilt = float(np.clip(rig.tilt_deg + rig.tilt_sd_deg * random.standard_normal(), -80, 80))
        distance = 1000 * rig.distance_m * (1 + _JITTER * random.uniform(-1, 1))
        points = (joints - middle) @ _axes(azimuth, tilt).T
        points[..., 2] += max(distance, _least_distance(points, rig))
        views.append(_view(points, rig, tilt))
    return views


def _axes(azimuth_deg: float, tilt_deg: float) -> Float[np.ndarray, "3 3"]:
    """Return the camera's right, down and forward in the world, as rows."""
    around, down = np.deg2rad([azimuth_deg, tilt_deg])
    level = np.array([np.sin(around), 0, np.cos(around)])
    right = np.cross(level, [0, 1, 0])
    forward = np.cos(down) * level - np.sin(down) * np.array([0, 1, 0])
    return np.stack([right, np.cross(forward, right), forward])


def _least_distance(points: Float[np.ndarray, "frames joints 3"], rig: Rig) -> float:
    """Return how far the camera must be from the origin of ``points`` to have them all in its image."""
    half = _USED * np.array(rig.image_size) / 2
    away = rig.focal_px * np.abs(points[..., :2]) / half - points[..., 2:]
    return float(max(away.max(), _NEAREST_MM - points[..., 2].min()))


def _view(points: np.ndarray, rig: Rig, tilt_deg: float) -> View:
    root = points[:, 0].astype(np.float32)
    pose = (points - points[:, :1]).astype(np.float32)
    # From the rounded numbers: what is written projects to what is written.
    seen = pose.astype(np.float64) + root[:, None]
    keypoints = rig.focal_px * seen[..., :2] / seen[..., 2:] + np.array(rig.image_size) / 2
    return View(keypoints.astype(np.float32), pose, root, tilt_deg)
