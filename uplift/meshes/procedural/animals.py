"""Made-up four-legged animals in the middle of a step; the trunk's length is 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uplift.meshes.mesh import Mesh
from uplift.meshes.procedural.building import Builder, Part
from uplift.meshes.procedural.heads import head_parts
from uplift.meshes.procedural.parts import ball, tube
from uplift.meshes.procedural.species import Build, draw_build

__all__ = ["animal"]

_STEP_OF = {("hind", 1): 0.0, ("fore", 1): 0.25, ("hind", -1): 0.5, ("fore", -1): 0.75}
"""When each foot leaves the ground in a walk, as a share of the stride: hind left, fore left, hind right, fore right."""


@dataclass
class _Pose:
    """How one animal stands: angles in radians."""

    phase: float
    stride: float
    bend: float
    """How much the spine is bent sideways."""
    look: float
    """How far the head is turned to the left; `nod` upwards."""
    nod: float
    wag: float
    trot: bool


def animal(rng: np.random.Generator) -> Mesh:
    """Return an animal of one species' proportions, standing, walking or trotting, its head turned a little."""
    name, build = draw_build(rng)
    pose = _Pose(
        phase=rng.uniform(0, 1),
        stride=abs(rng.normal(0, 0.28)) * (0.5 if build.leg < 0.3 else 1.0),
        bend=rng.normal(0, 0.05),
        look=rng.normal(0, 0.3),
        nod=rng.normal(0, 0.18) - (rng.uniform(0.4, 1.2) if rng.random() < 0.12 and build.snout < 0.3 else 0.0),
        wag=rng.normal(0, 0.3),
        trot=rng.random() < 0.3,
    )
    built = Builder()
    belly = build.leg
    spine = belly + build.deep / 2
    _trunk(built, build, pose, spine)
    for kind, side in _STEP_OF:
        built.add(*_leg(build, pose, kind, side, spine))
    _neck_and_head(built, build, pose, spine)
    _tail(built, build, pose, spine)
    return built.mesh(name)


def _trunk(built: Builder, build: Build, pose: _Pose, spine: int | float) -> None:
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


def _leg(build: Build, pose: _Pose, kind: str, side: int, spine: int | float) -> list[Part]:
    """Return one leg: its upper end inside the trunk, swung by where it is in the stride, folded while in the air."""
    fore = kind == "fore"
    start = _STEP_OF["hind", -side] if pose.trot and fore else _STEP_OF[kind, side]
    turn = 2 * np.pi * (pose.phase + start)
    swing, lift = pose.stride * np.sin(turn), max(0.0, np.cos(turn)) * pose.stride * 2.2
    top = spine - 0.1 * build.deep
    length, thick = top, build.leg_thick / 2
    # Shares of the leg's height, and how far each joint stands forward of the line from hip to foot.
    heights = np.array([1.0, 0.72, 0.44, 0.12, 0.0]) if fore else np.array([1.0, 0.68, 0.42, 0.12, 0.0])
    forward = np.array([0.03, -0.07, 0.0, 0.0, 0.02]) if fore else np.array([0.0, 0.09, -0.07, -0.03, 0.0])
    forward = forward * (build.leg + 0.1)
    folds = (
        np.array([0.0, 0.35 * lift, -lift, -lift * 0.6])
        if fore
        else np.array([0.0, 0.5 * lift, -0.8 * lift, -lift * 0.3])
    )
    y, z = [0.0], [forward[0]]
    for k in range(4):
        down, ahead = (heights[k + 1] - heights[k]) * length, forward[k + 1] - forward[k]
        angle = swing + (folds[k] if k else 0.0) + (folds[1] * 0.5 if k > 1 else 0.0)
        y.append(y[-1] + down * np.cos(angle) + ahead * np.sin(angle))
        z.append(z[-1] - down * np.sin(angle) + ahead * np.cos(angle))
    place = 0.33 if fore else -0.34
    x = side * (build.wide / 2 - thick * 1.1) * (0.85 if fore else 0.8 * build.hip)
    path = np.stack([x * np.array([0.6, 0.88, 1.0, 1.0, 1.0]), top + np.array(y), place + np.array(z)], 1)
    radii = thick * (np.array([1.35, 1.25, 0.72, 0.5, 0.62]) if fore else np.array([1.6, 1.5, 0.72, 0.5, 0.62]))
    paw = ball(path[-1] + (0, thick * 0.25, thick * 0.35), (thick * 0.65, thick * 0.4, thick * 0.95))
    return [tube(path, radii, sides=8, blunt=True), paw]


def _neck_and_head(built: Builder, build: Build, pose: _Pose, spine: int | float) -> None:
    """Add neck and head, made straight ahead and then turned to where the animal looks."""
    angle = np.deg2rad(build.neck_angle) + pose.nod
    foot = np.array([0.0, spine + 0.14 * build.deep, 0.36])
    ahead = np.array([0.0, np.sin(angle), np.cos(angle)])
    end = foot + ahead * (build.neck + 0.12)
    thick = build.neck_thick / 2
    sag = np.array([0.0, -0.06, 0.0]) * build.neck
    path = np.array([foot - ahead * 0.06, foot + 0.45 * (end - foot) + sag, end])
    neck = tube(path, (max(thick * 1.25, 0.3 * build.deep), thick, thick * 0.82), sides=10, flat=1.15, blunt=True)
    pitch = np.deg2rad(build.head_angle) + 0.5 * pose.nod
    parts = head_parts(build, end, pitch)
    neck_turn, head_turn = 0.5 * pose.look, 0.6 * pose.look
    parts = [part.turned(head_turn, "y", end) for part in parts]
    built.add(*(part.turned(neck_turn, "y", foot) for part in [neck.widened(0.85), *parts]))


def _tail(built: Builder, build: Build, pose: _Pose, spine: int | float) -> None:
    angle = np.deg2rad(build.tail_angle)
    share = np.linspace(0, 1, 5)
    droop = angle + (0.5 if angle > 0 else -0.3) * (share - 0.3)
    y = np.concatenate([[0], np.cumsum(np.sin(droop[1:]))]) * build.tail / 4
    z = -np.concatenate([[0], np.cumsum(np.cos(droop[1:]))]) * build.tail / 4
    x = np.sin(pose.wag) * share**1.5 * build.tail * 0.6
    foot = (0, spine + (1 - build.hip) * 0.4 * build.deep + 0.24 * build.deep * build.hip, -0.44)
    bushy = build.tail_thick > 0.09
    radii = (
        build.tail_thick / 2 * (np.array([0.6, 1.0, 1.3, 1.2, 0.4]) if bushy else np.array([1.2, 1.0, 0.8, 0.7, 0.8]))
    )
    built.add(tube(np.stack([x, y, z], 1) + foot, radii, sides=6, blunt=True))
