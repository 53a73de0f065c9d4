"""Made-up tables and desks; lengths in metres."""

from __future__ import annotations

import itertools

import numpy as np

from uplift.meshes.mesh import Mesh
from uplift.meshes.procedural.feet import add_feet
from uplift.meshes.procedural.parts import Builder, beam, block, lathe, oval, rounded, slab

__all__ = ["desk", "table"]


def table(rng: np.random.Generator) -> Mesh:
    """Return a table: round or not, dining or low, on legs, a column, trestles or boards."""
    built = Builder()
    low = rng.random() < 0.35
    width = rng.uniform(0.5, 1.3) if low else rng.uniform(0.6, 2.0)
    depth = width * rng.uniform(0.45, 1.0)
    top, thick = (rng.uniform(0.3, 0.5) if low else rng.uniform(0.68, 0.8)), rng.uniform(0.02, 0.07)
    is_round = rng.random() < 0.35
    if is_round:
        depth = width * rng.choice([1.0, rng.uniform(0.6, 1.0)])
    outline = oval(width, depth) if is_round else rounded(width, depth, power=rng.choice([6.0, 40.0]))
    built.add(slab(outline, top - thick, top))
    share = rng.uniform(0.6, 0.7) if is_round else rng.uniform(0.8, 0.98)
    inner = (width * share, width * share, depth * share)
    kind = rng.choice(["square", "tapered", "splayed", "turned", "column", "trestle", "panels", "sledge"],
                      p=[0.22, 0.16, 0.12, 0.12, 0.16, 0.08, 0.07, 0.07])  # fmt: skip
    if kind == "column":
        _column(built, rng, (width, depth), top - thick)
    elif kind == "trestle" and not is_round:
        _trestles(built, rng, (width, depth), top - thick)
    else:
        add_feet(built, rng, kind if kind != "trestle" else "square", inner, top - thick)
    if kind in ("square", "tapered", "turned") and rng.random() < 0.6:
        _apron(built, rng, inner, top - thick)
    if rng.random() < 0.15 and not is_round and kind not in ("column", "trestle", "panels"):  # a shelf below
        y = rng.uniform(0.15, 0.4) * top
        built.add(block((-inner[0] / 2, y, -inner[2] / 2), (inner[0] / 2, y + thick, inner[2] / 2)))
    return built.mesh("table")


def _apron(built: Builder, rng: np.random.Generator, inner: tuple, top: float) -> None:
    """Add the boards between the legs, right below the top."""
    high, thick = rng.uniform(0.04, 0.13), 0.02
    x, z = inner[0] / 2 - 0.03, inner[2] / 2 - 0.03
    built.pair(block((x - thick, top - high, -z), (x, top, z)))
    for end in (z, -z):
        built.add(block((-x, top - high, end - thick / 2), (x, top, end + thick / 2)))


def _column(built: Builder, rng: np.random.Generator, size: tuple, top: float) -> None:
    """Add one column, turned or plain, on a plate or on arms; a long table has two."""
    width, depth = size
    places = (0.0,) if width < 1.7 * depth else (-0.28 * width, 0.28 * width)
    radius, reach = rng.uniform(0.03, 0.1), 0.38 * depth
    bulge = rng.uniform(0.6, 1.6, 3)
    arms = int(rng.integers(3, 5)) if rng.random() < 0.5 else 0
    first = rng.uniform(0, np.pi)
    for x in places:
        radii = np.array([1.2, bulge[0], bulge[1], bulge[2], 1.0, 2.0]) * radius
        built.add(lathe(radii, np.array([0.02, 0.2, 0.4, 0.6, 0.9, 1.0]) * top, x, sides=12))
        if not arms:
            built.add(lathe((reach, reach, reach * 0.6), (0, 0.03, 0.05), x, sides=20))
        for angle in first + 2 * np.pi * np.arange(arms) / max(arms, 1):
            arm = beam((x, 0.16, 0), (x + reach, 0.025, 0), (0.1, 0.06), (0.05, 0.05), across="yz")
            built.add(arm.turned(angle, "y", (x, 0, 0)))


def _trestles(built: Builder, rng: np.random.Generator, size: tuple, top: float) -> None:
    width, depth = size
    x, thick, spread = width * rng.uniform(0.3, 0.42), rng.uniform(0.04, 0.08), rng.uniform(0.2, 0.42) * depth
    cross = rng.random() < 0.4
    for end in (1, -1):
        head = -end * spread if cross else end * spread * 0.3
        built.pair(beam((x, 0, end * spread), (x, top, head), (thick, thick)))
    y = rng.uniform(0.15, 0.5) * top
    built.add(beam((-x, y, 0), (x, y, 0), (thick, thick), across="yz"))
    if not cross:
        built.pair(beam((x, y, -spread), (x, y, spread), (thick, thick), across="xy"))


def desk(rng: np.random.Generator) -> Mesh:
    """Return a desk seen from where one sits: drawers at one side or both, a board behind, some with a shelf on top."""
    built = Builder()
    width, depth = rng.uniform(1.0, 1.8), rng.uniform(0.5, 0.8)
    top, thick = rng.uniform(0.7, 0.78), rng.uniform(0.02, 0.05)
    built.add(block((-width / 2, top - thick, -depth / 2), (width / 2, top, depth / 2)))
    chest, inset = rng.uniform(0.28, 0.45), rng.uniform(0, 0.04)
    side = rng.choice((1, -1))
    has_both = rng.random() < 0.3
    for end in (1, -1):
        if has_both or end == side:
            _drawers(built, rng, (end * (width / 2 - inset), -end * chest), depth, top - thick)
        elif rng.random() < 0.5:
            x = end * (width / 2 - inset)
            built.add(block((x, 0, -depth / 2), (x - end * 0.03, top - thick, depth / 2)))
        else:
            for z in (depth / 2 - 0.04, -depth / 2 + 0.04):
                x = end * (width / 2 - inset - 0.03)
                built.add(beam((x, 0, z), (x, top - thick, z), (0.04, 0.04), (0.05, 0.05)))
    if rng.random() < 0.6:
        low = rng.uniform(0.05, 0.6) * top
        built.add(
            block((-width / 2 + inset, low, -depth / 2 + 0.03), (width / 2 - inset, top - thick, -depth / 2 + 0.05))
        )
    if rng.random() < 0.35:
        _hutch(built, rng, (width, depth), top)
    return built.mesh("desk")


def _drawers(built: Builder, rng: np.random.Generator, place: tuple, depth: float, top: float) -> None:
    """Add a chest of drawers, its fronts standing out, from the edge ``place[0]`` inwards."""
    edge, across = place
    legs = rng.choice([0.0, rng.uniform(0.03, 0.3)])
    front = depth / 2 - 0.03
    built.add(block((edge, legs, -depth / 2 + 0.02), (edge + across, top, front)))
    count = int(rng.integers(1, 5))
    edges = np.linspace(legs + 0.01, top - 0.01, count + 1)
    for low, high in itertools.pairwise(edges):
        inner = (edge + 0.06 * across, edge + 0.94 * across)
        built.add(block((inner[0], low + 0.01, front - 0.01), (inner[1], high - 0.01, front + 0.02)))
        middle, y = (inner[0] + inner[1]) / 2, (low + high) / 2
        built.add(block((middle - 0.05, y - 0.012, front), (middle + 0.05, y + 0.012, front + 0.05)))
    if legs > 0:
        for x in (edge + 0.12 * across, edge + 0.88 * across):
            for z in (front - 0.04, -depth / 2 + 0.06):
                built.add(beam((x, 0, z), (x, legs + 0.01, z), (0.03, 0.03), (0.04, 0.04)))


def _hutch(built: Builder, rng: np.random.Generator, size: tuple, top: float) -> None:
    """Add a shelf that stands on the desk's far edge."""
    width, depth = size
    rise, deep = rng.uniform(0.2, 0.6), rng.uniform(0.18, 0.3)
    back, front = -depth / 2, -depth / 2 + deep
    built.pair(block((width / 2 - 0.025, top, back), (width / 2, top + rise, front)))
    for y in np.linspace(top + rise, top, int(rng.integers(1, 3)), endpoint=False):
        built.add(block((-width / 2, y - 0.025, back), (width / 2, y, front)))
    if rng.random() < 0.5:
        built.add(block((-width / 2, top, back), (width / 2, top + rise, back + 0.015)))
