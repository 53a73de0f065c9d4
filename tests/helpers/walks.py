"""A walk that is exact: feet stand still on level ground, and bones keep their length."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from uplift.skeleton import load_skeleton

__all__ = ["FEET", "FPS", "GRAVITY", "HIP", "SKELETON", "Walk", "walk"]

SKELETON = load_skeleton("h36m17")
FEET = [SKELETON.index("rankle"), SKELETON.index("lankle")]
HIP, BONE = SKELETON.root_index, 430.0
FPS, STRIDE = 25.0, 1400.0
TILT = np.radians(10.0)
GRAVITY = np.array([0, np.cos(TILT), np.sin(TILT)])


class Walk(NamedTuple):
    points: np.ndarray
    """(frames 17 3) in the camera's axes, exact."""
    stands: np.ndarray
    """(frames 2), of `FEET`."""
    height: float


def foot_path(time: np.ndarray, phase: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how far a foot is, how high, and whether it stands: it swings for 0.4 of a cycle of 1.2 s."""
    cycles, part = np.divmod(time / 1.2 + phase, 1.0)
    swing = np.clip((part - 0.6) / 0.4, 0, 1)
    along = STRIDE * (cycles + (1 - np.cos(np.pi * swing)) / 2 - phase)
    return along, 90 * np.sin(np.pi * swing), part <= 0.6


def walk(frames: int = 100, heading_deg: float = 60.0) -> Walk:
    """Return a walk on level ground 1.5 m below the camera's eye, obliquely away from it."""
    time = np.arange(frames) / FPS
    level = np.zeros((frames, 17, 3))  # x right, y down, z ahead along the way; the ground at 0
    level[:, HIP] = np.stack([0 * time, np.full(frames, -800.0), STRIDE * (time / 1.2 - 0.3)], -1)
    stands = np.zeros((frames, 2), bool)
    for at, (side, across, phase) in enumerate((("r", 90.0, 0.0), ("l", -90.0, 0.5))):
        along, up, stands[:, at] = foot_path(time, phase)
        hip = level[:, HIP] + [across, 0, 0]
        foot = np.stack([np.full(frames, across), -up, along], -1)
        way = foot - hip
        far = np.linalg.norm(way, axis=-1, keepdims=True)
        bend = np.sqrt(np.maximum(BONE**2 - (far / 2) ** 2, 0)) * np.cross(way / far, [-1.0, 0, 0])
        for name, place in {"hip": hip, "knee": hip + way / 2 + bend, "ankle": foot}.items():
            level[:, SKELETON.index(side + name)] = place
    above = {"spine": 250, "thorax": 480, "nose": 600, "headtop": 700}
    above |= {side + name: up for side in "rl" for name, up in (("shoulder", 460), ("elbow", 200), ("wrist", 0))}
    for name, up in above.items():
        across = {"r": 180.0, "l": -180.0}[name[0]] if name[1:] in ("shoulder", "elbow", "wrist") else 0.0
        level[:, SKELETON.index(name)] = level[:, HIP] + [across, -up, 0]
    turned = Rotation.from_euler("y", heading_deg, degrees=True).apply(level.reshape(-1, 3)).reshape(level.shape)
    into = Rotation.from_euler("x", TILT)
    points = into.apply((turned + [-1000, 1500, 5000]).reshape(-1, 3)).reshape(level.shape)
    return Walk(points, stands, 1500.0)
