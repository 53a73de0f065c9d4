"""The motion of a simulated person: from actions and postures to joint angles over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from uplift.data.synthetic.body import Body, forward_kinematics
from uplift.data.synthetic.motion import Motion, choose_actions, key_times, minimum_jerk, periodic_curve, smooth_noise

__all__ = ["ACTIONS", "CYCLES", "human_motion"]


@dataclass(frozen=True)
class _Action:
    """Postures to move between at its own tempo; with a step cycle, no leg postures."""

    share: float
    """Share of clips when every action is on."""
    legs: tuple[str, ...]
    trunk: tuple[str, ...]
    arms: tuple[str, ...]
    """``swing`` swings them with the steps."""
    cycle: str = ""
    """A key of `CYCLES`."""
    tempo: float = 1.0
    """Time between postures against the usual one."""
    turn_deg_s: float = 15.0
    """Standard deviation of the turning speed."""


_EASY = ("hang", "hang", "low", "hip", "folded", "to face", "behind", "guard")
_WIDE = ("forward", "low", "out", "overhead", "across", "elbows out", "on head", "any")

ACTIONS = {
    "walk": _Action(0.12, (), ("upright", "slouch"), ("swing",), "walk", turn_deg_s=25.0),
    "walk busy": _Action(0.05, (), ("upright", "lean", "twist", "side"), (*_EASY, *_WIDE), "walk", turn_deg_s=35.0),
    "run": _Action(0.07, (), ("upright", "lean"), ("swing",), "run", turn_deg_s=40.0),
    "climb": _Action(0.04, (), ("upright", "lean"), ("swing", "forward", "overhead", "low", "hang"), "climb"),
    "stand": _Action(0.06, ("stand", "stand", "wide", "crossed"), ("upright", "slouch"), _EASY, tempo=1.5),
    "gesture": _Action(0.08, ("stand", "step", "wide"), ("upright", "lean", "twist", "side"), (*_EASY, *_WIDE)),
    "reach": _Action(
        0.08, ("stand", "tiptoe", "step", "half squat", "lunge"), ("upright", "lean", "arch", "twist", "side"),
        ("forward", "overhead", "low", "out", "across"),
    ),
    "bend": _Action(0.06, ("stand", "wide", "half squat", "step"), ("bend", "bend", "lean", "upright"), ("low", "forward", "hang", "any")),
    "squat": _Action(0.05, ("squat", "half squat", "stand", "wide"), ("lean", "bend", "upright"), ("low", "forward", "hang", "out", "to face")),
    "sit": _Action(0.07, ("sit", "sit", "sit crossed", "ankle on knee", "stand"), ("upright", "slouch", "lean", "twist"), (*_EASY, "forward", "low"), tempo=1.4),
    "floor": _Action(0.02, ("tailor seat", "floor seat", "huddle"), ("upright", "slouch", "lean"), ("low", "behind", "forward", "folded")),
    "kneel": _Action(0.03, ("kneel", "half kneel", "heel seat", "stand"), ("upright", "lean", "bend"), (*_EASY, "low", "forward", "overhead")),
    "crawl": _Action(0.015, ("kneel", "half kneel"), ("crawl",), ("support", "support", "low")),
    "lie": _Action(0.004, ("supine",), ("supine",), ("hang", "out", "overhead", "any")),
    "lie prone": _Action(0.002, ("prone",), ("prone",), ("hang", "out", "overhead")),
    "fight": _Action(
        0.08, ("guard", "guard", "lunge", "front kick", "side kick", "knee up"), ("upright", "twist", "tilt", "lean"),
        ("guard", "guard", "punch", "hang", "across", "low"), tempo=0.7, turn_deg_s=50.0,
    ),
    "kick": _Action(0.03, ("stand", "step", "front kick", "side kick", "back kick", "knee up"), ("upright", "tilt", "arch", "lean"), ("out", "guard", "any", "hang"), tempo=0.7),
    "dance": _Action(
        0.10, ("stand", "tiptoe", "passe", "leg out", "back kick", "crossed", "lunge", "wide", "split", "knee up", "half squat"),
        ("upright", "arch", "side", "twist", "tilt"), ("overhead", "out", "across", "hip", "elbows out", "forward", "any"), tempo=0.8, turn_deg_s=90.0,
    ),
    "jump": _Action(
        0.05, ("half squat", "flight", "half squat", "split", "stand", "squat"), ("upright", "lean", "arch"),
        ("hang", "overhead", "behind", "forward", "out"), tempo=0.55, turn_deg_s=30.0,
    ),
    "step": _Action(0.04, ("step", "side lunge", "lunge", "crossed", "high step", "half squat"), ("upright", "lean", "twist"), (*_EASY, *_WIDE), tempo=0.8, turn_deg_s=60.0),
    "loose": _Action(0.06, ("loose", "loose", "stand", "flight", "half squat"), ("loose",), ("any",), tempo=0.9, turn_deg_s=50.0),
}  # fmt: skip


# Human postures as ranges of angles: what legs, trunk and arms do in everyday, sport and dance poses.

FLAT, FREE = 1.0, 0.0

# One leg: thigh forward of the vertical, abduction, inward rotation, knee, foot: with FLAT the pitch
# of the sole (toes up), with FREE the ankle. A posture: (one leg, the other).
_STAND = ((-4, 8), (1, 9), (-15, 2), (4, 14), (-2, 2), FLAT)
_STANCE = ((-6, 14), (0, 10), (-15, 5), (4, 30), (-12, 2), FLAT)
_TIPTOE = ((-4, 8), (1, 8), (-20, 0), (4, 12), (-45, -25), FLAT)
_LEGS = {
    "stand": (_STAND, _STAND),
    "wide": (((-5, 15), (12, 30), (-25, 0), (4, 40), (-3, 3), FLAT),) * 2,
    "tiptoe": (_TIPTOE, _TIPTOE),
    "step": (((10, 30), (0, 10), (-15, 5), (5, 30), (-5, 15), FLAT), ((-25, -5), (0, 8), (-15, 5), (5, 40), (-40, 0), FLAT)),
    "half squat": (((20, 50), (5, 20), (-20, 0), (40, 80), (-3, 3), FLAT),) * 2,
    "squat": (((60, 112), (5, 25), (-20, 5), (85, 142), (-20, 3), FLAT),) * 2,
    "lunge": (((40, 85), (0, 15), (-15, 10), (60, 105), (-3, 3), FLAT), ((-28, 0), (0, 15), (-15, 10), (5, 75), (-55, -10), FLAT)),
    "side lunge": (((20, 60), (15, 35), (-30, 0), (45, 100), (-3, 3), FLAT), ((0, 20), (25, 45), (-15, 5), (4, 15), (-3, 3), FLAT)),
    "guard": (((12, 38), (2, 14), (-10, 10), (15, 50), (-8, 3), FLAT), ((-22, 5), (4, 18), (-30, 0), (10, 45), (-25, 3), FLAT)),
    "knee up": (((55, 120), (0, 20), (-20, 15), (60, 135), (-40, 10), FREE), _STANCE),
    "front kick": (((50, 115), (0, 15), (-15, 15), (4, 60), (-45, 10), FREE), _STANCE),
    "side kick": (((15, 75), (35, 60), (-10, 30), (4, 70), (-30, 15), FREE), _STANCE),
    "back kick": (((-35, -10), (0, 20), (-20, 20), (4, 95), (-45, 0), FREE), ((0, 25), (0, 8), (-15, 5), (5, 40), (-12, 2), FLAT)),
    "leg out": (((-5, 35), (15, 50), (-40, 0), (4, 40), (-50, -10), FREE), _STANCE),
    "passe": (((30, 70), (15, 50), (-50, -15), (60, 130), (-50, -20), FREE), _STANCE),
    "crossed": (((5, 20), (-18, -4), (-25, 10), (5, 30), (-15, 5), FLAT), ((-10, 5), (-12, 2), (-20, 5), (4, 20), (-15, 5), FLAT)),
    "sit": (((72, 100), (0, 18), (-12, 12), (60, 112), (-8, 8), FLAT),) * 2,
    "sit crossed": (((75, 95), (-12, 10), (-10, 15), (60, 100), (-10, 15), FREE), ((75, 95), (0, 10), (-10, 10), (75, 100), (-3, 3), FLAT)),
    "ankle on knee": (((75, 95), (30, 50), (-48, -35), (95, 115), (-15, 10), FREE), ((75, 95), (0, 10), (-10, 10), (75, 100), (-3, 3), FLAT)),
    "tailor seat": (((85, 105), (30, 45), (-50, -35), (115, 140), (-35, -5), FREE),) * 2,
    "floor seat": (((106, 118), (0, 20), (-10, 10), (34, 54), (-30, 10), FREE),) * 2,
    "huddle": (((122, 134), (0, 15), (-10, 10), (68, 86), (-5, 15), FREE),) * 2,
    "kneel": (((-5, 15), (2, 15), (-10, 10), (75, 115), (-45, -10), FREE),) * 2,
    "heel seat": (((55, 80), (2, 15), (-10, 10), (135, 146), (-45, -25), FREE),) * 2,
    "half kneel": (((75, 100), (0, 15), (-10, 10), (75, 110), (-3, 3), FLAT), ((-12, 15), (0, 12), (-10, 10), (80, 120), (-40, 5), FREE)),
    "flight": (((-15, 60), (0, 25), (-20, 10), (5, 95), (-45, 0), FREE),) * 2,
    "split": (((30, 90), (0, 25), (-25, 10), (4, 50), (-45, 0), FREE), ((-38, -5), (0, 25), (-25, 10), (4, 80), (-50, -10), FREE)),
    "high step": (((55, 100), (0, 25), (-20, 10), (60, 115), (-10, 10), FLAT), _STANCE),
    "supine": (((85, 150), (0, 20), (-20, 10), (4, 120), (-45, 0), FREE),) * 2,
    "prone": (((-95, -75), (0, 20), (-20, 10), (4, 70), (-50, -10), FREE),) * 2,
    "loose": (((-20, 80), (-8, 40), (-35, 25), (4, 120), (-45, 15), FREE), _STANCE),
}  # fmt: skip

# Pelvis forward, pelvis to the left, spine flexion, to the left, turn to the left; neck flexion, to the
# left, turn to the left. Sides are drawn either way.
_TRUNK = {
    "upright": ((-3, 10), (-3, 3), (-5, 8), (-4, 4), (-8, 8), (-8, 12), (-6, 6), (-25, 25)),
    "slouch": ((-10, 8), (-5, 5), (5, 30), (-8, 8), (-12, 12), (0, 25), (-8, 8), (-30, 30)),
    "lean": ((10, 35), (-5, 5), (0, 25), (-10, 10), (-20, 20), (-20, 10), (-8, 8), (-30, 30)),
    "bend": ((25, 75), (-8, 8), (15, 60), (-12, 12), (-25, 25), (-25, 20), (-10, 10), (-30, 30)),
    "arch": ((-15, 5), (-6, 6), (-28, -8), (-12, 12), (-20, 20), (-40, 0), (-10, 10), (-30, 30)),
    "side": ((-5, 12), (-15, 15), (-5, 12), (-35, 35), (-20, 20), (-10, 12), (-20, 20), (-30, 30)),
    "twist": ((-3, 12), (-6, 6), (-5, 15), (-12, 12), (-42, 42), (-10, 12), (-8, 8), (-60, 60)),
    "crawl": ((60, 90), (-6, 6), (-15, 20), (-12, 12), (-15, 15), (-40, 5), (-10, 10), (-30, 30)),
    "supine": ((-95, -75), (-6, 6), (-5, 20), (-8, 8), (-15, 15), (-10, 20), (-10, 10), (-40, 40)),
    "prone": ((80, 95), (-6, 6), (-25, 0), (-8, 8), (-15, 15), (-40, 0), (-10, 10), (-40, 40)),
    "tilt": ((-10, 40), (5, 35), (-10, 25), (-30, 10), (-30, 30), (-15, 15), (-20, 20), (-40, 40)),
    "loose": ((-15, 45), (-15, 15), (-25, 50), (-25, 25), (-35, 35), (-30, 30), (-20, 20), (-50, 50)),
}  # fmt: skip

# Plane of elevation (0 sideways, 90 forward), elevation from hanging, inward rotation, elbow,
# pronation, wrist flexion.
_ARMS = {
    "hang": ((0, 90), (3, 20), (-5, 45), (5, 40), (40, 100), (-10, 20)),
    "behind": ((-90, -50), (15, 50), (0, 60), (5, 70), (40, 120), (-20, 20)),
    "forward": ((65, 105), (45, 110), (-20, 70), (3, 60), (20, 110), (-30, 30)),
    "low": ((50, 110), (15, 60), (-10, 60), (5, 75), (20, 110), (-30, 30)),
    "out": ((-25, 35), (55, 110), (-60, 60), (3, 50), (20, 120), (-30, 30)),
    "overhead": ((10, 100), (120, 172), (-50, 40), (3, 70), (20, 120), (-30, 30)),
    "guard": ((45, 100), (15, 65), (-10, 50), (90, 142), (20, 120), (-15, 15)),
    "punch": ((70, 115), (65, 105), (0, 70), (3, 30), (60, 140), (-10, 10)),
    "hip": ((-40, 5), (25, 50), (40, 75), (75, 115), (40, 110), (-10, 40)),
    "on head": ((5, 70), (85, 140), (-80, 0), (95, 145), (20, 120), (-20, 30)),
    "folded": ((65, 110), (20, 50), (40, 78), (85, 115), (40, 110), (-10, 30)),
    "to face": ((40, 100), (25, 85), (-10, 60), (110, 146), (20, 120), (-20, 50)),
    "across": ((95, 128), (40, 110), (0, 70), (10, 100), (20, 120), (-20, 30)),
    "elbows out": ((-20, 45), (55, 105), (-60, 75), (60, 130), (20, 120), (-30, 30)),
    "support": ((75, 105), (65, 105), (-10, 40), (3, 40), (60, 140), (-60, 0)),
    "any": ((-60, 125), (5, 165), (-70, 78), (3, 140), (10, 140), (-40, 50)),
}  # fmt: skip


# Arm postures that stay out of the body: drawn from their ranges, kept where nothing collides.

_DRAWN = 500
_ANGLES = (
    "shoulder plane", "shoulder elevation", "shoulder rotation", "elbow flexion", "elbow pronation", "wrist flexion",
)  # fmt: skip
# Half breadth, height and depth of chest and head, shares of stature (ANSUR II: chest breadth 0.165,
# chest depth 0.14, head breadth 0.088, head length 0.113).
_SOLIDS = (((0.0, -0.15, 0.0), (0.082, 0.20, 0.066)), ((0.0, -0.415, -0.015), (0.05, 0.075, 0.06)))


def _arm_poses(rng: np.random.Generator, body: Body) -> dict[str, np.ndarray]:
    """Return arm postures (poses 6) by name that collide with nothing."""
    poses = {}
    for name, ranges in _ARMS.items():
        low, high = np.array(ranges, dtype=float).T
        drawn = low + rng.uniform(0, 1, (_DRAWN, len(_ANGLES))) * (high - low)
        drawn = drawn[_reachable(drawn)]
        poses[name] = drawn[_clear(body, drawn)]
    return poses


def _arm_keys(
    rng: np.random.Generator, pools: Sequence[np.ndarray], clips: int, keys: int
) -> Float[np.ndarray, "clips keys 2 6"]:
    """Return random postures of both arms out of ``pools``; two keys in five have both arms alike."""
    sizes = np.array([len(pool) for pool in pools])
    which = rng.integers(len(pools), size=(clips, keys, 2))
    row = (rng.uniform(size=which.shape) * sizes[which]).astype(int)
    drawn = np.concatenate(pools)[(np.cumsum(sizes) - sizes)[which] + row]
    alike = rng.uniform(size=(clips, keys)) < 0.4
    drawn[:, :, 1] = np.where(alike[..., None], drawn[:, :, 0], drawn[:, :, 1])
    return drawn


def _reachable(arms: Float[np.ndarray, "poses angles"]) -> Bool[np.ndarray, " poses"]:
    """Return which poses an arm can reach: backward up to 60 degrees (AAOS 1965), across the chest up to shoulder height."""
    plane, elevation = arms[:, 0], arms[:, 1]
    behind = np.interp(plane, [-90, -40, 0, 40], [60, 90, 140, 175])
    across = np.interp(plane, [100, 130], [175, 100])
    return (elevation < behind) & (elevation < across)


def _clear(body: Body, arms: Float[np.ndarray, "poses angles"]) -> Bool[np.ndarray, " poses"]:
    """Return in which poses elbow, forearm and hand of a standing body stay out of its chest and head."""
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


# Step cycles of a person: leg, arm and trunk angles of walking, running and climbing stairs.

# name: (thigh forward, knee flexion, ankle dorsiflexion)
CYCLES = {
    "walk": (
        (20, 20, 18, 14, 9, 4, -1, -6, -11, -16, -19, -18, -11, -1, 9, 17, 22, 24, 23, 21),
        (5, 11, 16, 18, 17, 14, 10, 7, 5, 5, 8, 18, 34, 51, 60, 60, 50, 34, 16, 6),
        (0, -5, -4, 0, 3, 5, 7, 8, 9, 10, 8, 1, -11, -18, -13, -6, -2, 0, 1, 1),
    ),
    "run": (
        (32, 30, 26, 19, 10, 1, -8, -15, -19, -18, -11, 0, 13, 25, 35, 42, 45, 44, 40, 35),
        (15, 26, 38, 43, 42, 36, 28, 22, 21, 30, 46, 65, 82, 92, 95, 88, 72, 50, 28, 15),
        (6, 10, 17, 23, 25, 21, 12, -3, -18, -22, -16, -8, -3, 0, 2, 3, 4, 5, 6, 6),
    ),
    "climb": (
        (50, 49, 44, 38, 31, 24, 18, 13, 8, 4, 1, 0, 3, 15, 32, 47, 57, 60, 58, 53),
        (62, 60, 54, 47, 40, 32, 25, 19, 14, 10, 9, 14, 32, 60, 84, 94, 92, 84, 74, 66),
        (12, 13, 14, 13, 12, 10, 8, 6, 4, 1, -2, -10, -18, -14, -2, 6, 10, 12, 12, 12),
    ),
}  # fmt: skip


_OverTime = Float[np.ndarray, "clips frames"]
_PerClip = Float[np.ndarray, "clips 1"]


def _leg_cycle(
    name: str, phase: _OverTime, stride: _PerClip, crouch_deg: _PerClip
) -> Float[np.ndarray, "clips frames 2 3"]:
    """Return thigh, knee and ankle of both legs (left first), half a cycle apart.

    ``stride`` scales the swing of the thigh, ``crouch_deg`` lowers the body with the feet under it.
    """
    both = np.stack([phase, phase + 0.5], -1)
    thigh, knee, ankle = (periodic_curve(points, both) for points in CYCLES[name])
    scale, crouch = stride[..., None], crouch_deg[..., None]
    knee = 4 + (knee - 4) * np.sqrt(scale)
    return np.stack([thigh * scale + crouch, knee + 2 * crouch, ankle + crouch], -1)


def _arm_swing(
    phase: _OverTime, swing_deg: _PerClip, elbow_deg: _PerClip, out_deg: _PerClip
) -> Float[np.ndarray, "clips frames 2 6"]:
    """Return the arm angles (plane, elevation, rotation, elbow, pronation, wrist) of both swinging arms."""
    both = np.stack([phase, phase + 0.5], -1)
    swing = -np.cos(2 * np.pi * (both - 0.02))
    forward = np.radians(swing_deg[..., None] * (swing + 0.15))
    outward = np.radians(out_deg)[..., None] + np.zeros_like(forward)
    plane = np.degrees(np.arctan2(np.sin(forward), np.tan(outward)))
    elevation = np.degrees(np.arccos((np.cos(forward) * np.cos(outward)).clip(-1, 1)))
    elbow = elbow_deg[..., None] + 0.5 * swing_deg[..., None] * swing
    rest = np.zeros_like(elbow)
    return np.stack([plane, elevation, rest + 15, elbow, rest + 70, rest], -1)


# From actions to joint angles over time.

_STRIDES_HZ = {"walk": (0.6, 1.1), "run": (1.15, 1.6), "climb": (0.4, 0.9)}
_STRIDE_HEIGHTS = {"walk": 0.8, "run": 1.25, "climb": 0.3}


def human_motion(
    rng: np.random.Generator, body: Body, clips: int, time_s: Float[np.ndarray, " frames"], mode: str | list[str]
) -> Motion:
    """Return the joint angles of ``clips`` clips of a person in the actions of ``mode``."""
    chosen = choose_actions(rng, {name: action.share for name, action in ACTIONS.items()}, clips, mode)
    arm_poses = _arm_poses(rng, body)
    motion = Motion.empty(clips, len(time_s), len(body.angles))
    motion.actions = chosen
    for name in sorted(set(chosen)):
        rows = np.flatnonzero(chosen == name)
        part = _act(rng, body, ACTIONS[name], len(rows), time_s, arm_poses)
        motion.angles_deg[rows], motion.lift[rows], motion.travel[rows] = part.angles_deg, part.lift, part.travel
    noise = smooth_noise(rng, time_s, clips, len(body.angles), 0.4)
    motion.angles_deg += noise * np.where(np.isfinite(body.low_deg), 1.2, 0.8)
    motion.angles_deg = motion.angles_deg.clip(body.low_deg, body.high_deg)
    return motion


def _act(
    rng: np.random.Generator, body: Body, action: _Action, clips: int, time_s: np.ndarray, arm_poses: dict
) -> Motion:
    starts, durations = key_times(rng, clips, time_s[-1] / action.tempo + 0.1)
    moves = starts * action.tempo, durations * action.tempo
    keys = starts.shape[1]
    step = time_s[1] - time_s[0] if len(time_s) > 1 else 0
    motion = Motion.empty(clips, len(time_s), len(body.angles))
    speed_deg = rng.normal(0, action.turn_deg_s, (clips, 1)) * (1 + smooth_noise(rng, time_s, clips, 1, 0.3)[..., 0])
    heading = np.cumsum(speed_deg, 1) * step + rng.uniform(0, 360, (clips, 1))
    trunk = minimum_jerk(time_s, moves, _trunk_keys(rng, action.trunk, clips, keys))
    pools = [arm_poses[name] for name in action.arms if name != "swing"] or [arm_poses["hang"]]
    arms = _paths(time_s, moves, _arm_keys(rng, pools, clips, keys))
    if action.cycle:
        legs, arms, speed, sway = _stepping(rng, action, time_s, trunk, arms)
        velocity = speed[..., None] * np.stack([np.sin(np.radians(heading)), -np.cos(np.radians(heading))], -1)
        motion.travel += np.cumsum(velocity, 1) * step
        heading = heading + sway
    else:
        places = rng.integers(len(action.legs), size=(clips, 1 if action is ACTIONS["jump"] else keys))
        if action is ACTIONS["jump"]:  # in order
            places = (np.arange(keys) + places) % len(action.legs)
        names = np.array(action.legs)[places]
        thigh_to_knee, foot, flat = np.split(_paths(time_s, moves, _leg_keys(rng, names)), [4, 5], -1)
        ankle = foot + flat * (thigh_to_knee[..., 3:] - thigh_to_knee[..., :1])
        legs = np.concatenate([thigh_to_knee, ankle], -1)
        motion.lift += _lift(time_s, moves, np.isin(names, ("flight", "split")))
    _write(body, motion.angles_deg, heading, legs, trunk, arms)
    return motion


def _paths(time_s: np.ndarray, moves: tuple[np.ndarray, np.ndarray], keys: np.ndarray) -> np.ndarray:
    """Return paths (clips frames 2 angles) through keys (clips keys 2 angles)."""
    path = minimum_jerk(time_s, moves, keys.reshape(*keys.shape[:2], -1))
    return path.reshape(*path.shape[:2], 2, -1)


def _trunk_keys(rng: np.random.Generator, names: tuple[str, ...], clips: int, keys: int) -> np.ndarray:
    ranges = np.array([_TRUNK[name] for name in names], dtype=float)[rng.integers(len(names), size=(clips, keys))]
    drawn = ranges[..., 0] + rng.uniform(0, 1, ranges.shape[:-1]) * (ranges[..., 1] - ranges[..., 0])
    drawn[..., [1, 3, 4, 6, 7]] *= rng.choice([-1, 1], (clips, keys, 1))
    return drawn


def _leg_keys(rng: np.random.Generator, names: np.ndarray) -> np.ndarray:
    """Return (clips keys 2 6): thigh, abduction, rotation, knee, foot, flat."""
    kinds, places = np.unique(names, return_inverse=True)
    ranges = np.array([[[*leg[:5], (leg[5], leg[5])] for leg in _LEGS[kind]] for kind in kinds], dtype=float)
    chosen = ranges[places.reshape(names.shape)]
    share = rng.uniform(0, 1, chosen.shape[:-1])
    alike = rng.uniform(0, 1, (*names.shape, 1)) < 0.6
    share[:, :, 1] = np.where(alike, 0.85 * share[:, :, 0] + 0.15 * share[:, :, 1], share[:, :, 1])
    drawn = chosen[..., 0] + share * (chosen[..., 1] - chosen[..., 0])
    swapped = rng.uniform(0, 1, names.shape) < 0.5
    return np.where(swapped[..., None, None], drawn[:, :, ::-1], drawn)


def _stepping(
    rng: np.random.Generator, action: _Action, time_s: np.ndarray, trunk: np.ndarray, arms: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return legs, arms, forward speed (heights/s) and the pelvis's turn (deg) of a step cycle; moves the trunk with it."""
    clips = len(trunk)
    rate = rng.uniform(*_STRIDES_HZ[action.cycle], (clips, 1)) * np.where(rng.uniform(size=(clips, 1)) < 0.08, -1, 1)
    phase = rng.uniform(0, 1, (clips, 1)) + rate * time_s + 0.02 * smooth_noise(rng, time_s, clips, 1)[..., 0]
    stride = rng.uniform(0.6, 1.35, (clips, 1))
    crouch = np.where(rng.uniform(size=(clips, 1)) < 0.2, rng.uniform(5, 30, (clips, 1)), 0)
    sagittal = _leg_cycle(action.cycle, phase, stride, crouch)
    side = rng.normal([3, -6], [2.5, 5], (clips, 1, 1, 2)) + np.zeros((*phase.shape, 2, 2))
    legs = np.concatenate([sagittal[..., :1], side, sagittal[..., 1:]], -1)
    running = action.cycle == "run"
    swing = rng.uniform(15, 40, (clips, 1)) if running else rng.uniform(5, 35, (clips, 1))
    elbow = rng.uniform(60, 105, (clips, 1)) if running else rng.uniform(10, 40, (clips, 1))
    if "swing" in action.arms:
        swings = (rng.uniform(size=(clips, 1)) < (0.85 if len(action.arms) == 1 else 0.4))[..., None, None]
        arms = np.where(swings, _arm_swing(phase, swing * stride, elbow, rng.uniform(3, 18, (clips, 1))), arms)
    # At left foot contact the left side of the pelvis is forward (rotated to the right) and the shoulders are
    # rotated the other way; the pelvis drops on the swinging side in early stance.
    turn = -np.cos(2 * np.pi * phase) * stride
    drop = -np.sin(2 * np.pi * (phase + 0.03)) * stride
    trunk[..., 0] += rng.uniform(0, 10, (clips, 1)) if running else 0
    trunk[..., 1] += 4 * drop
    trunk[..., 3] -= 4 * drop
    trunk[..., 4] += 5 * (-2 * turn)
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
