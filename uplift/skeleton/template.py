"""The commented file that `uplift skeleton new` starts a user's own skeleton with."""

from __future__ import annotations

import re

__all__ = ["quoted", "skeleton_template"]

_TEMPLATE = """\
# A skeleton: the joints of what you track, and what is known about them.
# This one is complete, a beetle seen by a tracker with 15 keypoints: replace it with yours, then
#   uplift skeleton check {file}
# tells what is wrong and draws it, and
#   uplift fit skeleton={file} data.train=your_keypoints.npz
# learns to lift it. Everything goes by joint name; the order in your files does not matter.
name: {name}
description: a six-legged insect, 15 keypoints and one made of them

# Names as in your files. Joints listed under midpoints (below) need not be in the files.
joints: [head, thorax, abdomen_tip,
         front_knee_l, front_claw_l, middle_knee_l, middle_claw_l, hind_knee_l, hind_claw_l,
         front_knee_r, front_claw_r, middle_knee_r, middle_claw_r, hind_knee_r, hind_claw_r,
         body]

# Poses are measured from the root. Take a joint that is seen well, near the middle.
root: thorax

# [parent, child]; together they reach every joint from the root.
bones: [[thorax, head], [thorax, body], [body, abdomen_tip],
        [thorax, front_knee_l], [front_knee_l, front_claw_l],
        [thorax, middle_knee_l], [middle_knee_l, middle_claw_l],
        [body, hind_knee_l], [hind_knee_l, hind_claw_l],
        [thorax, front_knee_r], [front_knee_r, front_claw_r],
        [thorax, middle_knee_r], [middle_knee_r, middle_claw_r],
        [body, hind_knee_r], [hind_knee_r, hind_claw_r]]
# loops: true    # if bones close on themselves, as the seat of a chair does; otherwise a cycle is an error

# [right, left] partners. Joints on the midline are in no pair. Leave out where nothing is symmetric.
mirror: [[front_knee_r, front_knee_l], [front_claw_r, front_claw_l],
         [middle_knee_r, middle_knee_l], [middle_claw_r, middle_claw_l],
         [hind_knee_r, hind_knee_l], [hind_claw_r, hind_claw_l]]

# What tells a pose from its mirror image, which fits the same 2D: three directions [from, to] of the
# thing itself. Each end is a joint, or a list of joints (their mean). Choose what holds in nearly
# every pose. `up` may be left out where gravity is true and the thing stays upright.
facing:
  front: [abdomen_tip, head]
  left: [[front_knee_r, middle_knee_r, hind_knee_r], [front_knee_l, middle_knee_l, hind_knee_l]]
  up: [[front_claw_l, middle_claw_l, hind_claw_l, front_claw_r, middle_claw_r, hind_claw_r],
       [front_knee_l, middle_knee_l, hind_knee_l, front_knee_r, middle_knee_r, hind_knee_r]]

# true: it stands or walks on the ground, and the camera is more or less level.
# false: it may be seen from any side (a hand, a thing that floats); then facing needs `up`.
gravity: true
# rigid: true    # one shape that does not bend (a chair)

# Joints that no file holds, made of others: handy for a root in the middle.
midpoints:
  body: [thorax, abdomen_tip]

# Other layouts these joints can be built from, by their names; a list is a mean, and a joint left
# out counts as missing.
# from:
#   my_other_tracker: {{head: Head, thorax: [WingL, WingR], abdomen_tip: Tail}}

# For `uplift simulate`: a body to rehearse with before there is data. Seen facing the camera, x is
# the body's left, y down, z behind it. rest: the direction of the bone from the parent to the joint.
# proportions: its length, in any unit.
# rest: {{head: [0, 0, -1], front_knee_l: [1, -0.5, -0.5], front_claw_l: [0.5, 1, -0.2], ...}}
# proportions: {{head: 0.2, front_knee_l: 0.3, front_claw_l: 0.4, ...}}
# limits: {{front_knee_l: {{flexion: [-40, 40]}}, ...}}
"""


def skeleton_template(name: str) -> str:
    """Return the text of a complete, commented skeleton called ``name``, for the user to rewrite."""
    return _TEMPLATE.format(name=quoted(name), file=f"{name}.yaml")


def quoted(name: str) -> str:
    """Return a name as YAML text that cannot be read as anything else, inside a list too."""
    plain = re.fullmatch(r"[A-Za-z_](?:[\w.+ -]*[\w.+-])?", name, re.ASCII)
    reserved = name.casefold() in ("true", "false", "yes", "no", "on", "off", "null", "y", "n")
    return name if plain and not reserved else "'" + name.replace("'", "''") + "'"
