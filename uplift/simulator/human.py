"""The simulator's human body: joint centres and landmarks, segment lengths and ranges of motion.

Lengths are shares of stature, from joint centre to joint centre: de Leva 1996, "Adjustments to
Zatsiorsky-Seluyanov's segment inertia parameters", Table 4 (thigh 0.2425, shank 0.2493, foot
0.148, upper arm 0.162, forearm 0.154, mid-hip to mid-shoulder 0.296, mid-hip to cervicale 0.346,
vertex to cervicale 0.140); ankle height 0.039 from Drillis & Contini 1966 (in Winter,
"Biomechanics and Motor Control of Human Movement", Fig. 4.1); hip centres 0.72 of the inter-ASIS
distance apart (Bell et al. 1990). Face, hand and foot landmarks: head breadth and length, tragion
to top of head, interpupillary distance, hand and foot breadth of ANSUR II (Gordon et al. 2014),
which also gives stature (men 1756 +- 69 mm, women 1629 +- 64 mm) and the 3-4 % by which a segment's
share of stature differs between people.

Ranges of motion, degrees: American Academy of Orthopaedic Surgeons 1965 and Roaas & Andersson 1982
(hip, knee, ankle: 120, 144, -50..20; widened for the hip to the 140 that trained people reach with
a bent knee), Norkin & White, "Measurement of Joint Motion" (shoulder, elbow, wrist, neck, trunk).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from uplift.errors import UserError
from uplift.simulator.body import ROOT_ANGLES, Body, joint_weights
from uplift.skeleton import Skeleton

__all__ = ["KEY", "human_body", "is_human"]

KEY = "human"
"""The key of a joint's limits that puts it on this body."""

# point: (parent, group of lengths, x left, y down, z behind); "left_" points have a right twin.
_POINTS = {
    "pelvis": ("", "", 0, 0, 0),
    "left_hip": ("pelvis", "hip width", 0.050, 0, 0),
    "left_knee": ("left_hip", "thigh", 0, 0.2425, 0),
    "left_ankle": ("left_knee", "shank", 0, 0.2493, 0),
    "left_heel": ("left_ankle", "foot", 0, 0.034, 0.036),
    "left_foot": ("left_ankle", "foot", -0.002, 0.034, -0.075),
    "left_big_toe": ("left_ankle", "foot", -0.012, 0.034, -0.112),
    "left_small_toe": ("left_ankle", "foot", 0.024, 0.034, -0.088),
    "lumbar": ("pelvis", "trunk", 0, -0.050, 0.012),
    "spine": ("lumbar", "trunk", 0, -0.095, 0.004),
    "thorax": ("spine", "trunk", 0, -0.155, -0.012),
    "left_clavicle": ("thorax", "trunk", 0.012, 0.012, -0.030),
    "left_shoulder": ("left_clavicle", "shoulder width", 0.090, -0.008, 0.030),
    "left_elbow": ("left_shoulder", "upper arm", 0, 0.162, 0),
    "left_wrist": ("left_elbow", "forearm", 0, 0.154, 0),
    "left_hand": ("left_wrist", "hand", 0, 0.050, 0),
    "left_thumb": ("left_wrist", "hand", 0.024, 0.028, -0.010),
    "left_index": ("left_wrist", "hand", 0.014, 0.050, 0),
    "left_pinky": ("left_wrist", "hand", -0.024, 0.044, 0),
    "left_fingertip": ("left_wrist", "hand", 0, 0.106, 0),
    "neck": ("thorax", "neck", 0, -0.030, 0.010),
    "head": ("neck", "neck", 0, -0.068, -0.014),
    "headtop": ("head", "head", 0, -0.088, -0.004),
    "nose": ("head", "head", 0, -0.003, -0.070),
    "chin": ("head", "head", 0, 0.042, -0.052),
    "left_mouth": ("head", "head", 0.014, 0.016, -0.058),
    "left_eye": ("head", "head", 0.018, -0.022, -0.054),
    "left_eye_inner": ("head", "head", 0.009, -0.022, -0.056),
    "left_eye_outer": ("head", "head", 0.026, -0.022, -0.050),
    "left_ear": ("head", "head", 0.043, -0.013, 0),
}

# point: angle: (axis of a left or midline point in the rest frame, low, high). A name after "-" undoes
# an angle: raising the arm in its plane does not twist it, the clavicle moves the shoulder but does
# not turn the arm (elevation is counted from the thorax, as in the published ranges).
_ANGLES = {
    "lumbar": {"flexion": ((1, 0, 0), -15, 50), "lateral": ((0, 0, 1), -18, 18), "rotation": ((0, -1, 0), -10, 10)},
    "spine": {"flexion": ((1, 0, 0), -15, 35), "lateral": ((0, 0, 1), -20, 20), "rotation": ((0, -1, 0), -35, 35)},
    "neck": {"flexion": ((1, 0, 0), -30, 25), "lateral": ((0, 0, 1), -22, 22), "rotation": ((0, -1, 0), -35, 35)},
    "head": {"flexion": ((1, 0, 0), -25, 20), "lateral": ((0, 0, 1), -18, 18), "rotation": ((0, -1, 0), -40, 40)},
    "left_clavicle": {"elevation": ((0, 0, -1), -5, 32), "protraction": ((0, 1, 0), -20, 25)},
    "left_shoulder": {
        "-clavicle protraction": ((0, -1, 0), 0, 0), "-clavicle elevation": ((0, 0, 1), 0, 0),
        "plane": ((0, 1, 0), -95, 130), "elevation": ((0, 0, -1), 0, 175), "-plane": ((0, -1, 0), 0, 0),
        "rotation": ((0, 1, 0), -80, 80),
    },
    "left_elbow": {"flexion": ((-1, 0, 0), 2, 148), "pronation": ((0, 1, 0), -5, 150)},
    "left_wrist": {"flexion": ((-1, 0, 0), -60, 70), "deviation": ((0, 0, 1), -20, 30)},
    "left_hip": {"flexion": ((-1, 0, 0), -25, 140), "abduction": ((0, 0, -1), -28, 60), "rotation": ((0, 1, 0), -50, 42)},
    "left_knee": {"flexion": ((1, 0, 0), 3, 146)},
    "left_ankle": {"flexion": ((-1, 0, 0), -50, 28)},
}  # fmt: skip

_STATURE_MM = (1692.0, 92.0)
_SPREAD = 0.035


def is_human(skeleton: Skeleton) -> bool:
    """Tell whether the skeleton puts its joints on the human body."""
    return any(isinstance(entry, dict) and KEY in entry for entry in skeleton.body.get("limits", {}).values())


def human_body(skeleton: Skeleton) -> Body:
    """Return the human body with the joints of ``skeleton`` on it; raises UserError where one has no place."""
    table = dict(_both_sides(_POINTS))
    points = tuple(table)
    angles: dict[str, tuple[float, float]] = {f"pelvis {name}": (-np.inf, np.inf) for name in ROOT_ANGLES}
    steps = [(f"pelvis {name}", "pelvis", axis) for name, axis in ROOT_ANGLES.items()]
    for point, entries in _both_sides(_ANGLES):
        for name, (axis, low, high) in entries.items():
            side = -1.0 if point.startswith("right_") else 1.0
            mirrored = (float(axis[0]), side * axis[1], side * axis[2])
            of = (
                point.partition("_")[0] + "_" + name[1:]
                if name.startswith("-clavicle")
                else f"{point} {name.lstrip('-')}"
            )
            steps.append((of, point, mirrored))
            if not name.startswith("-"):
                angles[f"{point} {name}"] = (low, high)
    names = tuple(angles)
    limits = np.array(list(angles.values()), dtype=float)
    offsets = np.array([entry[2:] for entry in table.values()], dtype=float)
    offsets[[point.startswith("right_") for point in points], 0] *= -1
    return Body(
        points=points,
        parents=np.array([points.index(entry[0]) if entry[0] else -1 for entry in table.values()]),
        offsets=offsets,
        groups=tuple(entry[1] for entry in table.values()),
        spread=_SPREAD,
        angles=names,
        low_deg=limits[:, 0],
        high_deg=limits[:, 1],
        steps=tuple((points.index(point), names.index(name), axis) for name, point, axis in steps),
        joints=joint_weights(skeleton, _places(skeleton), points, "limits"),
        scaled_axes=np.zeros(3, bool),
        height=_STATURE_MM,
        unit="mm",
    )


def _places(skeleton: Skeleton) -> dict[str, tuple[str, ...]]:
    """Return the points of the body that each joint is the mean of."""
    places: dict[str, tuple[str, ...]] = {}
    for joint, entry in skeleton.body["limits"].items():
        point = entry.get(KEY) if isinstance(entry, dict) else None
        names = tuple(str(name) for name in point) if isinstance(point, list) else (str(point),)
        if point is None or set(entry) != {KEY}:
            raise UserError(
                f"Skeleton '{skeleton.name}', limits of '{joint}': found {entry!r}; other joints are on the human "
                f"body, so expected {{{KEY}: a point of it, or a list of points}}."
            )
        places[joint] = names
    unused = [key for key in ("proportions", "rest") if skeleton.body.get(key)]
    if unused:
        raise UserError(
            f"Skeleton '{skeleton.name}': found '{unused[0]}' beside limits that put joints on the human body, which "
            f"brings its own. Remove '{unused[0]}', or the '{KEY}:' places."
        )
    return places


def _both_sides(table: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the entries of a table, each left point followed by its right twin."""
    for point, entry in table.items():
        yield point, entry
        if point.startswith("left_"):
            twin = entry if isinstance(entry, dict) else (entry[0].replace("left_", "right_"), *entry[1:])
            yield point.replace("left_", "right_"), twin
