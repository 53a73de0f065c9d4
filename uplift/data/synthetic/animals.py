"""Synthetic four-legged animals in the middle of a step; the trunk's length is 1."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from uplift.data.synthetic.parts import Builder, Number, Part, ball, rod, tube
from uplift.geometry.mesh import Mesh

__all__ = ["animal"]

# Proportions of four-legged animals, guessed by eye from how they look from the side: trunk length is 1.


@dataclass(frozen=True)
class _Build:
    """One animal's proportions; lengths in lengths of its trunk, angles in degrees above level."""

    deep: Number
    """The chest's height; `wide` its width; `hip` is the hips' size against the chest's."""
    wide: Number
    hip: Number
    leg: Number
    """From the belly to the ground."""
    leg_thick: Number
    neck: Number
    neck_angle: Number
    neck_thick: Number
    head: Number
    head_deep: Number
    muzzle: Number
    """The muzzle's end against the head's height."""
    head_angle: Number
    ear: Number
    tail: Number
    tail_thick: Number
    tail_angle: Number
    horn: Number = 0.0
    ears: str = "pointed"
    horns: str = "none"
    hump: Number = 0.0
    snout: Number = 0.0
    """How long a trunk hangs from the head."""


_SPECIES: dict[str, _Build] = {
    "horse": _Build(0.48, 0.36, 0.97, 0.70, 0.16, 0.58, 48, 0.27, 0.46, 0.23, 0.5, -45, 0.12, 0.6, 0.07, -70),
    "donkey": _Build(0.46, 0.36, 0.95, 0.58, 0.14, 0.46, 42, 0.24, 0.44, 0.22, 0.55, -40, 0.24, 0.5, 0.04, -75),
    "cow": _Build(0.56, 0.44, 0.96, 0.46, 0.16, 0.38, 15, 0.34, 0.42, 0.26, 0.62, -40, 0.16, 0.6, 0.03, -82, 0.22, "side", "curved"),
    "deer": _Build(0.42, 0.30, 0.92, 0.70, 0.11, 0.46, 55, 0.17, 0.32, 0.17, 0.42, -28, 0.18, 0.12, 0.06, -40, 0.5, "side", "antlers"),
    "antelope": _Build(0.42, 0.30, 0.88, 0.66, 0.1, 0.44, 50, 0.17, 0.32, 0.17, 0.45, -32, 0.16, 0.3, 0.03, -75, 0.45, "side", "straight"),
    "dog": _Build(0.42, 0.32, 0.82, 0.52, 0.12, 0.3, 45, 0.23, 0.4, 0.22, 0.42, -8, 0.16, 0.48, 0.06, 25, 0, "pointed"),
    "hound": _Build(0.42, 0.30, 0.72, 0.60, 0.10, 0.32, 48, 0.19, 0.42, 0.19, 0.42, -10, 0.18, 0.5, 0.04, 5, 0, "hanging"),
    "fox": _Build(0.34, 0.27, 0.88, 0.40, 0.09, 0.24, 35, 0.2, 0.38, 0.19, 0.25, -8, 0.17, 0.65, 0.14, -18),
    "cat": _Build(0.36, 0.29, 0.92, 0.38, 0.11, 0.2, 38, 0.21, 0.26, 0.23, 0.55, -8, 0.12, 0.75, 0.06, 15),
    "lion": _Build(0.42, 0.34, 0.85, 0.42, 0.14, 0.24, 25, 0.3, 0.34, 0.28, 0.6, -8, 0.08, 0.75, 0.04, -35, 0, "round"),
    "bear": _Build(0.56, 0.48, 1.02, 0.38, 0.22, 0.24, 15, 0.38, 0.38, 0.29, 0.42, -10, 0.08, 0.06, 0.06, -45, 0, "round"),
    "pig": _Build(0.56, 0.50, 1.0, 0.26, 0.15, 0.12, 0, 0.44, 0.42, 0.32, 0.45, -22, 0.15, 0.14, 0.03, 15),
    "sheep": _Build(0.58, 0.54, 1.0, 0.34, 0.09, 0.24, 40, 0.26, 0.32, 0.2, 0.5, -32, 0.13, 0.14, 0.08, -65, 0.16, "side", "curled"),
    "goat": _Build(0.48, 0.40, 0.97, 0.44, 0.1, 0.32, 50, 0.2, 0.32, 0.19, 0.48, -32, 0.15, 0.12, 0.06, 40, 0.3, "side", "swept"),
    "giraffe": _Build(0.56, 0.38, 0.75, 1.2, 0.16, 1.3, 62, 0.25, 0.46, 0.2, 0.42, -28, 0.14, 0.7, 0.04, -80, 0.1, "side", "straight"),
    "elephant": _Build(0.72, 0.60, 0.95, 0.52, 0.28, 0.18, 12, 0.46, 0.42, 0.48, 0.62, -55, 0.42, 0.5, 0.04, -80, 0.35, "fans", "tusks", 0, 0.85),
    "rhino": _Build(0.62, 0.54, 1.0, 0.36, 0.23, 0.26, 2, 0.42, 0.5, 0.3, 0.6, -30, 0.13, 0.35, 0.04, -75, 0.22, "pointed", "nose"),
    "hippo": _Build(0.66, 0.60, 1.0, 0.22, 0.2, 0.16, 2, 0.48, 0.54, 0.36, 0.9, -14, 0.06, 0.2, 0.04, -75, 0, "round"),
    "camel": _Build(0.54, 0.42, 0.85, 0.85, 0.13, 0.75, 42, 0.22, 0.42, 0.21, 0.5, -15, 0.07, 0.4, 0.04, -75, 0, "round", "none", 0.3),
    "bison": _Build(0.66, 0.48, 0.7, 0.38, 0.15, 0.26, -8, 0.44, 0.42, 0.32, 0.55, -50, 0.1, 0.4, 0.04, -75, 0.18, "side", "curved", 0.14),
    "rabbit": _Build(0.5, 0.44, 1.12, 0.22, 0.14, 0.14, 40, 0.3, 0.36, 0.28, 0.5, -15, 0.42, 0.1, 0.1, 30),
}  # fmt: skip
"""Named after what they resemble: none is measured."""

_SPREAD = 0.1
_SPREAD_DEG = 6.0


def _draw_build(rng: np.random.Generator) -> tuple[str, _Build]:
    """Return a species and the proportions of one of it, every third mixed with another species."""
    names = list(_SPECIES)
    name = names[int(rng.integers(len(names)))]
    own, other = _SPECIES[name], _SPECIES[names[int(rng.integers(len(names)))]]
    share = rng.uniform(0.0, 0.4) if rng.random() < 0.33 else 0.0
    values = {}
    for part in fields(_Build):
        value = getattr(own, part.name)
        if isinstance(value, str):
            values[part.name] = value
            continue
        value = (1 - share) * value + share * getattr(other, part.name)
        is_angle = part.name.endswith("angle")
        values[part.name] = value + rng.normal(0, _SPREAD_DEG) if is_angle else value * np.exp(rng.normal(0, _SPREAD))
    if values["ears"] in ("pointed", "side") and rng.random() < 0.15:
        values["ears"] = "hanging"
    if values["horns"] in ("antlers", "curled", "curved", "swept") and rng.random() < 0.4:
        values["horns"] = "none"  # many females have none
    return name, _Build(**values)


# Heads: skull and muzzle, ears, horns, trunks.


def _head_parts(build: _Build, at: np.ndarray, pitch: Number) -> list[Part]:
    """Return the parts of a head whose back is ``at`` a point; it looks along +z, raised by ``pitch`` radians."""
    deep, long = build.head_deep / 2, build.head
    z = np.array([-0.08, 0.08, 0.3, 0.55, 0.85, 1.0]) * long
    share = build.muzzle
    size = np.array([0.62, 0.95, 1.0, 0.45 + 0.5 * share, 0.15 + 0.85 * share, share * 0.85])
    y = np.array([0, 0.02, 0, -0.12, -0.22, -0.26]) * deep
    skull = tube(np.stack([0 * z, y, z], 1), size * deep, sides=10, blunt=True).widened(0.78)
    parts = [skull, *_ears(build, deep), *_horns(build, deep)]
    if build.snout > 0.05:
        steps = np.linspace(0, 1, 6)
        y, z = _bent(-0.1 - 1.1 * steps + 1.6 * np.maximum(steps - 0.75, 0)) * (build.snout / 5)
        path = np.stack([0 * steps, y - 0.3 * deep, z + 0.75 * long], 1)
        parts.append(tube(path, np.linspace(0.55, 0.18, 6) * deep, sides=8))
    parts = [part.rotated(-pitch, "x") for part in parts]
    return [Part(part.vertices + at, part.faces) for part in parts]


def _bent(angles: np.ndarray) -> np.ndarray:
    """Return height and depth of a chain of unit links at ``angles`` (the first is not used), (2, points)."""
    return np.cumsum([np.sin(angles), np.cos(angles)] * (np.arange(len(angles)) > 0), 1)


def _ears(build: _Build, deep: Number) -> list[Part]:
    ear = build.ear
    foot = np.array([deep * 0.5, deep * 0.7, 0.06 * build.head])
    if build.ears == "round":
        left = ball(foot + (0.1 * ear, 0.2 * ear, 0), (0.5 * ear, 0.55 * ear, 0.2 * ear))
    elif build.ears == "fans":
        centre = (deep * 0.7 + ear * 0.25, 0, 0.2 * build.head)
        left = ball(centre, (ear * 0.45, ear * 0.62, ear * 0.07)).rotated(0.5, "y")
    else:
        out, up = {"pointed": (0.25, 1.0), "side": (0.95, 0.3), "hanging": (0.35, -0.9)}[build.ears]
        middle, tip = foot + ear * 0.5 * np.array([out, up, 0]), foot + ear * np.array([out, up, -0.05])
        if build.ears == "hanging":
            foot = foot * (1.3, 0.9, 1)
        path = np.array([foot - (0, 0.1 * ear, 0), middle, tip])
        left = tube(path, (ear * 0.22, ear * 0.24, ear * 0.05), sides=6, flat=0.5)
    return [left, left.mirrored()]


def _horns(build: _Build, deep: Number) -> list[Part]:
    long = build.horn
    if build.horns == "none" or long < 0.02:
        return []
    if build.horns == "nose":
        z = 0.88 * build.head
        big = rod((0, 0.25 * deep, z), (0, 0.25 * deep + long, z + 0.35 * long), 0.24 * long, 0.03 * long)
        small = rod((0, 0.4 * deep, z - 0.16), (0, 0.4 * deep + long * 0.5, z - 0.13), 0.18 * long, 0.03 * long)
        return [big, small]
    foot = np.array([deep * 0.35, deep * 0.75, 0.1 * build.head])
    thick = {"antlers": 0.035, "tusks": 0.09, "curled": 0.2, "curved": 0.12}.get(build.horns, 0.07) * long + 0.006
    curves = {  # steps from the foot, in lengths of the horn: left, up, forward
        "straight": [(0.05, 0.5, -0.05), (0.12, 1.0, -0.2)],
        "curved": [(0.45, 0.12, 0.0), (0.75, 0.4, 0.1), (0.78, 0.75, 0.15)],
        "swept": [(0.1, 0.4, -0.1), (0.22, 0.65, -0.45), (0.35, 0.6, -0.85)],
        "curled": [(0.4, 0.3, -0.35), (0.7, -0.15, -0.5), (0.8, -0.5, -0.1), (0.95, -0.35, 0.25)],
        "antlers": [(0.2, 0.3, -0.2), (0.42, 0.65, -0.2), (0.4, 1.0, 0.05)],
        "tusks": [(0.1, -0.25, 0.3), (0.18, -0.35, 0.65), (0.15, -0.2, 1.0)],
    }
    if build.horns == "tusks":
        foot = np.array([deep * 0.45, -deep * 0.35, 0.75 * build.head])
    path = np.concatenate([[foot], foot + long * np.array(curves[build.horns])])
    left = [tube(path, thick * np.linspace(1.0, 0.25, len(path)), sides=6)]
    if build.horns == "antlers":
        for share, out in ((1, (0.05, 0.3, 0.35)), (2, (0.2, 0.35, 0.15))):
            left.append(rod(path[share], path[share] + long * np.array(out), thick * 0.7, thick * 0.25, sides=6))
    return [made for part in left for made in (part, part.mirrored())]


# Animals in the middle of a step.

# Of a fore and a hind leg: place along the trunk, distance from its side; from hip to foot the heights of the joints
# (shares of the leg's), how far forward of the line from hip to foot they are, radii, and how far each segment folds.
_LEGS = {
    "fore": (0.33, 0.85, (1.0, 0.72, 0.44, 0.12, 0.0), (0.03, -0.07, 0.0, 0.0, 0.02), (1.35, 1.25, 0.72, 0.5, 0.62), (0.0, 0.35, -1, -0.6)),
    "hind": (-0.34, 0.8, (1.0, 0.68, 0.42, 0.12, 0.0), (0.0, 0.09, -0.07, -0.03, 0.0), (1.6, 1.5, 0.72, 0.5, 0.62), (0.0, 0.5, -0.8, -0.3)),
}  # fmt: skip
_STEP_OF = {("hind", 1): 0.0, ("fore", 1): 0.25, ("hind", -1): 0.5, ("fore", -1): 0.75}
"""When each foot leaves the ground in a walk, as a share of the stride: hind left, fore left, hind right, fore right."""


@dataclass
class _Pose:
    """One animal's pose: angles in radians."""

    phase: float
    stride: float
    bend: float
    """Sideways curvature of the spine."""
    look: float
    """How far the head turns to the left; `nod` upwards."""
    nod: float
    wag: float
    trot: bool


def animal(rng: np.random.Generator) -> Mesh:
    """Return an animal of one species' proportions, standing, walking or trotting, its head turned a little."""
    name, build = _draw_build(rng)
    pose = _Pose(
        phase=rng.uniform(0, 1),
        stride=abs(rng.normal(0, 0.28)) * (0.5 if build.leg < 0.3 else 1.0),
        bend=rng.normal(0, 0.05),
        look=rng.normal(0, 0.3),
        nod=rng.normal(0, 0.18) - (rng.uniform(0.4, 1.2) if rng.random() < 0.12 and build.snout < 0.3 else 0.0),
        wag=rng.normal(0, 0.3),
        trot=rng.random() < 0.3,
    )
    built = Builder(rng)
    spine = build.leg + build.deep / 2
    _trunk(built, build, pose, spine)
    for kind, side in _STEP_OF:
        built.add(*_leg(build, pose, kind, side, spine))
    _neck_and_head(built, build, pose, spine)
    _tail(built, build, pose, spine)
    return built.mesh(name)


def _trunk(built: Builder, build: _Build, pose: _Pose, spine: Number) -> None:
    z = np.array([-0.5, -0.42, -0.28, -0.05, 0.18, 0.36, 0.47])
    size = np.array([0.45 * build.hip, 0.78 * build.hip, 0.95 * build.hip, 0.5 * (build.hip + 1), 1.0, 0.93, 0.6])
    high = size * build.deep / 2
    drop = 0.04 * build.deep * np.array([0.3, 0, 0, 1, 0.8, 0, 0])
    y = spine + (1 - build.hip) * 0.4 * build.deep * np.array([1, 1, 1, 0.5, 0, 0, 0]) - drop
    path = np.stack([pose.bend * (1 - (z / 0.5) ** 2), y, z], 1)
    built.add(tube(path, high, sides=12, flat=1.0, blunt=True).widened(build.wide / build.deep))
    if build.hump > 0.02:
        rise = build.hump * build.deep
        built.add(ball((pose.bend, spine + build.deep * 0.42, 0.05), (build.wide * 0.32, rise + 0.1, 0.22)))


def _leg(build: _Build, pose: _Pose, kind: str, side: int, spine: Number) -> list[Part]:
    """Return one leg: its upper end inside the trunk, swung by its phase of the stride, folded in the air."""
    fore = kind == "fore"
    place, aside, heights, forward, radii, folds = _LEGS[kind]
    start = _STEP_OF["hind", -side] if pose.trot and fore else _STEP_OF[kind, side]
    phase = 2 * np.pi * (pose.phase + start)
    swing, lift = pose.stride * np.sin(phase), max(0.0, np.cos(phase)) * pose.stride * 2.2
    top, thick = spine - 0.1 * build.deep, build.leg_thick / 2
    forward = np.array(forward) * (build.leg + 0.1)
    folds = np.array(folds) * lift
    y, z = [0.0], [forward[0]]
    for k in range(4):
        down, ahead = (heights[k + 1] - heights[k]) * top, forward[k + 1] - forward[k]
        angle = swing + (folds[k] if k else 0.0) + (folds[1] * 0.5 if k > 1 else 0.0)
        y.append(y[-1] + down * np.cos(angle) + ahead * np.sin(angle))
        z.append(z[-1] - down * np.sin(angle) + ahead * np.cos(angle))
    x = side * (build.wide / 2 - thick * 1.1) * (aside if fore else aside * build.hip)
    path = np.stack([x * np.array([0.6, 0.88, 1.0, 1.0, 1.0]), top + np.array(y), place + np.array(z)], 1)
    paw = ball(path[-1] + (0, thick * 0.25, thick * 0.35), (thick * 0.65, thick * 0.4, thick * 0.95))
    return [tube(path, thick * np.array(radii), sides=8, blunt=True), paw]


def _neck_and_head(built: Builder, build: _Build, pose: _Pose, spine: Number) -> None:
    """Add neck and head, built straight ahead and then rotated to where the animal looks."""
    angle = np.deg2rad(build.neck_angle) + pose.nod
    foot = np.array([0.0, spine + 0.14 * build.deep, 0.36])
    ahead = np.array([0.0, np.sin(angle), np.cos(angle)])
    end = foot + ahead * (build.neck + 0.12)
    thick = build.neck_thick / 2
    sag = np.array([0.0, -0.06, 0.0]) * build.neck
    path = np.array([foot - ahead * 0.06, foot + 0.45 * (end - foot) + sag, end])
    neck = tube(path, (max(thick * 1.25, 0.3 * build.deep), thick, thick * 0.82), sides=10, flat=1.15, blunt=True)
    head = _head_parts(build, end, np.deg2rad(build.head_angle) + 0.5 * pose.nod)
    head = [part.rotated(0.6 * pose.look, "y", end) for part in head]
    built.add(*(part.rotated(0.5 * pose.look, "y", foot) for part in [neck.widened(0.85), *head]))


def _tail(built: Builder, build: _Build, pose: _Pose, spine: Number) -> None:
    angle = np.deg2rad(build.tail_angle)
    share = np.linspace(0, 1, 5)
    droop = angle + (0.5 if angle > 0 else -0.3) * (share - 0.3)
    y, z = _bent(droop) * build.tail / 4
    x = np.sin(pose.wag) * share**1.5 * build.tail * 0.6
    foot = (0, spine + (1 - build.hip) * 0.4 * build.deep + 0.24 * build.deep * build.hip, -0.44)
    shape = (0.6, 1.0, 1.3, 1.2, 0.4) if build.tail_thick > 0.09 else (1.2, 1.0, 0.8, 0.7, 0.8)  # bushy or not
    radii = build.tail_thick / 2 * np.array(shape)
    built.add(tube(np.stack([x, y, -z], 1) + foot, radii, sides=6, blunt=True))
