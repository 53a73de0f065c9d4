"""Human3.6M's 17 joints out of a motion capture figure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.mocap.figure import Figure, Tree
from uplift.mocap.layouts import Layout

__all__ = ["JOINTS", "human_joints", "mended", "unit_of"]

JOINTS = (
    "hip", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle", "spine", "thorax", "nose", "headtop",
    "lshoulder", "lelbow", "lwrist", "rshoulder", "relbow", "rwrist",
)  # fmt: skip

_CGSPEED_MM = 25.4 / 0.45
_UNITS_MM = {"inches / 0.45, as CMU's": _CGSPEED_MM, "mm": 1.0, "cm": 10.0, "inches": 25.4, "m": 1000.0}
_LEG_MM = (550.0, 1200.0)


def unit_of(tree: Tree, layout: Layout, path: Path, unit_mm: float | None = None) -> float:
    """Return the millimetres in the file's unit: ``unit_mm`` where known, else the one that suits the legs.

    Raises:
        UserError: the legs have a length that no person's have.
    """
    thigh_and_shin = [
        sum(tree.length(layout.sides()[side + part]) for part in ("knee", "ankle")) for side in ("l", "r")
    ]
    leg = float(np.mean(thigh_and_shin))
    found = unit_mm
    if found is None:
        middle = np.sqrt(_LEG_MM[0] * _LEG_MM[1])
        found = min(_UNITS_MM.values(), key=lambda unit: abs(np.log(max(leg, 1e-9) * unit / middle)))
    if not _LEG_MM[0] <= leg * found <= _LEG_MM[1]:
        raise UserError(
            f"{path}: thigh and shin are {leg * found:.4g} mm together ({leg:.4g} in the file's unit, taken as "
            f"{found:.4g} mm), expected {_LEG_MM[0]:g} to {_LEG_MM[1]:g}. Say the unit with unit_mm=."
        )
    return found


def mended(tree: Tree, layout: Layout) -> Tree:
    """Return ``tree`` with the bones put back that the conversion dropped.

    A dropped bone leaves its child where its parent is. The thorax bone comes back as long as the bone
    below it, straight up; the wrist bone comes back as the half of the forearm that CMU's model makes it.
    """
    offsets = tree.offsets.copy()
    if layout.chest:
        chest = tree.names.index(layout.chest)
        dropped = [
            joint for joint, parent in enumerate(tree.parents) if parent == chest and not tree.offsets[joint].any()
        ]
        offsets[dropped] = (0, tree.length(layout.chest), 0)
    if layout.palm:
        for palm in (layout.palm, layout.mirrored(layout.palm)):
            joint = tree.names.index(palm)
            if not tree.offsets[joint].any():
                offsets[tree.parents[joint]] *= 1.5
    return replace(tree, offsets=offsets)


def human_joints(figure: Figure, layout: Layout, unit_mm: float) -> Float[np.ndarray, "frames 17 3"]:
    """Return the joints in `JOINTS`' order, mm, world (y up).

    ``hip`` is the middle of the hips. ``nose`` is made up: ahead of the joint that the head turns on, by
    the length of the head's bone.
    """
    points = {joint: figure.at(name) for joint, name in layout.sides().items()}
    points["hip"] = (points["lhip"] + points["rhip"]) / 2
    for joint, names in (("spine", layout.spine), ("thorax", layout.thorax)):
        points[joint] = np.mean([figure.at(name) for name in names], axis=0)
    up, ahead = _head(figure.tree, layout)
    points["headtop"] = figure.beyond(layout.head, up)
    points["nose"] = figure.beyond(layout.head, ahead)
    return (np.stack([points[joint] for joint in JOINTS], 1) * unit_mm).astype(np.float32)


def _head(tree: Tree, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Return the top of the head and the nose, from the joint that the head turns on."""
    if layout.eyes:
        eyes = np.mean([tree.offsets[tree.names.index(name)] for name in ("leftEye", "rightEye")], axis=0)
        # Eyes are half way up a head; a nose is half way down from them, and a quarter further ahead.
        return np.array([0, 2 * eyes[1], 0]), np.array([0, eyes[1] / 2, 1.25 * eyes[2]])
    up = tree.tips[tree.names.index(layout.head)]
    return up, np.array([0, 0, np.linalg.norm(up)])
