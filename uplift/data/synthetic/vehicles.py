"""Synthetic cars, vans, buses, lorries and tractors; lengths in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uplift.data.synthetic.parts import Builder, Number, Part, beam, block, loft, rod
from uplift.geometry.mesh import Mesh

__all__ = ["bus", "car", "lorry", "pickup", "tractor", "van"]

# What vehicles have in common: hull, cabin, wheels.


_Range = tuple[Number, Number]


def _hull(stations: list[tuple[Number, ...]]) -> Part:
    """Return a body through sections of z, low, high, half width and how much narrower it is at its top."""
    z, low, high, half, inset = np.asarray(stations, float).T
    x = np.stack([half * 0.9, half, half, half * inset], 1)
    y = np.stack([low, low + 0.3 * (high - low), low + 0.75 * (high - low), high], 1)
    rings = np.empty((len(z), 8, 3))
    rings[..., 0] = np.concatenate([x, -x[:, ::-1]], 1)
    rings[..., 1] = np.concatenate([y, y[:, ::-1]], 1)
    rings[..., 2] = z[:, None]
    return loft(rings)


def _cabin(width: Number, ends: _Range, heights: _Range, slopes: _Range, narrow: float) -> Part:
    """Return the part above the belt: wind screen and rear window lean by ``slopes`` (front, back), sides draw in."""
    (back, front), (low, high), (lean, rear) = ends, heights, slopes
    half, bend = width / 2, high - 0.12 * (high - low)
    levels = [  # height, half width, front, back: the roof's edges are rounded
        (low, half, front, back),
        (bend, half * (narrow + 0.03), front - lean * 0.92, back + rear * 0.92),
        (high, half * narrow * 0.94, front - lean * 1.12, back + rear * 1.12),
    ]
    rings = [[(-w, y, b), (w, y, b), (w, y, f), (-w, y, f)] for y, w, f, b in levels]
    return loft(np.array(rings))


def _add_wheels(built: Builder, width: Number, radius: Number, axles: Sequence[Number], share: Number = 1.0) -> None:
    """Add a wheel at either side of each axle; ``share`` of the body's width is the track's outer edge."""
    tyre, out = built.rng.uniform(0.5, 0.75) * radius, width / 2 * share + built.rng.uniform(-0.01, 0.04)
    for z in axles:
        built.pair(rod((out - tyre, radius, z), (out, radius, z), radius, sides=16))


# Cars, vans and pick-ups.


@dataclass
class _Body:
    """What the parts of one car must agree on; z runs forwards from the middle of its length."""

    length: float
    width: float
    floor: float
    bonnet: float
    """How high the bonnet's front edge is."""
    belt: float
    """How high the windows begin."""
    roof: float
    wheel: float

    def __post_init__(self) -> None:
        self.nose = self.length / 2
        self.rise = self.roof - self.belt


def car(rng: np.random.Generator) -> Mesh:
    """Return a car: hatchback, saloon, estate, coupe or a tall one for rough roads."""
    style = str(rng.choice(("hatchback", "saloon", "estate", "coupe", "suv"), p=(0.28, 0.25, 0.17, 0.12, 0.18)))
    tall = style == "suv"
    body = _Body(
        length=rng.uniform(3.5, 4.3) if style == "hatchback" else rng.uniform(4.1, 5.1),
        width=rng.uniform(1.6, 1.95),
        floor=rng.uniform(0.25, 0.42) if tall else rng.uniform(0.14, 0.26),
        bonnet=rng.uniform(0.8, 1.0) if tall else rng.uniform(0.55, 0.8),
        belt=rng.uniform(1.0, 1.15) if tall else rng.uniform(0.82, 0.98),
        roof=rng.uniform(1.6, 1.9) if tall else rng.uniform(1.22, 1.58),
        wheel=rng.uniform(0.34, 0.42) if tall else rng.uniform(0.28, 0.36),
    )
    boot = {"saloon": rng.uniform(0.14, 0.24), "coupe": rng.uniform(0.08, 0.16)}.get(style, rng.uniform(0.0, 0.03))
    cowl = body.nose - body.length * rng.uniform(0.19, 0.3)
    tail = -body.nose + boot * body.length
    built = Builder(rng)
    end = body.belt - rng.uniform(0.0, 0.1)
    built.add(_car_hull(rng, body, cowl, end))
    back_slope = {"hatchback": (0.4, 1.0), "estate": (0.1, 0.6), "suv": (0.1, 0.5)}.get(style, (1.0, 1.9))
    slopes = body.rise * rng.uniform(0.9, 1.9), min(body.rise * rng.uniform(*back_slope), (cowl - tail) * 0.45)
    built.add(_cabin(body.width * 0.93, (tail, cowl), (body.belt - 0.06, body.roof), slopes, rng.uniform(0.74, 0.9)))
    _finish(built, body, cowl, (tail + slopes[1], cowl - slopes[0]))
    return built.mesh(style)


def van(rng: np.random.Generator) -> Mesh:
    """Return a van or a minibus: a short bonnet and one long, high body."""
    body = _Body(
        rng.uniform(4.3, 6.2), rng.uniform(1.75, 2.1), rng.uniform(0.2, 0.35), rng.uniform(0.85, 1.1),
        rng.uniform(1.05, 1.3), rng.uniform(1.85, 2.7), rng.uniform(0.3, 0.38),
    )  # fmt: skip
    built = Builder(rng)
    cowl = body.nose - rng.uniform(0.35, 0.95)
    built.add(_car_hull(rng, body, cowl, body.belt))
    slopes = min(body.rise, 1.0) * rng.uniform(0.5, 1.1), body.rise * rng.uniform(0.02, 0.15)
    ends, heights = (-body.nose + 0.03, cowl), (body.belt - 0.06, body.roof)
    built.add(_cabin(body.width * 0.97, ends, heights, slopes, rng.uniform(0.82, 0.96)))
    _finish(built, body, cowl, (-body.nose + 0.5, cowl - slopes[0]))
    return built.mesh("van")


def pickup(rng: np.random.Generator) -> Mesh:
    """Return a pick-up: a cabin in the middle and an open bed behind."""
    body = _Body(
        rng.uniform(4.7, 5.8), rng.uniform(1.7, 2.05), rng.uniform(0.3, 0.5), rng.uniform(0.85, 1.1),
        rng.uniform(1.08, 1.25), rng.uniform(1.65, 1.95), rng.uniform(0.34, 0.45),
    )  # fmt: skip
    built = Builder(rng)
    cowl = body.nose - body.length * rng.uniform(0.22, 0.29)
    tail = cowl - body.length * rng.uniform(0.28, 0.42)
    bed = body.floor + rng.uniform(0.25, 0.4)
    front = replace(body, length=body.nose - tail)
    shift = (0, 0, body.nose - front.nose)
    hood = _car_hull(rng, front, cowl - shift[2], body.belt)
    built.add(Part(hood.vertices + shift, hood.faces))
    slopes = body.rise * rng.uniform(0.7, 1.3), body.rise * rng.uniform(0.05, 0.3)
    built.add(_cabin(body.width * 0.93, (tail, cowl), (body.belt - 0.06, body.roof), slopes, rng.uniform(0.78, 0.9)))
    half, rim = body.width / 2 * 0.97, body.belt - rng.uniform(0.0, 0.15)
    built.add(block((-half, body.floor, -body.nose), (half, bed, tail + 0.05)))
    built.pair(block((half - 0.07, bed - 0.01, -body.nose), (half, rim, tail + 0.05)))
    built.add(block((-half, bed - 0.01, -body.nose), (half, rim, -body.nose + 0.07)))
    _finish(built, body, cowl, (tail, cowl - slopes[0]))
    return built.mesh("pickup")


def _car_hull(rng: np.random.Generator, body: _Body, cowl: Number, end: Number) -> Part:
    """Return the lower body: bumper, bonnet up to the windscreen's foot, belt, tail."""
    nose, half, low = body.nose, body.width / 2, body.floor
    bumper = low + (body.bonnet - low) * rng.uniform(0.55, 0.8)
    ends, inset = rng.uniform(0.78, 0.92), rng.uniform(0.84, 0.95)
    return _hull([
        (-nose, low + 0.12, low + (end - low) * rng.uniform(0.6, 0.95), half * ends, inset),
        (-nose + 0.15, low + 0.03, end, half * 0.96, inset),
        (-nose * 0.5, low, body.belt, half, inset),
        (cowl, low, body.belt, half, inset),
        (nose - 0.3, low, body.bonnet, half * 0.97, inset),
        (nose - 0.08, low, (body.bonnet + bumper) / 2, half * (ends + 0.06), inset),
        (nose, low + 0.08, bumper, half * ends * 0.93, inset),
    ])  # fmt: skip


def _finish(built: Builder, body: _Body, cowl: Number, roof: _Range) -> None:
    """Add wheels and mirrors, and sometimes bars on the roof or a spoiler."""
    rng, nose = built.rng, body.nose
    front = nose - body.wheel - body.length * rng.uniform(0.07, 0.12)
    _add_wheels(built, body.width, body.wheel, (front, -nose + body.wheel + body.length * rng.uniform(0.07, 0.14)))
    half, y, z = body.width / 2, body.belt + 0.05, cowl - rng.uniform(0.35, 0.6)
    size = rng.uniform(0.1, 0.2)
    sizes = (0.04, 0.05), (size * 0.8, 0.09)
    built.pair(beam((half * 0.85, y, z), (half + size, y + 0.03, z - 0.03), *sizes, across="yz"))
    if rng.random() < 0.2:
        x, top = half * 0.66, body.roof
        built.pair(beam((x, top + 0.04, roof[0]), (x, top + 0.04, roof[1]), (0.04, 0.05), across="xy"))
        for z in roof:
            built.pair(block((x - 0.02, top - 0.1, z - 0.04), (x + 0.02, top + 0.05, z + 0.04)))
    elif rng.random() < 0.12:
        y, z = max(body.belt + 0.18, body.roof - 0.35), -nose + 0.15
        built.add(block((-half * 0.8, y, z - 0.12), (half * 0.8, y + 0.03, z + 0.12)))
        built.pair(block((half * 0.6, body.belt * 0.8, z - 0.04), (half * 0.63, y + 0.01, z + 0.06)))


# Buses, lorries and tractors.


def bus(rng: np.random.Generator) -> Mesh:
    """Return a bus or a coach, of one floor or two."""
    built = Builder(rng)
    length, width = rng.uniform(7.0, 13.0), rng.uniform(2.25, 2.6)
    floor, wheel = rng.uniform(0.25, 0.5), rng.uniform(0.42, 0.55)
    high = rng.uniform(3.8, 4.4) if rng.random() < 0.25 else rng.uniform(2.7, 3.6)
    nose, half = length / 2, width / 2
    lean, bulge = rng.uniform(0, 0.5), rng.uniform(0.0, 0.25)
    rings = []
    for y, share, front, back in (
        (floor, 0.97, bulge * 0.5, 0.05), (floor + 0.4, 1.0, 0.0, 0.0), (high * 0.5, 1.0, bulge * 0.3, 0.0),
        (high - 0.2, 0.96, bulge + lean, 0.05), (high, 0.86, bulge + lean + 0.25, 0.2),
    ):  # fmt: skip
        x, f, b = half * share, nose - front, -nose + back
        rings.append([(-x, y, b), (x, y, b), (x, y, f - 0.15), (x * 0.85, y, f), (-x * 0.85, y, f), (-x, y, f - 0.15)])
    built.add(loft(np.array(rings)))
    axles = [nose - rng.uniform(0.14, 0.24) * length, -nose + rng.uniform(0.16, 0.28) * length]
    if length > 11 and rng.random() < 0.5:
        axles.append(axles[1] - 2.3 * wheel)
    _add_wheels(built, width, wheel, axles, 0.98)
    y = high * rng.uniform(0.5, 0.8)
    built.pair(beam((half * 0.8, y + 0.3, nose - lean), (half + 0.15, y, nose + 0.2), (0.05, 0.05)))
    built.pair(block((half + 0.05, y - 0.35, nose + 0.12), (half + 0.25, y + 0.05, nose + 0.22)))
    if rng.random() < 0.5:
        end = (half * 0.6, high + rng.uniform(0.1, 0.3), nose * rng.uniform(0, 0.4))
        built.add(block((-half * 0.6, high - 0.05, -nose * 0.3), end))
    return built.mesh("bus")


def lorry(rng: np.random.Generator) -> Mesh:
    """Return a lorry: a cab over the engine or behind a bonnet, and a box, a flat bed, a tank or a tipper."""
    built = Builder(rng)
    width, wheel = rng.uniform(2.1, 2.55), rng.uniform(0.42, 0.55)
    frame, high = wheel * 1.9, rng.uniform(2.5, 3.4)
    bonnet = rng.uniform(0.9, 1.6) if rng.random() < 0.3 else 0.0
    cab, load = rng.uniform(1.4, 2.4), rng.uniform(3.0, 9.0)
    nose = (bonnet + cab + load) / 2
    back = nose - bonnet - cab
    _cab(built, (nose, back, bonnet), (width, wheel * 0.9, high))
    gap = rng.uniform(0.08, 0.5)
    built.pair(block((0.3, frame - 0.35, -nose + 0.1), (0.5, frame, back + 0.5)))
    _load(built, (-nose, back - gap), (width, frame, high))
    rear = -nose + rng.uniform(0.14, 0.3) * load
    axles = [nose - max(bonnet * 0.5, 0.3) - wheel * 1.3, rear]
    if load > 5:
        axles.append(rear + 2.25 * wheel)
    if load > 7 and rng.random() < 0.7:
        axles.append(back - wheel)
    _add_wheels(built, width, wheel, axles, 0.97)
    return built.mesh("lorry")


def _cab(built: Builder, ends: tuple, size: tuple) -> None:
    rng = built.rng
    nose, back, bonnet = ends
    width, floor, high = size
    front, half = nose - bonnet, width / 2
    waist = floor + (high - floor) * rng.uniform(0.35, 0.5)
    built.add(block((-half, floor, back), (half, waist, front)))
    slopes = (high - waist) * rng.uniform(0.05, 0.35), rng.uniform(0.0, 0.08)
    built.add(_cabin(width, (back, front), (waist - 0.02, high), slopes, rng.uniform(0.88, 0.98)))
    if bonnet > 0:
        end_size = (width * rng.uniform(0.55, 0.8), (waist - floor) * rng.uniform(0.75, 0.95))
        start, size = (0, (floor + waist) / 2, front - 0.05), (width * 0.9, waist - floor)
        end = (0, start[1] - (size[1] - end_size[1]) / 2, nose)
        built.add(beam(start, end, size, end_size, across="xy"))
        built.pair(block((half * 0.6, floor - 0.1, front), (half * 0.98, floor + 0.45, nose - 0.25)))
    else:
        built.add(block((-half * 0.97, floor * 0.6, front - 0.3), (half * 0.97, floor + 0.2, front + 0.08)))
    y = (waist + high) / 2
    built.pair(block((half + 0.05, y - 0.3, front - 0.35), (half + 0.22, y + 0.3, front - 0.28)))
    built.pair(beam((half * 0.9, y, front - 0.32), (half + 0.15, y, front - 0.32), (0.05, 0.05), across="yz"))
    if rng.random() < 0.35:  # a wind deflector
        foot, head = (0, high - 0.15, (back + front) / 2 - 0.1), (0, high + rng.uniform(0.25, 0.7), back + 0.3)
        wide = width * 0.8
        built.add(beam(foot, head, (wide, (front - back) * 0.6), (wide * 0.9, 0.4)))


def _load(built: Builder, ends: tuple[Number, Number], size: tuple) -> None:
    rng = built.rng
    back, front = ends
    width, frame, high = size
    half, middle = width / 2, (back + front) / 2
    kind = rng.choice(["box", "flat", "tank", "tipper"], p=[0.5, 0.18, 0.14, 0.18])
    if kind == "box":
        built.add(block((-half, frame - 0.05, back), (half, high * rng.uniform(0.95, 1.2), front)))
        return
    built.add(block((-half, frame - 0.05, back), (half, frame + 0.12, front)))
    if kind == "tank":
        radius = min(half, (high * 1.05 - frame) / 2)
        built.add(rod((0, frame + radius, back + 0.1), (0, frame + radius, front - 0.1), radius, sides=16))
        return
    rim = frame + (rng.uniform(0.3, 0.6) if kind == "flat" else rng.uniform(0.7, 1.3))
    built.add(block((-half, frame, front - 0.08), (half, rim + 0.3, front)))
    if kind == "tipper" or rng.random() < 0.6:
        top = (half + rng.uniform(0, 0.15), rim, middle)
        built.pair(beam((half - 0.1, frame, middle), top, (0.08, front - back)))
        built.add(block((-half, frame, back), (half, rim - 0.05, back + 0.08)))


def tractor(rng: np.random.Generator) -> Mesh:
    """Return a tractor: a narrow bonnet, big wheels behind, a cab or a roll bar."""
    built = Builder(rng)
    big, small = rng.uniform(0.65, 1.0), rng.uniform(0.35, 0.6)
    length = rng.uniform(2.6, 3.6)
    nose, half = length / 2, rng.uniform(0.3, 0.45)
    rear, front = -nose + big * 0.7, nose - small - rng.uniform(0.0, 0.3)
    waist, top, cowl = rng.uniform(1.15, 1.5), rng.uniform(2.2, 2.9), rear + rng.uniform(0.5, 0.9)
    low, drop = small * 1.2, rng.uniform(0.02, 0.3)
    start, end = (0, (low + waist) / 2, cowl - 0.1), (0, (low + waist - drop) / 2, nose)
    built.add(beam(start, end, (2 * half, waist - low), (2 * half * 0.8, waist - drop - low), across="xy"))
    built.add(block((-half * 0.8, low * 0.8, rear - 0.4), (half * 0.8, waist * 0.8, cowl)))
    track, tyre = rng.uniform(0.75, 1.0), big * rng.uniform(0.4, 0.6)
    built.pair(rod((track - tyre, big, rear), (track, big, rear), big, sides=20))
    built.pair(rod((track - tyre * 0.75, small, front), (track - 0.1, small, front), small, sides=16))
    built.add(rod((-track + 0.2, small, front), (track - 0.2, small, front), 0.08, sides=6))
    built.pair(block((half * 0.7, big * 1.5, rear - big * 0.8), (track, 2 * big + 0.1, rear + big * 0.6)))
    floor, wide = min(waist, 1.1), 2 * track * rng.uniform(0.7, 0.85)
    if rng.random() < 0.7:
        slopes = rng.uniform(0, 0.3), rng.uniform(0, 0.25)
        built.add(_cabin(wide, (rear - 0.4, cowl + 0.15), (floor, top), slopes, rng.uniform(0.85, 1.0)))
        built.add(block((-wide * 0.47, top - 0.05, rear - 0.4), (wide * 0.47, top + 0.1, cowl + 0.1)))
    else:
        for z in (rear - 0.35,) if rng.random() < 0.5 else (rear - 0.35, cowl):
            built.pair(block((half * 0.85, floor, z), (half * 0.85 + 0.08, top, z + 0.08)))
            built.add(block((-half - 0.03, top - 0.08, z), (half + 0.03, top, z + 0.08)))
        built.add(block((-0.25, floor * 0.9, rear - 0.25), (0.25, floor + 0.25, rear + 0.25)))
        built.add(block((-0.25, floor, rear - 0.3), (0.25, floor + rng.uniform(0.45, 0.7), rear - 0.18)))
    x = half * rng.uniform(-0.6, 0.6)
    built.add(rod((x, waist - drop - 0.1, nose * 0.5), (x, top * rng.uniform(0.75, 1.0), nose * 0.5), 0.05, sides=6))
    return built.mesh("tractor")
