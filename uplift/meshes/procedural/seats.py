"""Made-up benches, sofas and armchairs; lengths in metres."""

from __future__ import annotations

import itertools

import numpy as np

from uplift.meshes.mesh import Mesh
from uplift.meshes.procedural.parts import Builder, beam, block, rod, rounded, slab

__all__ = ["armchair", "bench", "sofa"]


def armchair(rng: np.random.Generator) -> Mesh:
    """Return an upholstered armchair."""
    return _upholstered(rng, 1, "armchair")


def sofa(rng: np.random.Generator) -> Mesh:
    """Return a sofa of two to four seats, some with one arm or a longer seat at one end."""
    return _upholstered(rng, int(rng.integers(2, 5)), "sofa")


def _upholstered(rng: np.random.Generator, seats: int, category: str) -> Mesh:
    built = Builder()
    width = seats * rng.uniform(0.52, 0.78)
    depth, top = rng.uniform(0.5, 0.7), rng.uniform(0.36, 0.5)
    arm, arm_rise = rng.uniform(0.08, 0.24), rng.uniform(0.08, 0.3)
    back, back_rise = rng.uniform(0.12, 0.28), rng.uniform(0.28, 0.6)
    legs = rng.choice([0.0, rng.uniform(0.04, 0.2)], p=[0.25, 0.75])
    cushion = rng.uniform(0.08, 0.18)
    half, lean = width / 2 + arm, rng.uniform(0.0, 0.25) * back_rise
    built.add(block((-half, legs, -depth / 2 - back / 2), (half, top - cushion, depth / 2)))
    spine = top - cushion
    built.add(
        beam(
            (0, spine, -depth / 2 - back / 2), (0, top + back_rise, -depth / 2 - back / 2 - lean),
            (2 * half, back), (2 * half * rng.uniform(0.9, 1.0), back * rng.uniform(0.4, 1.0)),
        )
    )  # fmt: skip
    _cushions(built, rng, seats, (width, depth, cushion), top, (back_rise, lean, back))
    alike = int(rng.integers(1 << 30))
    for side in (1, -1) if rng.random() < 0.88 else (1,):
        _arm(built, alike, side * (half - arm / 2), (arm, arm_rise, depth), (legs, top))
    if seats > 2 and rng.random() < 0.3:  # a longer seat at one end
        side = rng.choice((1, -1))
        edge = side * width / 2
        built.add(block((edge - side * width / seats, legs, 0), (edge, top, depth / 2 + rng.uniform(0.4, 0.8))))
    if legs > 0:
        _short_legs(built, rng, (half, depth, back), legs)
    return built.mesh(category)


def _cushions(built: Builder, rng: np.random.Generator, seats: int, size: tuple, top: float, spine: tuple) -> None:
    width, depth, cushion = size
    back_rise, lean, _ = spine
    each = width / seats
    soft = rng.choice([0.03, 0.1])
    loose = rng.random() < 0.6
    high = back_rise * rng.uniform(0.6, 1.15)
    for place in range(seats):
        x = -width / 2 + (place + 0.5) * each
        plan = rounded(each * 0.99, depth + 0.02, power=12.0, corners=16) + (x, 0.01)
        built.add(slab(plan, top - cushion, top, soft))
        if loose:
            foot, head = (x, top - 0.03, -depth / 2 + 0.06), (x, top + high, -depth / 2 - lean * 0.9 + 0.03)
            built.add(beam(foot, head, (each * 0.96, 0.18), (each * 0.9, 0.1)))


def _arm(built: Builder, seed: int, x: float, size: tuple, heights: tuple) -> None:
    """Add an arm: a box, a box with a roll on it, or a board on posts; the same for the same seed."""
    rng = np.random.default_rng(seed)
    arm, rise, depth = size
    legs, top = heights
    low, high = (x - arm / 2, legs, -depth / 2 - 0.05), (x + arm / 2, top + rise, depth / 2)
    built.add(block(low, high))
    if rng.random() < 0.35:
        built.add(rod((x, top + rise, -depth / 2), (x, top + rise, depth / 2 + 0.02), arm * 0.62, sides=10))


def _short_legs(built: Builder, rng: np.random.Generator, size: tuple, legs: float) -> None:
    half, depth, back = size
    thick, splay = rng.uniform(0.03, 0.07), rng.uniform(0, 0.06)
    round_ones = rng.random() < 0.5
    for z, out in ((depth / 2 - thick, splay), (-depth / 2 - back / 2 + thick, -splay)):
        head, foot = (half - thick, legs + 0.01, z), (half - thick + splay, 0, z + out)
        if round_ones:
            built.pair(rod(foot, head, thick * 0.4, thick * 0.7))
        else:
            built.pair(beam(foot, head, (thick, thick)))


def bench(rng: np.random.Generator) -> Mesh:
    """Return a bench: boards on two or more supports, with or without a back and arms."""
    built = Builder()
    width, depth, top = rng.uniform(0.9, 2.0), rng.uniform(0.3, 0.5), rng.uniform(0.38, 0.5)
    thick = rng.uniform(0.025, 0.06)
    boards = int(rng.integers(1, 6))
    _boards(built, boards, (width, top), ((0, 0, -depth / 2), (0, 0, depth / 2)), thick)
    leg, inset = rng.uniform(0.04, 0.1), rng.uniform(0.03, 0.25) * width
    has_back, lean = rng.random() < 0.65, rng.uniform(0, 0.35)
    rise = rng.uniform(0.3, 0.5)
    x = width / 2 - inset
    if rng.random() < 0.3:
        built.pair(block((x - leg / 2, 0, -depth / 2), (x + leg / 2, top - thick, depth / 2)))
    else:
        for z in (depth / 2 - leg / 2, -depth / 2 + leg / 2):
            built.pair(beam((x, 0, z), (x, top - thick / 2, z), (leg * rng.uniform(0.6, 1.0), leg), (leg, leg)))
    if has_back:
        low, high = (x, top - thick, -depth / 2), (x, top + rise, -depth / 2 - lean * rise)
        built.pair(beam(low, high, (leg, leg), (leg * 0.7, leg * 0.6)))
        for share in np.linspace(1, 0.3, int(rng.integers(1, 5))):
            _, y, z = np.add(low, share * np.subtract(high, low))
            board = rng.uniform(0.1, 0.2) * rise
            built.add(block((-width / 2, y - board, z - thick / 3), (width / 2, y, z + thick)))
        if rng.random() < 0.5:
            y = top + rng.uniform(0.15, 0.25)
            built.pair(beam((x, y, -depth / 2), (x, y, depth / 2), (leg, thick), across="xy"))
            built.pair(beam((x, top - thick, depth / 2 - leg / 2), (x, y, depth / 2 - leg / 2), (leg * 0.7, leg * 0.7)))
    return built.mesh("bench")


def _boards(built: Builder, count: int, size: tuple, ends: tuple, thick: float) -> None:
    width, top = size
    edges = np.linspace(ends[0][2], ends[1][2], count + 1)
    gap = 0.15 * (edges[1] - edges[0]) if count > 1 else 0.0
    for back, front in itertools.pairwise(edges):
        built.add(block((-width / 2, top - thick, back + gap / 2), (width / 2, top, front - gap / 2)))
