"""Motion of any body: smooth random joint curves within its limits, step cycles where it has legs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from uplift.simulator.body import ROOT_ANGLES, Body
from uplift.simulator.curves import smooth_noise
from uplift.simulator.legs import find_legs, leg_phases
from uplift.simulator.motion import Motion, choose_actions

__all__ = ["MOTIONS", "own_motion"]

MOTIONS = {"walk": 0.3, "trot": 0.25, "idle": 0.2, "explore": 0.25}
"""Motions of a body with legs and gravity, with their shares. Every other body has only ``explore``, a rigid one ``turn``."""


def own_motion(
    rng: np.random.Generator,
    body: Body,
    clips: int,
    time_s: Float[np.ndarray, " frames"],
    mode: str | list[str],
    gravity: bool,
    follows: dict[str, str],
) -> Motion:
    """Return the joint angles of ``clips`` clips of a body that is not a person."""
    rigid = len(body.angles) == len(ROOT_ANGLES)
    legs = find_legs(body) if gravity and not rigid else []
    shares = MOTIONS if len(legs) >= 2 else {"turn": 1.0} if rigid else {"explore": 1.0}
    motion = Motion.empty(clips, len(time_s), len(body.angles))
    motion.actions = choose_actions(rng, shares, clips, mode)
    reach = np.select([motion.actions == "explore", motion.actions == "idle"], [0.9 if not legs else 0.6, 0.35], 0.4)
    motion.angles_deg = _wander(rng, body, clips, time_s, follows) * reach[:, None, None]
    for gait in ("walk", "trot"):
        rows = np.flatnonzero(motion.actions == gait)
        if len(rows):
            motion.angles_deg[rows], motion.travel[rows] = _step(rng, body, legs, time_s, motion.angles_deg[rows], gait)
    _turn(rng, body, motion, time_s, 0.0 if rigid and gravity else 0.25 if gravity else 1.0, gravity)
    motion.angles_deg = motion.angles_deg.clip(body.low_deg, body.high_deg)
    return motion


def _wander(
    rng: np.random.Generator, body: Body, clips: int, time_s: np.ndarray, follows: dict[str, str]
) -> np.ndarray:
    """Return angles that wander smoothly over the limits; joints of a chain go partly together."""
    chains = _chains(body)
    curve = smooth_noise(rng, time_s, clips, int(max(chains)) + 2, 0.35)
    offset = rng.normal(0, 1.0, (clips, 1, int(max(chains)) + 2))
    shared = (curve + offset)[..., 1:][..., chains] + 0.7 * (curve + offset)[..., :1]
    own = smooth_noise(rng, time_s, clips, len(body.angles), 0.5) + rng.normal(0, 1.0, (clips, 1, len(body.angles)))
    bending = np.array([name.endswith("flexion") for name in body.angles])
    drive = np.where(bending, (0.75 * shared + 0.75 * own) / 1.5, own / 1.4)
    for place, name in enumerate(body.angles):
        joint, angle = name.rsplit(" ", 1)
        leader = f"{follows.get(joint)} {angle}"
        if leader in body.angles:
            drive[..., place] = drive[..., body.angles.index(leader)] + 0.15 * own[..., place]
    # Logistic: uniform enough over the range, never past it.
    share = 1 / (1 + np.exp(-1.7 * drive))
    low, high = np.where(np.isfinite(body.low_deg), [body.low_deg, body.high_deg], 0)
    return low + share * (high - low)


def _chains(body: Body) -> np.ndarray:
    """Return a number for the chain (limb, finger, trunk) each angle belongs to: it starts at a branching."""
    chain = np.zeros(len(body.points), int)
    for point, parent in enumerate(body.parents):
        alone = parent >= 0 and (body.parents == parent).sum() == 1
        chain[point] = chain[parent] if alone else point
    return np.array([chain[body.points.index(name.rsplit(" ", 1)[0])] for name in body.angles])


def _step(
    rng: np.random.Generator, body: Body, legs: list[list[int]], time_s: np.ndarray, angles: np.ndarray, gait: str
) -> tuple[np.ndarray, np.ndarray]:
    """Lay a step cycle over the legs: hips swing, the joints below bend while the foot is in the air."""
    clips = len(angles)
    rate = rng.uniform(0.7, 1.3, (clips, 1)) if gait == "walk" else rng.uniform(1.4, 2.4, (clips, 1))
    size = rng.uniform(0.5, 1.1, (clips, 1))
    start = rng.uniform(0, 1, (clips, 1))
    for leg, lag in zip(legs, leg_phases(body, legs, gait), strict=True):
        phase = 2 * np.pi * (start + rate * time_s - lag)
        swing = np.maximum(np.sin(phase), 0) ** 2
        for depth, point in enumerate(leg[:-1]):
            name = f"{body.points[point]} flexion"
            if name not in body.angles:
                continue
            place = body.angles.index(name)
            low, high = body.low_deg[place], body.high_deg[place]
            if depth == 0:
                angles[..., place] = 0.25 * angles[..., place] - size * min(24, 0.7 * (high - low) / 2) * np.cos(phase)
            else:
                bend = high if high > -low else low
                angles[..., place] = 0.25 * angles[..., place] + size * 0.6 * bend * swing
    speed = rate * size * (0.5 if gait == "walk" else 0.7)
    step = (time_s[1] - time_s[0]) if len(time_s) > 1 else 0.0
    way = np.cumsum(np.broadcast_to(speed * step, (clips, len(time_s))), 1)
    return angles, np.stack([np.zeros_like(way), -way], -1)


def _turn(rng: np.random.Generator, body: Body, motion: Motion, time_s: np.ndarray, sway: float, gravity: bool) -> None:
    """Turn whole bodies: a heading that drifts, pitched and rolled by ``sway``. The camera does the rest."""
    clips = len(motion.actions)
    root = body.points[0]
    heading = rng.uniform(0, 360, (clips, 1)) if gravity else np.zeros((clips, 1))
    drift = 12 * smooth_noise(rng, time_s, clips, 3, 0.25)
    motion.angles_deg[..., body.angles.index(f"{root} turn")] = heading + 1.5 * drift[..., 0]
    motion.angles_deg[..., body.angles.index(f"{root} pitch")] = sway * drift[..., 1]
    motion.angles_deg[..., body.angles.index(f"{root} roll")] = sway * drift[..., 2]
    angle = np.radians(heading)[..., None]
    x, z = motion.travel[..., :1], motion.travel[..., 1:]
    motion.travel = np.concatenate([x * np.cos(angle) - z * np.sin(angle), x * np.sin(angle) + z * np.cos(angle)], -1)
