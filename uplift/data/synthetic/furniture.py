"""Synthetic furniture: chairs, sofas, tables, beds, shelves and what they stand on; lengths in metres."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial

import numpy as np

from uplift.data.synthetic.parts import Builder, Number, Part, ball, beam, block, lathe, loft, rod, rounded, slab, tube
from uplift.geometry.mesh import Mesh

__all__ = ["armchair", "bed", "bench", "cabinet", "chair", "desk", "shelf", "sofa", "stool", "table"]

# What furniture stands on: legs, turned legs, sledges, pedestals, stars of castors.

_FEET = ("square", "tapered", "splayed", "turned", "sledge", "pedestal", "star", "cantilever", "panels")
_WEIGHTS = (0.22, 0.15, 0.15, 0.1, 0.08, 0.06, 0.14, 0.05, 0.05)
_Size = tuple[Number, Number, Number]
"""Width in front, width at the back, depth."""


def _add_feet(built: Builder, kind: str, size: _Size, top: Number) -> None:
    """Add feet below a seat or a table's top."""
    makers = {"sledge": _sledge, "pedestal": _pedestal, "star": _star, "cantilever": _cantilever, "panels": _panels}
    makers.get(kind, partial(_legs, kind=kind))(built, size, top)


def _legs(built: Builder, size: _Size, top: Number, kind: str) -> None:
    rng = built.rng
    thick = rng.uniform(0.03, 0.065)
    inset = rng.uniform(0.45, 1.2) * thick
    splay = rng.uniform(0.05, 0.22) * top if kind == "splayed" else rng.uniform(0, 0.05) * top
    backwards = rng.uniform(0.0, 0.15) * top
    legs = []
    for end, width, out in ((1, size[0], splay), (-1, size[1], splay + backwards)):
        x, z = width / 2 - inset, end * (size[2] / 2 - inset)
        head, foot = (x, top, z), (x + splay * 0.7, 0.0, z + end * out)
        legs.append((head, foot))
        if kind == "turned":
            built.pair(_turned_leg(rng, foot, head, thick))
        elif kind == "splayed":
            built.pair(rod(foot, head, thick * 0.35, thick * 0.55))
        else:
            small = 1.0 if kind == "square" else 0.5
            built.pair(beam(foot, head, (thick * small, thick * small), (thick, thick)))
    if rng.random() < 0.35:
        _stretchers(built, legs, thick)


def _stretchers(built: Builder, legs: list, thick: Number) -> None:
    """Add rungs between the legs, low or high."""
    share = built.rng.uniform(0.2, 0.6)
    points = [np.add(foot, share * np.subtract(head, foot)) for head, foot in legs]
    radius = thick * built.rng.uniform(0.2, 0.35)
    built.pair(rod(points[0], points[1], radius, sides=6))
    kind = built.rng.choice(["H", "box", "none"])
    for point in {"H": [(points[0] + points[1]) / 2], "box": points, "none": []}[str(kind)]:
        built.add(rod(point, point * (-1, 1, 1), radius, sides=6))


def _turned_leg(rng: np.random.Generator, foot: tuple, head: tuple, thick: Number) -> Part:
    """Return a leg turned on a lathe."""
    rng = np.random.default_rng(int(rng.integers(1 << 30)))
    shares = np.array([0, 0.04, 0.1, 0.2, 0.45, 0.6, 0.66, 0.7, 0.78, 1.0])
    radii = np.array([0.35, 0.45, 0.28, 0.4, 0.55, 0.35, 0.6, 0.4, 0.6, 0.55]) * thick
    vertices, faces = lathe(radii * rng.uniform(0.75, 1.25, len(radii)), shares, sides=8)
    rise = vertices[:, 1:2] * np.subtract(head, foot)
    return Part(vertices * (1, 0, 1) + np.add(foot, rise), faces)


def _sledge(built: Builder, size: _Size, top: Number) -> None:
    """Add two frames at the sides that stand on their runners."""
    rng = built.rng
    thick, front, back = rng.uniform(0.02, 0.05), rng.uniform(0.75, 1.05), rng.uniform(0.75, 1.15)
    x, low = size[1] / 2 - thick / 2, thick / 2
    ends = (front * size[2] / 2, -back * size[2] / 2)
    built.pair(beam((x, low, ends[0]), (x, low, ends[1]), (thick, thick), across="xy"))
    for z, share in zip(ends, (0.85, -0.85), strict=True):
        built.pair(beam((x, 0, z), (x, top, share * size[2] / 2), (thick, thick)))


def _pedestal(built: Builder, size: _Size, top: Number) -> None:
    """Add one column on a round plate."""
    plate = built.rng.uniform(0.32, 0.5) * min(size[0], size[2])
    column, rise = built.rng.uniform(0.025, 0.06), built.rng.uniform(0.015, 0.05)
    radii = (plate, plate, column * 1.3, column, column, column * 1.8)
    built.add(lathe(radii, (0, rise, rise * 1.8, 0.3 * top, 0.85 * top, top), sides=16))


def _star(built: Builder, size: _Size, top: Number) -> None:
    """Add a swivel chair's foot: a column on four or five arms, most with castors."""
    rng = built.rng
    arms, column = rng.integers(4, 6), rng.uniform(0.02, 0.04)
    reach = rng.uniform(0.42, 0.62) * (size[0] + size[2]) / 2
    castor = rng.choice([0.0, rng.uniform(0.022, 0.035)], p=[0.25, 0.75])
    hub = 2 * castor + rng.uniform(0.03, 0.1)
    first = rng.choice([np.pi / 2, rng.uniform(0, 2 * np.pi)])
    radii = (column * 1.7, column * 1.7, column, column, column * 3)
    built.add(lathe(radii, (hub - 0.03, hub + 0.06, hub + 0.08, top - 0.04, top), sides=10))
    for angle in first + 2 * np.pi * np.arange(arms) / arms:
        x, z = reach * np.cos(angle), reach * np.sin(angle)
        built.add(rod((0, hub, 0), (x, 2 * castor + 0.015, z), column, column * 0.6, sides=6))
        if castor > 0:
            built.add(ball((x, castor, z), (castor * 0.9, castor, castor * 0.9)))


def _cantilever(built: Builder, size: _Size, top: Number) -> None:
    """Add runners that rise at the front only."""
    thick = built.rng.uniform(0.02, 0.035)
    x, front, back = size[1] / 2 - thick, size[2] / 2 - thick, -size[2] / 2
    low, high = thick / 2, top - thick / 2
    built.pair(rod((x, low, front), (x, low, back), thick / 2))
    built.pair(rod((x, 0, front), (x, top, front), thick / 2))
    built.pair(rod((x, high, front), (x, high, back), thick / 2))
    built.add(rod((-x, low, back), (x, low, back), thick / 2))


def _panels(built: Builder, size: _Size, top: Number) -> None:
    """Add a full board at either side, and sometimes one behind."""
    thick, x, back = built.rng.uniform(0.02, 0.05), size[1] / 2, -size[2] / 2
    built.pair(block((x - thick, 0, back), (x, top, size[2] / 2)))
    if built.rng.random() < 0.5:
        built.add(block((-x, built.rng.uniform(0, 0.6) * top, back), (x, top, back + thick)))


# Chairs: seats, backs, arms and feet of many kinds.

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
    """How far the back's top is behind its foot, as a share of its height."""
    back_height: float

    def back_at(self, share: Number, across: Number = 0.0) -> tuple[Number, Number, Number]:
        """Return a point of the back: ``share`` of its height, ``across`` of half its width."""
        height = share * self.back_height
        return across * self.back_width / 2, self.top + height, -self.depth / 2 - self.lean * height


def chair(rng: np.random.Generator) -> Mesh:
    """Return a chair, with or without arms, on legs or one foot."""
    built = Builder(rng)
    width, depth = rng.uniform(0.38, 0.6), rng.uniform(0.36, 0.55)
    back_width, top, thick = width * rng.uniform(0.75, 1.0), rng.uniform(0.38, 0.52), rng.uniform(0.025, 0.11)
    seat = _Seat(width, back_width, depth, top, thick, rng.uniform(0.0, 0.32), rng.uniform(0.28, 0.68))
    outline = rounded(width, depth, back_width, rng.choice([3.0, 5.0, 12.0, 30.0]))
    built.add(slab(outline, top - thick, top, rng.choice([0.0, 0.06, 0.12])))
    _add_feet(built, str(rng.choice(_FEET, p=_WEIGHTS)), (width, back_width, depth), top - thick)
    _add_back(built, seat)
    if rng.random() < 0.45:
        _add_arms(built, seat)
    return built.mesh("chair")


def stool(rng: np.random.Generator) -> Mesh:
    """Return a stool: a seat on legs or one foot, low or as high as a bar's, some with a low back."""
    built = Builder(rng)
    top, width = rng.uniform(0.35, 0.8), rng.uniform(0.28, 0.45)
    depth = width * rng.uniform(0.7, 1.0) if rng.random() < 0.5 else width
    thick = rng.uniform(0.025, 0.1)
    outline = (
        rounded(width, depth, power=2.0, corners=24)
        if rng.random() < 0.5
        else rounded(width, depth, power=rng.choice([4.0, 12.0, 30.0]))
    )
    built.add(slab(outline, top - thick, top, rng.choice([0.0, 0.1])))
    _add_feet(built, str(rng.choice(_FEET, p=_WEIGHTS)), (width * 0.9, width * 0.9, depth * 0.9), top - thick)
    if rng.random() < 0.3:
        seat = _Seat(width, width * 0.9, depth * 0.9, top, thick, rng.uniform(0, 0.2), rng.uniform(0.12, 0.3))
        _add_back(built, seat)
    return built.mesh("stool")


def _add_back(built: Builder, seat: _Seat) -> None:
    rng = built.rng
    kind, thick = rng.choice(_BACKS, p=_BACK_WEIGHTS), rng.uniform(0.02, 0.05)
    if kind == "bent":
        _add_bent(built, seat, thick)
    elif kind == "solid":
        low = rng.choice([0.0, rng.uniform(0.1, 0.45)])
        sizes = (seat.back_width, thick * 1.5), (seat.back_width * rng.uniform(0.75, 1.05), thick)
        built.add(beam(seat.back_at(low - 0.05), seat.back_at(1.0), *sizes))
        if low > 0:
            _add_posts(built, seat, thick, low)
    else:
        _add_posts(built, seat, thick, 1.0)
        _add_rail(built, seat, 1.0, rng.uniform(0.04, 0.12), thick, rng.uniform(0, 0.06))
        _fill_back(built, seat, kind, thick)


def _add_posts(built: Builder, seat: _Seat, thick: Number, share: Number) -> None:
    inset = 1 - thick / seat.back_width
    low, high = seat.back_at(-0.1, inset), seat.back_at(share, inset)
    if built.rng.random() < 0.5:
        built.pair(rod(low, high, thick * 0.6, thick * 0.45))
    else:
        built.pair(beam(low, high, (thick, thick * 1.3), (thick * 0.8, thick * 0.9)))


def _add_rail(built: Builder, seat: _Seat, share: Number, high: Number, thick: Number, bulge: Number = 0.0) -> None:
    """Add a board across the back, bent backwards by ``bulge``."""
    rings = []
    for across in np.linspace(-1, 1, 5):
        x, y, z = seat.back_at(share, across)
        z -= bulge * (1 - across**2)
        corners = ((-high, -thick / 2), (-high, thick / 2), (0, thick / 2), (0, -thick / 2))
        rings.append([(x, y + up, z + back) for up, back in corners])
    built.add(loft(np.array(rings)))


def _fill_back(built: Builder, seat: _Seat, kind: str, thick: Number) -> None:
    rng = built.rng
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
            _add_rail(built, seat, share, high, thick * 0.6)
    elif kind == "cross":
        for side in (1, -1):
            built.add(rod(seat.back_at(0.05, 0.9 * side), seat.back_at(0.95, -0.9 * side), thick * 0.4, sides=6))
    elif kind == "two":
        _add_rail(built, seat, rng.uniform(0.35, 0.65), rng.uniform(0.05, 0.12), thick)


def _add_bent(built: Builder, seat: _Seat, thick: Number) -> None:
    """Add a back of one bent board, round the sitter's sides more or less."""
    low, wrap = built.rng.choice([-0.04, 0.25]), built.rng.uniform(0.02, 0.35) * seat.depth
    rings = []
    for across in np.linspace(-1, 1, 9):
        high = 1 - built.rng.uniform(0, 0.01) - 0.25 * wrap / seat.depth * across**2
        foot, head = (np.add(seat.back_at(share, across), (0, 0, wrap * across**2)) for share in (low, high))
        rings.append([foot, foot + (0, 0, thick), head + (0, 0, thick), head])
    built.add(loft(np.array(rings)))
    if low > 0:
        x, y, z = seat.back_at(low + 0.15, 0.5)
        built.pair(beam(seat.back_at(-0.1, 0.5), (x, y, z + 0.25 * wrap), (thick * 1.4, thick)))


def _add_arms(built: Builder, seat: _Seat) -> None:
    rng = built.rng
    height = rng.uniform(0.16, 0.27)
    thick, wide = rng.uniform(0.02, 0.05), rng.uniform(0.03, 0.07)
    x = seat.width / 2 + rng.uniform(-0.3, 0.6) * wide
    front = seat.depth / 2 * rng.uniform(0.3, 1.0)
    _, y, z = seat.back_at(min(height / seat.back_height, 0.95))
    start = (x, seat.top + height - thick / 2, front)
    end = (min(x, seat.back_width / 2 + wide * 0.3), y - thick / 2, z)
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


# Benches, sofas and armchairs.


def armchair(rng: np.random.Generator) -> Mesh:
    """Return an upholstered armchair."""
    return _upholstered(rng, 1, "armchair")


def sofa(rng: np.random.Generator) -> Mesh:
    """Return a sofa of two to four seats, some with one arm or a longer seat at one end."""
    return _upholstered(rng, int(rng.integers(2, 5)), "sofa")


def _upholstered(rng: np.random.Generator, seats: int, category: str) -> Mesh:
    built = Builder(rng)
    width = seats * rng.uniform(0.52, 0.78)
    depth, top = rng.uniform(0.5, 0.7), rng.uniform(0.36, 0.5)
    arm, arm_rise = rng.uniform(0.08, 0.24), rng.uniform(0.08, 0.3)
    back, back_rise = rng.uniform(0.12, 0.28), rng.uniform(0.28, 0.6)
    legs = rng.choice([0.0, rng.uniform(0.04, 0.2)], p=[0.25, 0.75])
    cushion = rng.uniform(0.08, 0.18)
    half, lean = width / 2 + arm, rng.uniform(0.0, 0.25) * back_rise
    rear = -depth / 2 - back / 2
    built.add(block((-half, legs, rear), (half, top - cushion, depth / 2)))
    sizes = (2 * half, back), (2 * half * rng.uniform(0.9, 1.0), back * rng.uniform(0.4, 1.0))
    built.add(beam((0, top - cushion, rear), (0, top + back_rise, rear - lean), *sizes))
    _cushions(built, seats, (width, depth, cushion), top, (back_rise, lean))
    alike = int(rng.integers(1 << 30))
    for side in (1, -1) if rng.random() < 0.88 else (1,):
        _arm(built, alike, side * (half - arm / 2), (arm, arm_rise, depth), (legs, top))
    if seats > 2 and rng.random() < 0.3:  # a longer seat at one end
        side = rng.choice((1, -1))
        edge = side * width / 2
        built.add(block((edge - side * width / seats, legs, 0), (edge, top, depth / 2 + rng.uniform(0.4, 0.8))))
    if legs > 0:
        _short_legs(built, (half, depth / 2, rear), legs)
    return built.mesh(category)


def _cushions(built: Builder, seats: int, size: tuple, top: Number, back: tuple) -> None:
    width, depth, cushion = size
    back_rise, lean = back
    each = width / seats
    soft, loose = built.rng.choice([0.03, 0.1]), built.rng.random() < 0.6
    high = back_rise * built.rng.uniform(0.6, 1.15)
    for place in range(seats):
        x = -width / 2 + (place + 0.5) * each
        plan = rounded(each * 0.99, depth + 0.02, power=12.0, corners=16) + (x, 0.01)
        built.add(slab(plan, top - cushion, top, soft))
        if loose:
            foot, head = (x, top - 0.03, -depth / 2 + 0.06), (x, top + high, -depth / 2 - lean * 0.9 + 0.03)
            built.add(beam(foot, head, (each * 0.96, 0.18), (each * 0.9, 0.1)))


def _arm(built: Builder, seed: int, x: Number, size: tuple, heights: tuple) -> None:
    """Add an arm: a box, some with a roll on it; the same for the same seed."""
    arm, rise, depth = size
    legs, top = heights
    built.add(block((x - arm / 2, legs, -depth / 2 - 0.05), (x + arm / 2, top + rise, depth / 2)))
    if np.random.default_rng(seed).random() < 0.35:
        built.add(rod((x, top + rise, -depth / 2), (x, top + rise, depth / 2 + 0.02), arm * 0.62, sides=10))


def _short_legs(built: Builder, size: tuple, legs: Number) -> None:
    half, front, rear = size
    thick, splay = built.rng.uniform(0.03, 0.07), built.rng.uniform(0, 0.06)
    is_round = built.rng.random() < 0.5
    for z, out in ((front - thick, splay), (rear + thick, -splay)):
        head, foot = (half - thick, legs + 0.01, z), (half - thick + splay, 0, z + out)
        built.pair(rod(foot, head, thick * 0.4, thick * 0.7) if is_round else beam(foot, head, (thick, thick)))


def bench(rng: np.random.Generator) -> Mesh:
    """Return a bench: boards on two or more supports, with or without a back and arms."""
    built = Builder(rng)
    width, depth, top = rng.uniform(0.9, 2.0), rng.uniform(0.3, 0.5), rng.uniform(0.38, 0.5)
    thick = rng.uniform(0.025, 0.06)
    edges = np.linspace(-depth / 2, depth / 2, int(rng.integers(1, 6)) + 1)
    gap = 0.15 * (edges[1] - edges[0]) if len(edges) > 2 else 0.0
    for back, front in itertools.pairwise(edges):
        built.add(block((-width / 2, top - thick, back + gap / 2), (width / 2, top, front - gap / 2)))
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


# Tables and desks.


def table(rng: np.random.Generator) -> Mesh:
    """Return a table: round or not, dining or low, on legs, a column, trestles or boards."""
    built = Builder(rng)
    low = rng.random() < 0.35
    width = rng.uniform(0.5, 1.3) if low else rng.uniform(0.6, 2.0)
    depth = width * rng.uniform(0.45, 1.0)
    top, thick = (rng.uniform(0.3, 0.5) if low else rng.uniform(0.68, 0.8)), rng.uniform(0.02, 0.07)
    is_round = rng.random() < 0.35
    if is_round:
        depth = width * rng.choice([1.0, rng.uniform(0.6, 1.0)])
    outline = (
        rounded(width, depth, power=2.0, corners=24)
        if is_round
        else rounded(width, depth, power=rng.choice([6.0, 40.0]))
    )
    built.add(slab(outline, top - thick, top))
    share = rng.uniform(0.6, 0.7) if is_round else rng.uniform(0.8, 0.98)
    inner = (width * share, width * share, depth * share)
    kind = rng.choice(["square", "tapered", "splayed", "turned", "column", "trestle", "panels", "sledge"],
                      p=[0.22, 0.16, 0.12, 0.12, 0.16, 0.08, 0.07, 0.07])  # fmt: skip
    if kind == "column":
        _column(built, (width, depth), top - thick)
    elif kind == "trestle" and not is_round:
        _trestles(built, (width, depth), top - thick)
    else:
        _add_feet(built, kind if kind != "trestle" else "square", inner, top - thick)
    if kind in ("square", "tapered", "turned") and rng.random() < 0.6:
        _apron(built, inner, top - thick)
    if rng.random() < 0.15 and not is_round and kind not in ("column", "trestle", "panels"):  # a shelf below
        y = rng.uniform(0.15, 0.4) * top
        built.add(block((-inner[0] / 2, y, -inner[2] / 2), (inner[0] / 2, y + thick, inner[2] / 2)))
    return built.mesh("table")


def _apron(built: Builder, inner: tuple, top: Number) -> None:
    """Add the boards between the legs, right below the top."""
    high, thick = built.rng.uniform(0.04, 0.13), 0.02
    x, z = inner[0] / 2 - 0.03, inner[2] / 2 - 0.03
    built.pair(block((x - thick, top - high, -z), (x, top, z)))
    for end in (z, -z):
        built.add(block((-x, top - high, end - thick / 2), (x, top, end + thick / 2)))


def _column(built: Builder, size: tuple, top: Number) -> None:
    """Add one column, turned or plain, on a plate or on arms; a long table has two."""
    rng = built.rng
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
            built.add(arm.rotated(angle, "y", (x, 0, 0)))


def _trestles(built: Builder, size: tuple, top: Number) -> None:
    rng = built.rng
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
    built = Builder(rng)
    width, depth = rng.uniform(1.0, 1.8), rng.uniform(0.5, 0.8)
    top, thick = rng.uniform(0.7, 0.78), rng.uniform(0.02, 0.05)
    built.add(block((-width / 2, top - thick, -depth / 2), (width / 2, top, depth / 2)))
    chest, inset = rng.uniform(0.28, 0.45), rng.uniform(0, 0.04)
    side, has_both = rng.choice((1, -1)), rng.random() < 0.3
    for end in (1, -1):
        x = end * (width / 2 - inset)
        if has_both or end == side:
            _drawers(built, (x, -end * chest), depth, top - thick)
        elif rng.random() < 0.5:
            built.add(block((x, 0, -depth / 2), (x - end * 0.03, top - thick, depth / 2)))
        else:
            for z in (depth / 2 - 0.04, -depth / 2 + 0.04):
                x = end * (width / 2 - inset - 0.03)
                built.add(beam((x, 0, z), (x, top - thick, z), (0.04, 0.04), (0.05, 0.05)))
    if rng.random() < 0.6:
        low, x, z = rng.uniform(0.05, 0.6) * top, width / 2 - inset, -depth / 2 + 0.03
        built.add(block((-x, low, z), (x, top - thick, -depth / 2 + 0.05)))
    if rng.random() < 0.35:
        _hutch(built, (width, depth), top)
    return built.mesh("desk")


def _drawers(built: Builder, place: tuple, depth: Number, top: Number) -> None:
    """Add a chest of drawers, its fronts standing out, from the edge ``place[0]`` inwards."""
    rng = built.rng
    edge, across = place
    legs = rng.choice([0.0, rng.uniform(0.03, 0.3)])
    front = depth / 2 - 0.03
    built.add(block((edge, legs, -depth / 2 + 0.02), (edge + across, top, front)))
    start, end = edge + 0.06 * across, edge + 0.94 * across
    for low, high in itertools.pairwise(np.linspace(legs + 0.01, top - 0.01, int(rng.integers(1, 5)) + 1)):
        built.add(block((start, low + 0.01, front - 0.01), (end, high - 0.01, front + 0.02)))
        middle, y = (start + end) / 2, (low + high) / 2
        built.add(block((middle - 0.05, y - 0.012, front), (middle + 0.05, y + 0.012, front + 0.05)))
    if legs > 0:
        for x in (edge + 0.12 * across, edge + 0.88 * across):
            for z in (front - 0.04, -depth / 2 + 0.06):
                built.add(beam((x, 0, z), (x, legs + 0.01, z), (0.03, 0.03), (0.04, 0.04)))


def _hutch(built: Builder, size: tuple, top: Number) -> None:
    """Add a shelf that stands on the desk's far edge."""
    rng = built.rng
    width, depth = size
    rise, deep = rng.uniform(0.2, 0.6), rng.uniform(0.18, 0.3)
    back, front = -depth / 2, -depth / 2 + deep
    built.pair(block((width / 2 - 0.025, top, back), (width / 2, top + rise, front)))
    for y in np.linspace(top + rise, top, int(rng.integers(1, 3)), endpoint=False):
        built.add(block((-width / 2, y - 0.025, back), (width / 2, y, front)))
    if rng.random() < 0.5:
        built.add(block((-width / 2, top, back), (width / 2, top + rise, back + 0.015)))


# Beds, shelves and cabinets.


def bed(rng: np.random.Generator) -> Mesh:
    """Return a bed seen from its foot: mattress, pillows, a head board and often a foot board."""
    built = Builder(rng)
    width, length = rng.uniform(0.8, 1.9), rng.uniform(1.9, 2.15)
    legs, frame, soft = rng.uniform(0.05, 0.25), rng.uniform(0.08, 0.22), rng.uniform(0.12, 0.3)
    base = legs + frame
    built.add(block((-width / 2, legs, -length / 2), (width / 2, base, length / 2)))
    outline = rounded(width * rng.uniform(0.92, 0.99), length * 0.97, power=20.0, corners=20)
    built.add(slab(outline, base - 0.02, base + soft, 0.02))
    for x in (0.0,) if width < 1.25 else (-width / 4, width / 4):
        plan = rounded(min(width * 0.42, 0.7), 0.42, power=4.0, corners=12) + (x, -length / 2 + 0.3)
        built.add(slab(plan, base + soft - 0.03, base + soft + rng.uniform(0.06, 0.14), 0.25))
    _board(built, (width, legs), base + soft + rng.uniform(0.15, 0.75), -length / 2)
    if rng.random() < 0.45:
        _board(built, (width, legs), base + soft + rng.uniform(-0.1, 0.35), length / 2)
    thick = rng.uniform(0.05, 0.1)
    for z in (length / 2 - thick / 2, -length / 2 + thick / 2):
        built.pair(beam((width / 2 - thick / 2, 0, z), (width / 2 - thick / 2, base, z), (thick, thick)))
    return built.mesh("bed")


def _board(built: Builder, size: tuple, top: Number, z: Number) -> None:
    """Add a head or foot board: solid, of bars, or an arch, between two posts."""
    rng = built.rng
    width, legs = size
    thick, kind = rng.uniform(0.03, 0.08), rng.choice(["solid", "bars", "posts"])
    half = width / 2 + thick / 2
    if kind == "solid":
        built.add(beam((0, legs, z), (0, top, z - rng.uniform(0, 0.08) * np.sign(-z)), (2 * half, thick)))
    elif kind == "posts":
        post_top = top + rng.uniform(0.05, 0.3)
        built.pair(_turned_leg(rng, (half, 0, z), (half, post_top, z), thick * 1.4))
        built.add(block((-half, legs, z - thick / 3), (half, top, z + thick / 3)))
    else:
        built.pair(beam((half, 0, z), (half, top, z), (thick, thick)))
        built.add(beam((-half, top - thick / 2, z), (half, top - thick / 2, z), (thick, thick), across="yz"))
        for x in np.linspace(-half, half, int(rng.integers(5, 12)))[1:-1]:
            built.add(rod((x, legs, z), (x, top - thick / 2, z), thick * 0.25, sides=6))


def shelf(rng: np.random.Generator) -> Mesh:
    """Return an open shelf, with boards, uprights, some with a back and with compartments."""
    built = Builder(rng)
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
    built = Builder(rng)
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
    columns = int(rng.integers(1, 5 if kind in ("wardrobe", "sideboard") else 3))
    rows = 1 if kind == "wardrobe" else int(rng.integers(1, 5))
    _fronts(built, (half, front), (legs, height), (columns, rows))
    if legs > 0:
        size, splay = rng.uniform(0.03, 0.07), rng.uniform(0, 0.25) * legs
        x = half - size
        for z, out in ((front - size, splay), (-front + size, -splay)):
            foot = (x + splay, 0, z + out)
            built.pair(beam(foot, (x, legs + 0.01, z), (size * 0.6, size * 0.6), (size, size)))
    return built.mesh("cabinet")


def _fronts(built: Builder, size: tuple, heights: tuple, counts: tuple) -> None:
    """Add doors or drawers with handles."""
    half, front = size
    gap, out, grip = 0.012, built.rng.uniform(0.005, 0.025), built.rng.uniform(0.02, 0.05)
    across = np.linspace(-half + 0.01, half - 0.01, counts[0] + 1)
    up = np.linspace(heights[0] + 0.02, heights[1] - 0.03, counts[1] + 1)
    upright = counts[1] == 1
    for left, right in itertools.pairwise(across):
        for low, high in itertools.pairwise(up):
            built.add(block((left + gap, low + gap, front - 0.01), (right - gap, high - gap, front + out)))
            x, y = (right - 0.06 if upright else (left + right) / 2), (low + high) / 2
            wide, tall = (0.01, 0.12 * (high - low)) if upright else (min(0.06, 0.2 * (right - left)), 0.01)
            built.add(block((x - wide, y - tall, front), (x + wide, y + tall, front + out + grip)))
