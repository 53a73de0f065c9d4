"""How the known conversions of CMU's data name their joints, and which bones they leave out.

CMU's Acclaim skeleton has every bone. Its BVH conversions do not: the two of cgspeed.com for
MotionBuilder and 3ds Max keep all bones' lengths but two, and the one for Poser and DAZ Studio is a
standard figure with other joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.mocap.figure import Tree

__all__ = ["LAYOUTS", "Layout", "layout_of"]


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
        if not lost and not layout.eyes and np.isnan(tree.tips[tree.names.index(layout.head)]).any():
            raise UserError(f"{path}: joint '{layout.head}' has no End Site: the head has no top.")
        if not lost:
            return layout
        missing[layout.title] = lost
    nearest = min(missing, key=lambda title: len(missing[title]))
    raise UserError(
        f"{path}: joints of no known conversion of CMU's data: {', '.join(tree.names[:40])}. "
        f"Nearest is {nearest}, without {', '.join(missing[nearest][:8])}."
    )
