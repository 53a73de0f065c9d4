"""Arm postures that stay out of the body: drawn from their ranges, kept where nothing collides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from uplift.simulator.body import Body
from uplift.simulator.kinematics import forward_kinematics
from uplift.simulator.postures import ARMS

__all__ = ["ArmPoses"]

_DRAWN = 500
_ANGLES = (
    "shoulder plane",
    "shoulder elevation",
    "shoulder rotation",
    "elbow flexion",
    "elbow pronation",
    "wrist flexion",
)
# Half breadth, height and depth of chest and head, shares of stature (ANSUR II: chest breadth 0.165,
# chest depth 0.14, head breadth 0.088, head length 0.113).
_SOLIDS = (((0.0, -0.15, 0.0), (0.082, 0.20, 0.066)), ((0.0, -0.415, -0.015), (0.05, 0.075, 0.06)))


class ArmPoses:
    """Collision-free arm postures by name."""

    def __init__(self, rng: np.random.Generator, body: Body) -> None:
        self._pools = {}
        for name, ranges in ARMS.items():
            low, high = np.array(ranges, dtype=float).T
            drawn = low + rng.uniform(0, 1, (_DRAWN, len(_ANGLES))) * (high - low)
            drawn = drawn[_reachable(drawn)]
            self._pools[name] = drawn[_clear(body, drawn)]

    def keys(
        self, rng: np.random.Generator, names: Sequence[str], clips: int, keys: int
    ) -> Float[np.ndarray, "clips keys 2 6"]:
        """Return random postures of both arms out of ``names``; two keys in five have both arms alike."""
        pools = [self._pools[name] for name in names]
        starts = np.cumsum([0] + [len(pool) for pool in pools[:-1]])
        sizes = np.array([len(pool) for pool in pools])
        which = rng.integers(len(pools), size=(clips, keys, 2))
        row = (rng.uniform(size=which.shape) * sizes[which]).astype(int)
        drawn = np.concatenate(pools)[starts[which] + row]
        alike = rng.uniform(size=(clips, keys)) < 0.4
        drawn[:, :, 1] = np.where(alike[..., None], drawn[:, :, 0], drawn[:, :, 1])
        return drawn


def _reachable(arms: Float[np.ndarray, "poses angles"]) -> Bool[np.ndarray, " poses"]:
    """Tell where the arm can go: backward up to 60 degrees (AAOS 1965), across the chest up to shoulder height."""
    plane, elevation = arms[:, 0], arms[:, 1]
    behind = np.interp(plane, [-90, -40, 0, 40], [60, 90, 140, 175])
    across = np.interp(plane, [100, 130], [175, 100])
    return (elevation < behind) & (elevation < across)


def _clear(body: Body, arms: Float[np.ndarray, "poses angles"]) -> Bool[np.ndarray, " poses"]:
    """Tell where elbow, forearm and hand of a standing body stay out of its chest and head."""
    angles = np.zeros((len(arms), len(body.angles)))
    for column, name in enumerate(_ANGLES):
        angles[:, body.angles.index(f"left_{name}")] = arms[:, column]
    points = forward_kinematics(body, np.repeat(body.offsets[None], len(arms), 0), angles)
    elbow, wrist, tip = (points[:, body.points.index(f"left_{name}")] for name in ("elbow", "wrist", "fingertip"))
    clear = np.ones(len(arms), bool)
    for part in (elbow, (elbow + wrist) / 2, (elbow + 3 * wrist) / 4, wrist, tip):
        for centre, half in _SOLIDS:
            clear &= (((part - centre) / half) ** 2).sum(-1) > 1
        clear &= part[:, 0] > -0.12
    return clear
