"""The motion of a simulated person: actions turned into joint angles over time."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from uplift.simulator.actions import ACTIONS, Action
from uplift.simulator.arm_poses import ArmPoses
from uplift.simulator.body import Body
from uplift.simulator.curves import key_times, minimum_jerk_path, smooth_noise
from uplift.simulator.gait import arm_swing, leg_cycle, pelvis_cycle
from uplift.simulator.motion import Motion, choose_actions
from uplift.simulator.postures import LEGS, TRUNK

__all__ = ["human_motion"]

_STRIDES_HZ = {"walk": (0.6, 1.1), "run": (1.15, 1.6), "climb": (0.4, 0.9)}
_STRIDE_HEIGHTS = {"walk": 0.8, "run": 1.25, "climb": 0.3}
_AIRBORNE = ("flight", "split")


def human_motion(
    rng: np.random.Generator, body: Body, clips: int, time_s: Float[np.ndarray, " frames"], mode: str | list[str]
) -> Motion:
    """Return the joint angles of ``clips`` clips of a person in the actions of ``mode``."""
    chosen = choose_actions(rng, {name: action.share for name, action in ACTIONS.items()}, clips, mode)
    arm_poses = ArmPoses(rng, body)
    frames = len(time_s)
    motion = Motion.empty(clips, frames, len(body.angles))
    for name in sorted(set(chosen)):
        rows = np.flatnonzero(chosen == name)
        part = _act(rng, body, ACTIONS[name], len(rows), time_s, arm_poses)
        motion.put(rows, name, part)
    noise = smooth_noise(rng, time_s, clips, len(body.angles), 0.4)
    motion.angles_deg += noise * np.where(np.isfinite(body.low_deg), 1.2, 0.8)
    motion.angles_deg = motion.angles_deg.clip(body.low_deg, body.high_deg)
    return motion


def _act(
    rng: np.random.Generator, body: Body, action: Action, clips: int, time_s: np.ndarray, arm_poses: ArmPoses
) -> Motion:
    moves = _scaled(key_times(rng, clips, time_s[-1] / action.tempo + 0.1), action.tempo)
    keys = moves[0].shape[1]
    motion = Motion.empty(clips, len(time_s), len(body.angles))
    heading = np.cumsum(_heading_speed(rng, action, clips, time_s), 1) * (
        time_s[1] - time_s[0] if len(time_s) > 1 else 0
    )
    heading += rng.uniform(0, 360, (clips, 1))
    trunk = minimum_jerk_path(time_s, moves, _trunk_keys(rng, action.trunk, clips, keys))
    arms = _paths(time_s, moves, arm_poses.keys(rng, [a for a in action.arms if a != "swing"] or ["hang"], clips, keys))
    if action.cycle:
        legs, arms, speed, sway = _stepping(rng, action, time_s, trunk, arms)
        direction = np.radians(heading)
        heading = heading + sway
        velocity = speed[..., None] * np.stack([np.sin(direction), -np.cos(direction)], -1)
        motion.travel += np.cumsum(velocity, 1) * (time_s[1] - time_s[0] if len(time_s) > 1 else 0)
    else:
        names = _leg_names(rng, action.legs, clips, keys, ordered=action is ACTIONS["jump"])
        legs = _grounded(_paths(time_s, moves, _leg_keys(rng, names)))
        motion.lift += _lift(time_s, moves, np.isin(names, _AIRBORNE))
    _write(body, motion.angles_deg, heading, legs, trunk, arms)
    return motion


def _scaled(moves: tuple[np.ndarray, np.ndarray], tempo: float) -> tuple[np.ndarray, np.ndarray]:
    return moves[0] * tempo, moves[1] * tempo


def _paths(time_s: np.ndarray, moves: tuple[np.ndarray, np.ndarray], keys: np.ndarray) -> np.ndarray:
    """Return paths (clips frames 2 angles) through keys (clips keys 2 angles)."""
    path = minimum_jerk_path(time_s, moves, keys.reshape(*keys.shape[:2], -1))
    return path.reshape(*path.shape[:2], 2, -1)


def _heading_speed(rng: np.random.Generator, action: Action, clips: int, time_s: np.ndarray) -> np.ndarray:
    steady = rng.normal(0, action.turn_deg_s, (clips, 1))
    return steady * (1 + smooth_noise(rng, time_s, clips, 1, 0.3)[..., 0])


def _draw(rng: np.random.Generator, ranges: np.ndarray) -> np.ndarray:
    return ranges[..., 0] + rng.uniform(0, 1, ranges.shape[:-1]) * (ranges[..., 1] - ranges[..., 0])


def _trunk_keys(rng: np.random.Generator, names: tuple[str, ...], clips: int, keys: int) -> np.ndarray:
    ranges = np.array([TRUNK[name] for name in names], dtype=float)
    drawn = _draw(rng, ranges[rng.integers(len(names), size=(clips, keys))])
    drawn[..., [1, 3, 4, 6, 7]] *= rng.choice([-1, 1], (clips, keys, 1))
    return drawn


def _leg_names(rng: np.random.Generator, names: tuple[str, ...], clips: int, keys: int, ordered: bool) -> np.ndarray:
    if ordered:
        places = (np.arange(keys) + rng.integers(len(names), size=(clips, 1))) % len(names)
    else:
        places = rng.integers(len(names), size=(clips, keys))
    return np.array(names)[places]


def _leg_keys(rng: np.random.Generator, names: np.ndarray) -> np.ndarray:
    """Return (clips keys 2 6): thigh, abduction, rotation, knee, foot, flat."""
    kinds, places = np.unique(names, return_inverse=True)
    ranges = np.array([[[*leg[:5], (leg[5], leg[5])] for leg in LEGS[kind]] for kind in kinds], dtype=float)
    chosen = ranges[places.reshape(names.shape)]
    share = rng.uniform(0, 1, chosen.shape[:-1])
    alike = rng.uniform(0, 1, (*names.shape, 1)) < 0.6
    share[:, :, 1] = np.where(alike, 0.85 * share[:, :, 0] + 0.15 * share[:, :, 1], share[:, :, 1])
    drawn = chosen[..., 0] + share * (chosen[..., 1] - chosen[..., 0])
    swapped = rng.uniform(0, 1, names.shape) < 0.5
    return np.where(swapped[..., None, None], drawn[:, :, ::-1], drawn)


def _grounded(legs: np.ndarray) -> np.ndarray:
    """Turn thigh, abduction, rotation, knee, foot, flat into thigh, abduction, rotation, knee, ankle."""
    thigh, knee, foot, flat = (legs[..., i] for i in (0, 3, 4, 5))
    ankle = foot + flat * (knee - thigh)
    return np.concatenate([legs[..., :4], ankle[..., None]], -1)


def _stepping(
    rng: np.random.Generator, action: Action, time_s: np.ndarray, trunk: np.ndarray, arms: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return legs, arms, forward speed (heights/s) and the pelvis's turn (deg) of a step cycle; moves the trunk with it."""
    clips = len(trunk)
    rate = rng.uniform(*_STRIDES_HZ[action.cycle], (clips, 1)) * np.where(rng.uniform(size=(clips, 1)) < 0.08, -1, 1)
    phase = rng.uniform(0, 1, (clips, 1)) + rate * time_s + 0.02 * smooth_noise(rng, time_s, clips, 1)[..., 0]
    stride = rng.uniform(0.6, 1.35, (clips, 1))
    crouch = np.where(rng.uniform(size=(clips, 1)) < 0.2, rng.uniform(5, 30, (clips, 1)), 0)
    sagittal = leg_cycle(action.cycle, phase, stride, crouch)
    side = rng.normal([3, -6], [2.5, 5], (clips, 1, 1, 2)) + np.zeros((*phase.shape, 2, 2))
    legs = np.concatenate([sagittal[..., :1], side, sagittal[..., 1:]], -1)
    moving = action.cycle == "run"
    swing = rng.uniform(15, 40, (clips, 1)) if moving else rng.uniform(5, 35, (clips, 1))
    elbow = rng.uniform(60, 105, (clips, 1)) if moving else rng.uniform(10, 40, (clips, 1))
    if "swing" in action.arms:
        swings = (rng.uniform(size=(clips, 1)) < (0.85 if len(action.arms) == 1 else 0.4))[..., None, None]
        arms = np.where(swings, arm_swing(phase, swing * stride, elbow, rng.uniform(3, 18, (clips, 1))), arms)
    turn, drop, against = np.moveaxis(pelvis_cycle(phase) * stride[..., None], -1, 0)
    trunk[..., 0] += rng.uniform(0, 10, (clips, 1)) if moving else 0
    trunk[..., 1] += 4 * drop
    trunk[..., 3] -= 4 * drop
    trunk[..., 4] += 5 * against
    return legs, arms, rate * stride * _STRIDE_HEIGHTS[action.cycle], 4.5 * turn


def _lift(time_s: np.ndarray, moves: tuple[np.ndarray, np.ndarray], airborne: np.ndarray) -> np.ndarray:
    """Return the height of the feet above the floor (body heights): a ballistic arc about each airborne key."""
    starts, durations = moves
    lift = np.zeros((len(starts), len(time_s)))
    for key in range(1, starts.shape[1]):
        take_off = starts[:, key - 1] + 0.5 * durations[:, key - 1]
        landing = np.minimum(starts[:, key] + 0.5 * durations[:, key], take_off + 0.65)
        share = ((time_s - take_off[:, None]) / (landing - take_off)[:, None]).clip(0, 1)
        height = 9.81 * (landing - take_off) ** 2 / 8 / 1.7
        lift += np.where(airborne[:, key], height, 0)[:, None] * 4 * share * (1 - share)
    return lift


def _write(
    body: Body, angles: np.ndarray, heading: np.ndarray, legs: np.ndarray, trunk: np.ndarray, arms: np.ndarray
) -> None:
    """Write legs (against the vertical), trunk and arms into the body's joint angles."""

    def put(name: str, value: np.ndarray) -> None:
        angles[..., body.angles.index(name)] = value

    pitch, roll, bend, lateral, twist, nod, tilt, look = np.moveaxis(trunk, -1, 0)
    for name, value in (("turn", heading), ("pitch", pitch), ("roll", roll)):
        put(f"pelvis {name}", value)
    # The thoracolumbar shares: lumbar 60 % of bending forward, 20 % of turning (White & Panjabi 1990).
    for point, shares in (("lumbar", (0.6, 0.45, 0.2)), ("spine", (0.4, 0.55, 0.8))):
        for name, share, value in zip(("flexion", "lateral", "rotation"), shares, (bend, lateral, twist), strict=True):
            put(f"{point} {name}", share * value)
    for point in ("neck", "head"):
        for name, value in (("flexion", nod), ("lateral", tilt), ("rotation", look)):
            put(f"{point} {name}", 0.5 * value)
    for side, sign, place in (("left", 1, 0), ("right", -1, 1)):
        thigh, out, inward, knee, ankle = np.moveaxis(legs[..., place, :], -1, 0)
        values = {
            "hip flexion": thigh + pitch, "hip abduction": out + sign * roll, "hip rotation": inward,
            "knee flexion": knee, "ankle flexion": ankle,
        }  # fmt: skip
        plane, elevation, rotation, elbow, pronation, wrist = np.moveaxis(arms[..., place, :], -1, 0)
        values |= {
            # Inman, Saunders & Abbott 1944: the girdle gives a third of raising the arm past 30 degrees;
            # the clavicle itself about 30 degrees in all.
            "clavicle elevation": 0.21 * np.maximum(elevation - 30, 0),
            "clavicle protraction": 0.2 * (plane - 30).clip(-60, 90) * np.sin(np.radians(elevation)),
            "shoulder plane": plane, "shoulder elevation": elevation, "shoulder rotation": rotation,
            "elbow flexion": elbow, "elbow pronation": pronation, "wrist flexion": wrist,
        }  # fmt: skip
        for name, value in values.items():
            put(f"{side}_{name}", value)
