"""Human3.6M's 17 joints out of a motion capture figure: the names in the file say which bones it has.

CMU's Acclaim skeleton has every bone. Its BVH conversions do not: the two of cgspeed.com for
MotionBuilder and 3ds Max keep the bones' lengths but two, and the one for Poser and DAZ Studio is a
standard figure with other joints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.mocap.figure import Figure, Tree

__all__ = ["JOINTS", "LAYOUTS", "Layout", "human_joints", "layout_of", "mended", "unit_of"]

JOINTS = (
    "hip", "rhip", "rknee", "rankle", "lhip", "lknee", "lankle", "spine", "thorax", "nose", "headtop",
    "lshoulder", "lelbow", "lwrist", "rshoulder", "relbow", "rwrist",
)  # fmt: skip

_CGSPEED_MM = 25.4 / 0.45
_UNITS_MM = {"inches / 0.45, as CMU's": _CGSPEED_MM, "mm": 1.0, "cm": 10.0, "inches": 25.4, "m": 1000.0}
_LEG_MM = (550.0, 1200.0)


@dataclass(frozen=True)
class Layout:
    """Which joints of a file are which of ours."""

    title: str
    left: dict[str, str]
    """Of the left side and the middle; those of the right are found by `right`."""
    right: tuple[tuple[str, str], ...]
    """How a left joint's name becomes that of the right: what is replaced by what."""
    spine: tuple[str, ...]
    thorax: tuple[str, ...]
    """The mean of these."""
    chest: str = ""
    """Where it has children at its own place, the thorax bone was dropped."""
    palm: str = ""
    """Where it is at its parent's place, the wrist bone was dropped."""
    rest_frames: int = 0
    """How many frames the conversion spends on a rest pose before the motion, and on the way out of it."""
    eyes: bool = False
    """Whether the head is known by its eyes and has no end."""
    head: str = "Head"

    def mirrored(self, name: str) -> str:
        """Return the right side's name for a left joint's."""
        for left, right in self.right:
            if left in name:
                return name.replace(left, right, 1)
        return name

    def sides(self) -> dict[str, str]:
        """Return our joints of both limbs by the file's names."""
        both = dict(self.left)
        for joint, name in self.left.items():
            both["r" + joint[1:]] = self.mirrored(name)
        return both

    def needed(self) -> list[str]:
        """Return every name of the file that is used."""
        names = [*self.sides().values(), *self.spine, *self.thorax, self.head]
        if self.palm:
            names += [self.palm, self.mirrored(self.palm)]
        if self.chest:
            names.append(self.chest)
        if self.eyes:
            names += ["leftEye", "rightEye"]
        return list(dict.fromkeys(names))


LAYOUTS = (
    Layout(
        "Acclaim skeleton",
        {"lhip": "lfemur", "lknee": "ltibia", "lankle": "lfoot", "lshoulder": "lhumerus", "lelbow": "lradius",
         "lwrist": "lhand"},
        (("l", "r"),),
        spine=("upperback",),
        thorax=("lowerneck",),
        head="head",
    ),
    Layout(
        "cgspeed's conversion for MotionBuilder",
        {"lhip": "LeftUpLeg", "lknee": "LeftLeg", "lankle": "LeftFoot", "lshoulder": "LeftArm",
         "lelbow": "LeftForeArm", "lwrist": "LeftHand"},
        (("Left", "Right"),),
        spine=("Spine",),
        thorax=("Neck",),
        chest="Spine1",
        palm="LeftFingerBase",
        rest_frames=1,
    ),
    Layout(
        "cgspeed's conversion for 3ds Max",
        {"lhip": "LeftHip", "lknee": "LeftKnee", "lankle": "LeftAnkle", "lshoulder": "LeftShoulder",
         "lelbow": "LeftElbow", "lwrist": "LeftWrist"},
        (("Left", "Right"), ("lhand", "rhand")),
        spine=("Chest",),
        thorax=("lowerneck",),
        chest="Chest2",
        palm="lhand",
        rest_frames=1,
    ),
    Layout(
        "the conversion for Poser and DAZ Studio",
        {"lhip": "lThigh", "lknee": "lShin", "lankle": "lFoot", "lshoulder": "lShldr", "lelbow": "lForeArm",
         "lwrist": "lHand"},
        (("l", "r"),),
        spine=("abdomen", "chest"),
        thorax=("lCollar", "rCollar"),
        rest_frames=4,
        eyes=True,
        head="head",
    ),
)  # fmt: skip


def layout_of(tree: Tree, path: Path) -> Layout:
    """Return the layout whose joints are all in ``tree``.

    Raises:
        UserError: none is.
    """
    missing = {}
    for layout in LAYOUTS:
        lost = [name for name in layout.needed() if name not in tree.names]
        if not lost:
            return layout
        missing[layout.title] = lost
    nearest = min(missing, key=lambda title: len(missing[title]))
    raise UserError(
        f"{path}: joints of no known conversion of CMU's data: {', '.join(tree.names[:40])}. "
        f"Nearest is {nearest}, without {', '.join(missing[nearest][:8])}."
    )


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
