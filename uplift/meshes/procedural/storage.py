"""Made-up beds, shelves and cabinets; lengths in metres."""

from __future__ import annotations

import itertools

import numpy as np

from uplift.meshes.mesh import Mesh
from uplift.meshes.procedural.feet import turned_leg
from uplift.meshes.procedural.parts import Builder, beam, block, rod, rounded, slab

__all__ = ["bed", "cabinet", "shelf"]


def bed(rng: np.random.Generator) -> Mesh:
    """Return a bed seen from its foot: mattress, pillows, a head board and often a foot board."""
    built = Builder()
    width, length = rng.uniform(0.8, 1.9), rng.uniform(1.9, 2.15)
    legs, frame, soft = rng.uniform(0.05, 0.25), rng.uniform(0.08, 0.22), rng.uniform(0.12, 0.3)
    base = legs + frame
    built.add(block((-width / 2, legs, -length / 2), (width / 2, base, length / 2)))
    outline = rounded(width * rng.uniform(0.92, 0.99), length * 0.97, power=20.0, corners=20)
    built.add(slab(outline, base - 0.02, base + soft, 0.02))
    for x in (0.0,) if width < 1.25 else (-width / 4, width / 4):
        plan = rounded(min(width * 0.42, 0.7), 0.42, power=4.0, corners=12) + (x, -length / 2 + 0.3)
        built.add(slab(plan, base + soft - 0.03, base + soft + rng.uniform(0.06, 0.14), 0.25))
    _board(built, rng, (width, legs), base + soft + rng.uniform(0.15, 0.75), -length / 2)
    if rng.random() < 0.45:
        _board(built, rng, (width, legs), base + soft + rng.uniform(-0.1, 0.35), length / 2)
    thick = rng.uniform(0.05, 0.1)
    for z in (length / 2 - thick / 2, -length / 2 + thick / 2):
        built.pair(beam((width / 2 - thick / 2, 0, z), (width / 2 - thick / 2, base, z), (thick, thick)))
    return built.mesh("bed")


def _board(built: Builder, rng: np.random.Generator, size: tuple, top: float, z: float) -> None:
    """Add a head or foot board: solid, of bars, or an arch, between two posts."""
    width, legs = size
    thick = rng.uniform(0.03, 0.08)
    kind = rng.choice(["solid", "bars", "posts"])
    half = width / 2 + thick / 2
    if kind == "solid":
        built.add(beam((0, legs, z), (0, top, z - rng.uniform(0, 0.08) * np.sign(-z)), (2 * half, thick)))
        return
    post_top = top + (rng.uniform(0.05, 0.3) if kind == "posts" else 0.0)
    if kind == "posts":
        built.pair(turned_leg(rng.integers(1 << 30), (half, 0, z), (half, post_top, z), thick * 1.4))
        built.add(block((-half, legs, z - thick / 3), (half, top, z + thick / 3)))
        return
    built.pair(beam((half, 0, z), (half, top, z), (thick, thick)))
    built.add(beam((-half, top - thick / 2, z), (half, top - thick / 2, z), (thick, thick), across="yz"))
    for x in np.linspace(-half, half, int(rng.integers(5, 12)))[1:-1]:
        built.add(rod((x, legs, z), (x, top - thick / 2, z), thick * 0.25, sides=6))


def shelf(rng: np.random.Generator) -> Mesh:
    """Return an open shelf, with boards, uprights, some with a back and with compartments."""
    built = Builder()
    width, height, depth = rng.uniform(0.4, 1.6), rng.uniform(0.7, 2.1), rng.uniform(0.22, 0.45)
    thick = rng.uniform(0.018, 0.045)
    half, back = width / 2, -depth / 2
    legs = rng.choice([0.0, rng.uniform(0.03, 0.15)])
    if rng.random() < 0.75:
        built.pair(block((half - thick, 0, back), (half, height, depth / 2)))
    else:  # posts at the corners
        for z in (back + thick / 2, depth / 2 - thick / 2):
            built.pair(beam((half - thick / 2, 0, z), (half - thick / 2, height, z), (thick, thick)))
    levels = np.linspace(legs + thick, height, int(rng.integers(3, 7)))
    levels[1:-1] += rng.uniform(-0.1, 0.1, len(levels) - 2) * height / len(levels)
    for y in levels:
        built.add(block((-half, y - thick, back), (half, y, depth / 2)))
    if rng.random() < 0.6:
        built.add(block((-half, legs, back), (half, height, back + 0.015)))
    for x in np.linspace(-half, half, int(rng.integers(2, 5)))[1:-1]:
        built.add(block((x - thick / 2, legs, back), (x + thick / 2, height, depth / 2)))
    if rng.random() < 0.35:  # doors below
        built.add(block((-half + 0.01, levels[0], depth / 2 - 0.02), (half - 0.01, levels[1], depth / 2 + 0.01)))
    return built.mesh("shelf")


def cabinet(rng: np.random.Generator) -> Mesh:
    """Return a cabinet, wardrobe, sideboard or chest of drawers: fronts with handles stand out, some have feet."""
    built = Builder()
    kind = rng.choice(["wardrobe", "sideboard", "chest", "bedside"])
    width, height, depth = {
        "wardrobe": (rng.uniform(0.8, 1.8), rng.uniform(1.6, 2.2), rng.uniform(0.45, 0.65)),
        "sideboard": (rng.uniform(1.1, 2.0), rng.uniform(0.5, 0.9), rng.uniform(0.35, 0.5)),
        "chest": (rng.uniform(0.5, 1.1), rng.uniform(0.7, 1.3), rng.uniform(0.4, 0.55)),
        "bedside": (rng.uniform(0.35, 0.55), rng.uniform(0.4, 0.7), rng.uniform(0.3, 0.45)),
    }[str(kind)]
    legs = rng.choice([0.0, rng.uniform(0.04, 0.25)], p=[0.3, 0.7])
    half, front = width / 2, depth / 2
    built.add(block((-half, legs, -front), (half, height, front)))
    over, thick = rng.uniform(0, 0.05), rng.uniform(0.015, 0.05)
    built.add(block((-half - over, height - thick / 2, -front), (half + over, height + thick / 2, front + over)))
    columns = int(rng.integers(1, 5)) if kind in ("wardrobe", "sideboard") else int(rng.integers(1, 3))
    rows = 1 if kind == "wardrobe" else int(rng.integers(1, 5))
    _fronts(built, rng, (half, front), (legs, height), (columns, rows))
    if legs > 0:
        size, splay = rng.uniform(0.03, 0.07), rng.uniform(0, 0.25) * legs
        for z, out in ((front - size, splay), (-front + size, -splay)):
            built.pair(
                beam(
                    (half - size + splay, 0, z + out),
                    (half - size, legs + 0.01, z),
                    (size * 0.6, size * 0.6),
                    (size, size),
                )
            )
    return built.mesh("cabinet")


def _fronts(built: Builder, rng: np.random.Generator, size: tuple, heights: tuple, counts: tuple) -> None:
    """Add doors or drawers with handles."""
    half, front = size
    gap, out, grip = 0.012, rng.uniform(0.005, 0.025), rng.uniform(0.02, 0.05)
    across = np.linspace(-half + 0.01, half - 0.01, counts[0] + 1)
    up = np.linspace(heights[0] + 0.02, heights[1] - 0.03, counts[1] + 1)
    upright = counts[1] == 1
    for left, right in itertools.pairwise(across):
        for low, high in itertools.pairwise(up):
            built.add(block((left + gap, low + gap, front - 0.01), (right - gap, high - gap, front + out)))
            x, y = (right - 0.06 if upright else (left + right) / 2), (low + high) / 2
            wide, tall = (0.01, 0.12 * (high - low)) if upright else (min(0.06, 0.2 * (right - left)), 0.01)
            built.add(block((x - wide, y - tall, front), (x + wide, y + tall, front + out + grip)))
