"""Heads of made-up animals: skull and muzzle, ears, horns, trunks."""

from __future__ import annotations

import numpy as np

from uplift.meshes.procedural.building import Part
from uplift.meshes.procedural.parts import ball, rod, tube
from uplift.meshes.procedural.species import Build

__all__ = ["head_parts"]


def head_parts(build: Build, at: np.ndarray, pitch: int | float) -> list[Part]:
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
        turn = -0.1 - 1.1 * steps + 1.6 * np.maximum(steps - 0.75, 0)
        reach = build.snout / 5
        path_y = np.concatenate([[0], np.cumsum(np.sin(turn[1:]))]) * reach - 0.3 * deep
        path_z = np.concatenate([[0], np.cumsum(np.cos(turn[1:]))]) * reach + 0.75 * long
        radii = np.linspace(0.55, 0.18, 6) * deep
        parts.append(tube(np.stack([0 * steps, path_y, path_z], 1), radii, sides=8))
    parts = [part.turned(-pitch, "x") for part in parts]
    return [Part(part.vertices + at, part.faces) for part in parts]


def _ears(build: Build, deep: int | float) -> list[Part]:
    ear = build.ear
    foot = np.array([deep * 0.5, deep * 0.7, 0.06 * build.head])
    if build.ears == "round":
        left = [ball(foot + (0.1 * ear, 0.2 * ear, 0), (0.5 * ear, 0.55 * ear, 0.2 * ear))]
    elif build.ears == "fans":
        left = [
            ball((deep * 0.7 + ear * 0.25, 0, 0.2 * build.head), (ear * 0.45, ear * 0.62, ear * 0.07)).turned(0.5, "y")
        ]
    else:
        out, up = {"pointed": (0.25, 1.0), "side": (0.95, 0.3), "hanging": (0.35, -0.9)}[build.ears]
        middle, tip = foot + ear * 0.5 * np.array([out, up, 0]), foot + ear * np.array([out, up, -0.05])
        if build.ears == "hanging":
            foot = foot * (1.3, 0.9, 1)
        cone = tube(
            np.array([foot - (0, 0.1 * ear, 0), middle, tip]), (ear * 0.22, ear * 0.24, ear * 0.05), sides=6, flat=0.5
        )
        left = [cone]
    return [made for part in left for made in (part, part.mirrored())]


def _horns(build: Build, deep: int | float) -> list[Part]:
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
    radii = thick * np.linspace(1.0, 0.25, len(path))
    left = [tube(path, radii, sides=6)]
    if build.horns == "antlers":
        for share, out in ((1, (0.05, 0.3, 0.35)), (2, (0.2, 0.35, 0.15))):
            left.append(rod(path[share], path[share] + long * np.array(out), thick * 0.7, thick * 0.25, sides=6))
    return [made for part in left for made in (part, part.mirrored())]
