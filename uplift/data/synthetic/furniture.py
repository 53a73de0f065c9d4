"""Made-up furniture: chairs, sofas, tables, beds, shelves and what they stand on; lengths in metres."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from uplift.data.synthetic.parts import Builder, Part, ball, beam, block, lathe, loft, oval, rod, rounded, slab, tube
from uplift.geometry.mesh import Mesh

__all__ = ["armchair", "bed", "bench", "cabinet", "chair", "desk", "shelf", "sofa", "stool", "table"]

# What made-up furniture stands on: legs, turned legs, sledges, pedestals, stars of castors.

_FEET = ("square", "tapered", "splayed", "turned", "sledge", "pedestal", "star", "cantilever", "panels")
_WEIGHTS = (0.22, 0.15, 0.15, 0.1, 0.08, 0.06, 0.14, 0.05, 0.05)
_CORNERS = ((1, 1), (1, -1))


def _draw_feet(rng: np.random.Generator) -> str:
    """Return what kind of feet a chair stands on."""
    return str(rng.choice(_FEET, p=_WEIGHTS))


def _add_feet(
    built: Builder,
    rng: np.random.Generator,
    kind: str,
    size: tuple[int | float, int | float, int | float],
    top: int | float,
) -> None:
    """Add feet below a seat or a table's top: ``size`` is its width in front, at the back, and its depth."""
    makers = {"sledge": _sledge, "pedestal": _pedestal, "star": _star, "cantilever": _cantilever, "panels": _panels}
    if kind in makers:
        makers[kind](built, rng, size, top)
    else:
        _legs(built, rng, kind, size, top)


def _legs(
    built: Builder,
    rng: np.random.Generator,
    kind: str,
    size: tuple[int | float, int | float, int | float],
    top: int | float,
) -> None:
    thick = rng.uniform(0.03, 0.065)
    inset = rng.uniform(0.45, 1.2) * thick
    splay = rng.uniform(0.05, 0.22) * top if kind == "splayed" else rng.uniform(0, 0.05) * top
    backwards = rng.uniform(0.0, 0.15) * top
    feet = {}
    for side, end in _CORNERS:
        x = (size[0] if end > 0 else size[1]) / 2 - inset
        z = end * (size[2] / 2 - inset)
        out = splay if end > 0 else splay + backwards
        head, foot = (x, top, z), (x + side * splay * 0.7, 0.0, z + end * out)
        feet[end] = head, foot
        if kind == "turned":
            built.pair(_turned_leg(int(rng.integers(1 << 30)), foot, head, thick))
        elif kind == "splayed":
            built.pair(rod(foot, head, thick * 0.35, thick * 0.55))
        else:
            small = 1.0 if kind == "square" else 0.5
            built.pair(beam(foot, head, (thick * small, thick * small), (thick, thick)))
    if rng.random() < 0.35:
        _stretchers(built, rng, feet, thick)


def _stretchers(built: Builder, rng: np.random.Generator, feet: dict, thick: int | float) -> None:
    """Add rungs between the legs, low or high."""
    share = rng.uniform(0.2, 0.6)
    points = {end: np.add(foot, share * np.subtract(head, foot)) for end, (head, foot) in feet.items()}
    radius = thick * rng.uniform(0.2, 0.35)
    built.pair(rod(points[1], points[-1], radius, sides=6))
    kind = rng.choice(["H", "box", "none"])
    if kind == "H":
        middle = (points[1] + points[-1]) / 2
        built.add(rod(middle, middle * (-1, 1, 1), radius, sides=6))
    elif kind == "box":
        for point in points.values():
            built.add(rod(point, point * (-1, 1, 1), radius, sides=6))


def _turned_leg(seed: int, foot: tuple, head: tuple, thick: int | float) -> Part:
    """Return a leg turned on a lathe: the same for the same seed."""
    rng = np.random.default_rng(seed)
    shares = np.array([0, 0.04, 0.1, 0.2, 0.45, 0.6, 0.66, 0.7, 0.78, 1.0])
    radii = np.array([0.35, 0.45, 0.28, 0.4, 0.55, 0.35, 0.6, 0.4, 0.6, 0.55]) * thick
    part = lathe(radii * rng.uniform(0.75, 1.25, len(radii)), shares, sides=8)
    vertices = part.vertices.copy()
    rise = vertices[:, 1:2].copy()
    vertices[:, 1] = 0
    return Part(vertices + np.add(foot, rise * np.subtract(head, foot)), part.faces)


def _sledge(
    built: Builder, rng: np.random.Generator, size: tuple[int | float, int | float, int | float], top: int | float
) -> None:
    """Add two frames at the sides that stand on their runners."""
    thick, front, back = rng.uniform(0.02, 0.05), rng.uniform(0.75, 1.05), rng.uniform(0.75, 1.15)
    x, low = size[1] / 2 - thick / 2, thick / 2
    ends = [(x, low, front * size[2] / 2), (x, low, -back * size[2] / 2)]
    built.pair(beam(ends[0], ends[1], (thick, thick), across="xy"))
    for end, share in zip(ends, (0.85, -0.85), strict=True):
        built.pair(beam((end[0], 0, end[2]), (x, top, share * size[2] / 2), (thick, thick)))


def _pedestal(
    built: Builder, rng: np.random.Generator, size: tuple[int | float, int | float, int | float], top: int | float
) -> None:
    """Add one column on a round plate."""
    plate = rng.uniform(0.32, 0.5) * min(size[0], size[2])
    column = rng.uniform(0.025, 0.06)
    rise = rng.uniform(0.015, 0.05)
    built.add(
        lathe(
            (plate, plate, column * 1.3, column, column, column * 1.8),
            (0, rise, rise * 1.8, 0.3 * top, 0.85 * top, top),
            sides=16,
        )
    )


def _star(
    built: Builder, rng: np.random.Generator, size: tuple[int | float, int | float, int | float], top: int | float
) -> None:
    """Add a swivel chair's foot: a column on four or five arms, most with castors."""
    arms, column = rng.integers(4, 6), rng.uniform(0.02, 0.04)
    reach = rng.uniform(0.42, 0.62) * (size[0] + size[2]) / 2
    castor = rng.choice([0.0, rng.uniform(0.022, 0.035)], p=[0.25, 0.75])
    hub = 2 * castor + rng.uniform(0.03, 0.1)
    turned = rng.choice([np.pi / 2, rng.uniform(0, 2 * np.pi)])
    built.add(
        lathe(
            (column * 1.7, column * 1.7, column, column, column * 3),
            (hub - 0.03, hub + 0.06, hub + 0.08, top - 0.04, top),
            sides=10,
        )
    )
    for angle in turned + 2 * np.pi * np.arange(arms) / arms:
        x, z = reach * np.cos(angle), reach * np.sin(angle)
        built.add(rod((0, hub, 0), (x, 2 * castor + 0.015, z), column, column * 0.6, sides=6))
        if castor > 0:
            built.add(ball((x, castor, z), (castor * 0.9, castor, castor * 0.9)))


def _cantilever(
    built: Builder, rng: np.random.Generator, size: tuple[int | float, int | float, int | float], top: int | float
) -> None:
    """Add runners that rise at the front only."""
    thick = rng.uniform(0.02, 0.035)
    x, front, back = size[1] / 2 - thick, size[2] / 2 - thick, -size[2] / 2
    built.pair(rod((x, thick / 2, front), (x, thick / 2, back), thick / 2))
    built.pair(rod((x, 0, front), (x, top, front), thick / 2))
    built.pair(rod((x, top - thick / 2, front), (x, top - thick / 2, back), thick / 2))
    built.add(rod((-x, thick / 2, back), (x, thick / 2, back), thick / 2))


def _panels(
    built: Builder, rng: np.random.Generator, size: tuple[int | float, int | float, int | float], top: int | float
) -> None:
    """Add a full board at either side, and sometimes one behind."""
    thick = rng.uniform(0.02, 0.05)
    built.pair(block((size[1] / 2 - thick, 0, -size[2] / 2), (size[1] / 2, top, size[2] / 2)))
    if rng.random() < 0.5:
        low = rng.uniform(0, 0.6) * top
        built.add(block((-size[1] / 2, low, -size[2] / 2), (size[1] / 2, top, -size[2] / 2 + thick)))


# Made-up chairs: seats, backs, arms and feet of many kinds; lengths in metres.

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

    def back_at(self, share: int | float, across: int | float = 0.0) -> tuple[int | float, int | float, int | float]:
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
    feet = _draw_feet(rng)
    _add_feet(built, rng, feet, (seat.width, seat.back_width, seat.depth), seat.top - seat.thick)
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
    _add_feet(built, rng, _draw_feet(rng), (width * 0.9, width * 0.9, depth * 0.9), top - thick)
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


def _add_posts(built: Builder, rng: np.random.Generator, seat: _Seat, thick: int | float, share: int | float) -> None:
    inset = 1 - thick / seat.back_width
    low, high = seat.back_at(-0.1, inset), seat.back_at(share, inset)
    if rng.random() < 0.5:
        built.pair(rod(low, high, thick * 0.6, thick * 0.45))
    else:
        built.pair(beam(low, high, (thick, thick * 1.3), (thick * 0.8, thick * 0.9)))


def _add_rail(
    built: Builder, seat: _Seat, share: int | float, high: int | float, thick: int | float, bulge: int | float
) -> None:
    """Add a board across the back, bent backwards by ``bulge``."""
    rings = []
    for across in np.linspace(-1, 1, 5):
        x, y, z = seat.back_at(share, across)
        z -= bulge * (1 - across**2)
        corners = ((-high, -thick / 2), (-high, thick / 2), (0, thick / 2), (0, -thick / 2))
        rings.append([(x, y + up, z + back) for up, back in corners])
    built.add(loft(np.array(rings)))


def _fill_back(built: Builder, rng: np.random.Generator, seat: _Seat, kind: str, thick: int | float) -> None:
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


def _add_bent(built: Builder, rng: np.random.Generator, seat: _Seat, thick: int | float) -> None:
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


# Made-up benches, sofas and armchairs; lengths in metres.


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


def _cushions(
    built: Builder, rng: np.random.Generator, seats: int, size: tuple, top: int | float, spine: tuple
) -> None:
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


def _arm(built: Builder, seed: int, x: int | float, size: tuple, heights: tuple) -> None:
    """Add an arm: a box, a box with a roll on it, or a board on posts; the same for the same seed."""
    rng = np.random.default_rng(seed)
    arm, rise, depth = size
    legs, top = heights
    low, high = (x - arm / 2, legs, -depth / 2 - 0.05), (x + arm / 2, top + rise, depth / 2)
    built.add(block(low, high))
    if rng.random() < 0.35:
        built.add(rod((x, top + rise, -depth / 2), (x, top + rise, depth / 2 + 0.02), arm * 0.62, sides=10))


def _short_legs(built: Builder, rng: np.random.Generator, size: tuple, legs: int | float) -> None:
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


def _boards(built: Builder, count: int, size: tuple, ends: tuple, thick: int | float) -> None:
    width, top = size
    edges = np.linspace(ends[0][2], ends[1][2], count + 1)
    gap = 0.15 * (edges[1] - edges[0]) if count > 1 else 0.0
    for back, front in itertools.pairwise(edges):
        built.add(block((-width / 2, top - thick, back + gap / 2), (width / 2, top, front - gap / 2)))


# Made-up tables and desks; lengths in metres.


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
        _add_feet(built, rng, kind if kind != "trestle" else "square", inner, top - thick)
    if kind in ("square", "tapered", "turned") and rng.random() < 0.6:
        _apron(built, rng, inner, top - thick)
    if rng.random() < 0.15 and not is_round and kind not in ("column", "trestle", "panels"):  # a shelf below
        y = rng.uniform(0.15, 0.4) * top
        built.add(block((-inner[0] / 2, y, -inner[2] / 2), (inner[0] / 2, y + thick, inner[2] / 2)))
    return built.mesh("table")


def _apron(built: Builder, rng: np.random.Generator, inner: tuple, top: int | float) -> None:
    """Add the boards between the legs, right below the top."""
    high, thick = rng.uniform(0.04, 0.13), 0.02
    x, z = inner[0] / 2 - 0.03, inner[2] / 2 - 0.03
    built.pair(block((x - thick, top - high, -z), (x, top, z)))
    for end in (z, -z):
        built.add(block((-x, top - high, end - thick / 2), (x, top, end + thick / 2)))


def _column(built: Builder, rng: np.random.Generator, size: tuple, top: int | float) -> None:
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


def _trestles(built: Builder, rng: np.random.Generator, size: tuple, top: int | float) -> None:
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


def _drawers(built: Builder, rng: np.random.Generator, place: tuple, depth: int | float, top: int | float) -> None:
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


def _hutch(built: Builder, rng: np.random.Generator, size: tuple, top: int | float) -> None:
    """Add a shelf that stands on the desk's far edge."""
    width, depth = size
    rise, deep = rng.uniform(0.2, 0.6), rng.uniform(0.18, 0.3)
    back, front = -depth / 2, -depth / 2 + deep
    built.pair(block((width / 2 - 0.025, top, back), (width / 2, top + rise, front)))
    for y in np.linspace(top + rise, top, int(rng.integers(1, 3)), endpoint=False):
        built.add(block((-width / 2, y - 0.025, back), (width / 2, y, front)))
    if rng.random() < 0.5:
        built.add(block((-width / 2, top, back), (width / 2, top + rise, back + 0.015)))


# Made-up beds, shelves and cabinets; lengths in metres.


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


def _board(built: Builder, rng: np.random.Generator, size: tuple, top: int | float, z: int | float) -> None:
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
        built.pair(_turned_leg(int(rng.integers(1 << 30)), (half, 0, z), (half, post_top, z), thick * 1.4))
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
