"""Step cycles of a person: leg, arm and trunk angles of walking, running and climbing stairs.

Control points every 5 % of the cycle from foot contact, degrees, read off published curves: walking
at natural cadence, Winter 1991, "The Biomechanics and Motor Control of Human Gait", and Perry &
Burnfield 2010, "Gait Analysis" (thigh against the vertical, knee, ankle); running at 3.2 m/s,
Novacheck 1998, Gait & Posture 7; stair ascent, Riener et al. 2002, Gait & Posture 15. Six harmonics
carry them (Winter 1991). Arm swing opposite to the leg, 30 degrees, elbow 20-40: Murray et al. 1967;
pelvic rotation and list of 4-5 degrees: Saunders et al. 1953; speed of the stride: Winter 1991.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from uplift.simulator.curves import periodic_curve

__all__ = ["CYCLES", "arm_swing", "leg_cycle", "pelvis_cycle"]

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


def leg_cycle(
    name: str,
    phase: Float[np.ndarray, "clips frames"],
    stride: Float[np.ndarray, "clips 1"],
    crouch_deg: Float[np.ndarray, "clips 1"],
) -> Float[np.ndarray, "clips frames 2 3"]:
    """Return thigh, knee and ankle of both legs (left first), half a cycle apart.

    ``stride`` scales the swing of the thigh, ``crouch_deg`` lowers the body with the feet under it.
    """
    both = np.stack([phase, phase + 0.5], -1)
    thigh, knee, ankle = (periodic_curve(points, both) for points in CYCLES[name])
    scale, crouch = stride[..., None], crouch_deg[..., None]
    knee = 4 + (knee - 4) * np.sqrt(scale)
    return np.stack([thigh * scale + crouch, knee + 2 * crouch, ankle + crouch], -1)


def arm_swing(
    phase: Float[np.ndarray, "clips frames"],
    swing_deg: Float[np.ndarray, "clips 1"],
    elbow_deg: Float[np.ndarray, "clips 1"],
    out_deg: Float[np.ndarray, "clips 1"],
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


def pelvis_cycle(phase: Float[np.ndarray, "clips frames"]) -> Float[np.ndarray, "clips frames 3"]:
    """Return the pelvis's turn to the left, its list to the left and the trunk's turn against it, unit amplitude.

    At left foot contact the left side of the pelvis is forward (turned to the right) and the
    shoulders are turned the other way; the pelvis drops on the swinging side in early stance.
    """
    turn = -np.cos(2 * np.pi * phase)
    return np.stack([turn, -np.sin(2 * np.pi * (phase + 0.03)), -2 * turn], -1)
