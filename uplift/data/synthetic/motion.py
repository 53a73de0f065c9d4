"""Motion of any body: smooth random joint curves within its limits, step cycles where it has legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from uplift.data.synthetic.body import ROOT_ANGLES, Body, find_legs, leg_phases
from uplift.errors import UserError, did_you_mean

__all__ = ["Motion", "choose_actions", "minimum_jerk", "own_motion", "periodic_curve", "smooth_noise"]


@dataclass
class Motion:
    """Joint angles over time and where the body is, clip by clip."""

    angles_deg: Float[np.ndarray, "clips frames angles"]
    lift: Float[np.ndarray, "clips frames"]
    """Height of the lowest point above the floor, body heights."""
    travel: Float[np.ndarray, "clips frames 2"]
    """Position on the floor (x, z), body heights."""
    actions: np.ndarray
    """(clips,) names."""

    @classmethod
    def empty(cls, clips: int, frames: int, angles: int) -> Motion:
        """Return a motion at rest in the rest pose."""
        return cls(
            np.zeros((clips, frames, angles)), np.zeros((clips, frames)), np.zeros((clips, frames, 2)),
            np.full(clips, "", dtype="<U32"),
        )  # fmt: skip


def choose_actions(
    rng: np.random.Generator, shares: dict[str, float], clips: int, mode: str | list[str] | tuple[str, ...]
) -> np.ndarray:
    """Return an action for each clip, in proportion to ``shares``; raises UserError for an unknown one.

    ``mode`` is ``all`` or a list of actions.
    """
    wanted = list(shares) if mode == "all" else [mode] if isinstance(mode, str) else list(mode)
    for name in wanted:
        if name not in shares:
            raise UserError(f"motion '{name}' is unknown for this body.{did_you_mean(name, ('all', *shares))}")
    if not wanted:
        raise UserError("mode is an empty list: expected 'all' or at least one motion.")
    weights = np.array([shares[name] for name in wanted])
    # Even shares first, then chance: a small sample still shows a bit of everything.
    quota = (np.arange(clips) + rng.uniform()) / clips
    places = np.searchsorted(np.cumsum(weights) / weights.sum(), quota).clip(0, len(wanted) - 1)
    return rng.permutation(np.array(wanted, dtype="<U32")[places])


_KeyTimes = tuple[np.ndarray, np.ndarray]
"""Start and duration of each move, (clips moves) s."""


def key_times(rng: np.random.Generator, clips: int, seconds: float) -> _KeyTimes:
    """Return random moves that fill ``seconds``: each clip has its own tempo, moves are followed by holds."""
    tempo = np.exp(rng.normal(np.log(0.9), 0.45, (clips, 1))).clip(0.35, 3.0)
    moves = int(np.ceil(seconds / 0.35)) + 2
    gaps = tempo * rng.uniform(0.6, 1.5, (clips, moves))
    starts = np.cumsum(gaps, 1) - gaps - rng.uniform(0, 1, (clips, 1)) * gaps[:, :1]
    return starts, gaps * rng.uniform(0.6, 1.0, (clips, moves))


def minimum_jerk(
    time_s: Float[np.ndarray, " frames"], moves: _KeyTimes, values: Float[np.ndarray, "clips keys angles"]
) -> Float[np.ndarray, "clips frames angles"]:
    """Return the path through ``values`` with a minimum-jerk move from each to the next (Flash & Hogan 1985)."""
    starts, durations = moves
    path = np.repeat(values[:, :1], len(time_s), 1)
    for move in range(min(starts.shape[1], values.shape[1] - 1)):
        share = ((time_s - starts[:, move, None]) / durations[:, move, None]).clip(0, 1)
        eased = share**3 * (10 - 15 * share + 6 * share**2)
        path += eased[..., None] * (values[:, move + 1] - values[:, move])[:, None]
    return path


def smooth_noise(
    rng: np.random.Generator, time_s: Float[np.ndarray, " frames"], clips: int, angles: int, hz: float = 0.5
) -> Float[np.ndarray, "clips frames angles"]:
    """Return noise of unit variance made of four random sines of up to twice ``hz``."""
    rates = 2 * np.pi * hz * rng.uniform(0.2, 2.0, (4, clips, 1, angles))
    phases = rng.uniform(0, 2 * np.pi, rates.shape)
    return (np.sin(rates * time_s[:, None] + phases) / np.sqrt(2)).sum(0)


def periodic_curve(
    points: tuple[int, ...] | tuple[float, ...], phase: Float[np.ndarray, "*frames"], harmonics: int = 6
) -> Float[np.ndarray, "*frames"]:
    """Return the Fourier curve through evenly spaced ``points`` of one cycle at ``phase`` (cycles)."""
    spectrum = np.fft.rfft(points) / len(points)
    value = np.full(np.shape(phase), spectrum[0].real)
    for harmonic in range(1, min(harmonics, (len(points) - 1) // 2) + 1):
        turn = 2 * np.pi * harmonic * phase
        value += 2 * (spectrum[harmonic].real * np.cos(turn) - spectrum[harmonic].imag * np.sin(turn))
    return value


_MOTIONS = {"walk": 0.3, "trot": 0.25, "idle": 0.2, "explore": 0.25}
"""Motions of a body with legs and gravity, with their shares. Every other body has only ``explore``, a rigid one ``turn``."""


def own_motion(
    rng: np.random.Generator, body: Body, clips: int, time_s: Float[np.ndarray, " frames"], mode: str | list[str],
    gravity: bool, follows: dict[str, str],
) -> Motion:  # fmt: skip
    """Return the joint angles of ``clips`` clips of a body that is not a person."""
    rigid = len(body.angles) == len(ROOT_ANGLES)
    legs = find_legs(body) if gravity and not rigid else []
    shares = _MOTIONS if len(legs) >= 2 else {"turn": 1.0} if rigid else {"explore": 1.0}
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
    count = int(max(chains)) + 2
    curve = smooth_noise(rng, time_s, clips, count, 0.35) + rng.normal(0, 1.0, (clips, 1, count))
    shared = curve[..., 1:][..., chains] + 0.7 * curve[..., :1]
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
    travel = np.cumsum(np.broadcast_to(speed * step, (clips, len(time_s))), 1)
    return angles, np.stack([np.zeros_like(travel), -travel], -1)


def _turn(rng: np.random.Generator, body: Body, motion: Motion, time_s: np.ndarray, sway: float, gravity: bool) -> None:
    """Rotate the bodies: a heading that drifts, pitch and roll up to ``sway``. The camera does the rest."""
    clips = len(motion.actions)
    root = body.points[0]
    heading = rng.uniform(0, 360, (clips, 1)) if gravity else np.zeros((clips, 1))
    drift = 12 * smooth_noise(rng, time_s, clips, 3, 0.25)
    values = heading + 1.5 * drift[..., 0], sway * drift[..., 1], sway * drift[..., 2]
    for name, value in zip(ROOT_ANGLES, values, strict=True):
        motion.angles_deg[..., body.angle(root, name)] = value
    angle = np.radians(heading)[..., None]
    x, z = motion.travel[..., :1], motion.travel[..., 1:]
    motion.travel = np.concatenate([x * np.cos(angle) - z * np.sin(angle), x * np.sin(angle) + z * np.cos(angle)], -1)
