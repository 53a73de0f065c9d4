"""Made-up chairs: seats, backs, arms and feet of many kinds; lengths in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uplift.meshes.mesh import Mesh
from uplift.meshes.procedural.feet import add_feet, draw_feet
from uplift.meshes.procedural.parts import Builder, beam, block, loft, oval, rod, rounded, slab, tube

__all__ = ["chair", "stool"]

_BACKS = ("solid", "slats", "ladder", "spindles", "frame", "bent", "cross", "two")
_BACK_WEIGHTS = (0.2, 0.14, 0.14, 0.12, 0.1, 0.16, 0.07, 0.07)


@dataclass
class _Seat:
    """What the parts of one chair must agree on."""

    width: float
    back_width: float
    depth: float
    top: float
    thick: float
    lean: float
    """How far the back's top stands behind its foot, of its height."""
    back_height: float

    def back_at(self, share: float, across: float = 0.0) -> tuple[float, float, float]:
        """Return a point of the back: ``share`` of its height, ``across`` of half its width."""
        height = share * self.back_height
        return across * self.back_width / 2, self.top + height, -self.depth / 2 - self.lean * height


def chair(rng: np.random.Generator) -> Mesh:
    """Return a chair, with or without arms, on legs or one foot."""
    width, depth = rng.uniform(0.38, 0.6), rng.uniform(0.36, 0.55)
    seat = _Seat(
        width=width,
        back_width=width * rng.uniform(0.75, 1.0),
        depth=depth,
        top=rng.uniform(0.38, 0.52),
        thick=rng.uniform(0.025, 0.11),
        lean=rng.uniform(0.0, 0.32),
        back_height=rng.uniform(0.28, 0.68),
    )
    built = Builder()
    power = rng.choice([3.0, 5.0, 12.0, 30.0])
    outline = rounded(seat.width, seat.depth, seat.back_width, power)
    built.add(slab(outline, seat.top - seat.thick, seat.top, rng.choice([0.0, 0.06, 0.12])))
    feet = draw_feet(rng)
    add_feet(built, rng, feet, (seat.width, seat.back_width, seat.depth), seat.top - seat.thick)
    _add_back(built, rng, seat)
    if rng.random() < 0.45:
        _add_arms(built, rng, seat)
    return built.mesh("chair")


def stool(rng: np.random.Generator) -> Mesh:
    """Return a stool: a seat on legs or one foot, low or as high as a bar's, some with a low back."""
    built = Builder()
    top, width = rng.uniform(0.35, 0.8), rng.uniform(0.28, 0.45)
    depth = width * rng.uniform(0.7, 1.0) if rng.random() < 0.5 else width
    thick = rng.uniform(0.025, 0.1)
    outline = oval(width, depth) if rng.random() < 0.5 else rounded(width, depth, power=rng.choice([4.0, 12.0, 30.0]))
    built.add(slab(outline, top - thick, top, rng.choice([0.0, 0.1])))
    add_feet(built, rng, draw_feet(rng), (width * 0.9, width * 0.9, depth * 0.9), top - thick)
    if rng.random() < 0.3:
        seat = _Seat(width, width * 0.9, depth * 0.9, top, thick, rng.uniform(0, 0.2), rng.uniform(0.12, 0.3))
        _add_back(built, rng, seat)
    return built.mesh("stool")


def _add_back(built: Builder, rng: np.random.Generator, seat: _Seat) -> None:
    kind = rng.choice(_BACKS, p=_BACK_WEIGHTS)
    thick = rng.uniform(0.02, 0.05)
    if kind == "bent":
        _add_bent(built, rng, seat, thick)
        return
    if kind == "solid":
        low = rng.choice([0.0, rng.uniform(0.1, 0.45)])
        top_share = rng.uniform(0.75, 1.05)
        sizes = (seat.back_width, thick * 1.5), (seat.back_width * top_share, thick)
        built.add(beam(seat.back_at(low - 0.05), seat.back_at(1.0), *sizes))
        if low > 0:
            _add_posts(built, rng, seat, thick, low)
        return
    _add_posts(built, rng, seat, thick, 1.0)
    rail = rng.uniform(0.04, 0.12)
    _add_rail(built, seat, 1.0, rail, thick, rng.uniform(0, 0.06))
    _fill_back(built, rng, seat, kind, thick)


def _add_posts(built: Builder, rng: np.random.Generator, seat: _Seat, thick: float, share: float) -> None:
    inset = 1 - thick / seat.back_width
    low, high = seat.back_at(-0.1, inset), seat.back_at(share, inset)
    if rng.random() < 0.5:
        built.pair(rod(low, high, thick * 0.6, thick * 0.45))
    else:
        built.pair(beam(low, high, (thick, thick * 1.3), (thick * 0.8, thick * 0.9)))


def _add_rail(built: Builder, seat: _Seat, share: float, high: float, thick: float, bulge: float) -> None:
    """Add a board across the back, bent backwards by ``bulge``."""
    rings = []
    for across in np.linspace(-1, 1, 5):
        x, y, z = seat.back_at(share, across)
        z -= bulge * (1 - across**2)
        corners = ((-high, -thick / 2), (-high, thick / 2), (0, thick / 2), (0, -thick / 2))
        rings.append([(x, y + up, z + back) for up, back in corners])
    built.add(loft(np.array(rings)))


def _fill_back(built: Builder, rng: np.random.Generator, seat: _Seat, kind: str, thick: float) -> None:
    if kind in ("slats", "spindles"):
        count = rng.integers(2, 8)
        for across in np.linspace(-1, 1, count + 2)[1:-1] * 0.95:
            low, high = seat.back_at(-0.03, across), seat.back_at(0.97, across)
            if kind == "slats":
                built.add(beam(low, high, (seat.back_width / count * 0.45, thick * 0.5)))
            else:
                built.add(rod(low, high, thick * 0.3, sides=6))
    elif kind == "ladder":
        count = rng.integers(1, 5)
        high = seat.back_height / (count + 1) * rng.uniform(0.3, 0.6)
        for share in np.linspace(0.15, 1, count + 1)[:-1] + 0.1:
            _add_rail(built, seat, share, high, thick * 0.6, 0.0)
    elif kind == "cross":
        ends = (0.05, 0.9), (0.95, -0.9)
        for sign in (1, -1):
            (low, across), (high, other) = ends
            built.add(rod(seat.back_at(low, sign * across), seat.back_at(high, sign * other), thick * 0.4, sides=6))
    elif kind == "two":
        _add_rail(built, seat, rng.uniform(0.35, 0.65), rng.uniform(0.05, 0.12), thick, 0.0)


def _add_bent(built: Builder, rng: np.random.Generator, seat: _Seat, thick: float) -> None:
    """Add a back of one bent board, round the sitter's sides more or less."""
    low, wrap = rng.choice([-0.04, 0.25]), rng.uniform(0.02, 0.35) * seat.depth
    steps = np.linspace(-1, 1, 9)
    rings = []
    for across in steps:
        drop = 1 - rng.uniform(0, 0.01) - 0.25 * wrap / seat.depth * across**2
        front, back = seat.back_at(low, across), seat.back_at(drop, across)
        forward = wrap * across**2
        rings.append(
            [
                (front[0], front[1], front[2] + forward),
                (front[0], front[1], front[2] + forward + thick),
                (back[0], back[1], back[2] + forward + thick),
                (back[0], back[1], back[2] + forward),
            ]
        )
    built.add(loft(np.array(rings)))
    if low > 0:
        x, y, z = seat.back_at(low + 0.15, 0.5)
        built.pair(beam(seat.back_at(-0.1, 0.5), (x, y, z + 0.25 * wrap), (thick * 1.4, thick)))


def _add_arms(built: Builder, rng: np.random.Generator, seat: _Seat) -> None:
    height = rng.uniform(0.16, 0.27)
    thick, wide = rng.uniform(0.02, 0.05), rng.uniform(0.03, 0.07)
    x = seat.width / 2 + rng.uniform(-0.3, 0.6) * wide
    front = seat.depth / 2 * rng.uniform(0.3, 1.0)
    share = min(height / seat.back_height, 0.95)
    back = seat.back_at(share)
    end = (min(x, seat.back_width / 2 + wide * 0.3), back[1] - thick / 2, back[2])
    start = (x, seat.top + height - thick / 2, front)
    kind = rng.choice(["post", "panel", "loop"])
    if kind == "loop":
        path = np.array([(x, seat.top - seat.thick / 2, front * 0.6), (x, seat.top + height * 0.5, front), start, end])
        built.pair(tube(path, (thick * 0.6,) * 4))
        return
    built.pair(beam(start, end, (wide, thick), across="xy"))
    if kind == "panel":
        built.pair(block((x - wide / 3, seat.top - seat.thick, -seat.depth / 2), (x + wide / 3, start[1], front)))
    else:
        foot = (x, seat.top - seat.thick, front * rng.uniform(0.7, 1.0))
        built.pair(beam(foot, (x, start[1], front * 0.9), (wide * 0.7, thick), (wide * 0.7, thick)))
