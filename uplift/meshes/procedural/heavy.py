"""Made-up buses, lorries and tractors; lengths in metres."""

from __future__ import annotations

import numpy as np

from uplift.meshes.mesh import Mesh
from uplift.meshes.procedural.bodywork import add_wheels, cabin
from uplift.meshes.procedural.building import Builder
from uplift.meshes.procedural.parts import beam, block, loft, rod

__all__ = ["bus", "lorry", "tractor"]


def bus(rng: np.random.Generator) -> Mesh:
    """Return a bus or a coach, of one floor or two."""
    built = Builder()
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
    add_wheels(built, rng, width, wheel, tuple(axles), 0.98)
    y = high * rng.uniform(0.5, 0.8)
    built.pair(beam((half * 0.8, y + 0.3, nose - lean), (half + 0.15, y, nose + 0.2), (0.05, 0.05)))
    built.pair(block((half + 0.05, y - 0.35, nose + 0.12), (half + 0.25, y + 0.05, nose + 0.22)))
    if rng.random() < 0.5:
        built.add(
            block(
                (-half * 0.6, high - 0.05, -nose * 0.3),
                (half * 0.6, high + rng.uniform(0.1, 0.3), nose * rng.uniform(0, 0.4)),
            )
        )
    return built.mesh("bus")


def lorry(rng: np.random.Generator) -> Mesh:
    """Return a lorry: a cab over the engine or behind a bonnet, and a box, a flat bed, a tank or a tipper."""
    built = Builder()
    width, wheel = rng.uniform(2.1, 2.55), rng.uniform(0.42, 0.55)
    frame, high = wheel * 1.9, rng.uniform(2.5, 3.4)
    bonnet = rng.uniform(0.9, 1.6) if rng.random() < 0.3 else 0.0
    cab, load = rng.uniform(1.4, 2.4), rng.uniform(3.0, 9.0)
    nose = (bonnet + cab + load) / 2
    back = nose - bonnet - cab
    _cab(built, rng, (nose, back, bonnet), (width, wheel * 0.9, high))
    gap = rng.uniform(0.08, 0.5)
    built.pair(block((0.3, frame - 0.35, -nose + 0.1), (0.5, frame, back + 0.5)))
    _load(built, rng, (-nose, back - gap), (width, frame, high))
    rear = -nose + rng.uniform(0.14, 0.3) * load
    axles = [nose - max(bonnet * 0.5, 0.3) - wheel * 1.3, rear]
    if load > 5:
        axles.append(rear + 2.25 * wheel)
    if load > 7 and rng.random() < 0.7:
        axles.append(back - wheel)
    add_wheels(built, rng, width, wheel, tuple(axles), 0.97)
    return built.mesh("lorry")


def _cab(built: Builder, rng: np.random.Generator, ends: tuple, size: tuple) -> None:
    nose, back, bonnet = ends
    width, floor, high = size
    front, half = nose - bonnet, width / 2
    waist = floor + (high - floor) * rng.uniform(0.35, 0.5)
    built.add(block((-half, floor, back), (half, waist, front)))
    slopes = (high - waist) * rng.uniform(0.05, 0.35), rng.uniform(0.0, 0.08)
    built.add(cabin(width, (back, front), (waist - 0.02, high), slopes, rng.uniform(0.88, 0.98)))
    if bonnet > 0:
        sizes = (
            (width * 0.9, waist - floor),
            (width * rng.uniform(0.55, 0.8), (waist - floor) * rng.uniform(0.75, 0.95)),
        )
        middle = (floor + waist) / 2
        built.add(
            beam((0, middle, front - 0.05), (0, middle - (sizes[0][1] - sizes[1][1]) / 2, nose), *sizes, across="xy")
        )
        built.pair(block((half * 0.6, floor - 0.1, front), (half * 0.98, floor + 0.45, nose - 0.25)))
    else:
        built.add(block((-half * 0.97, floor * 0.6, front - 0.3), (half * 0.97, floor + 0.2, front + 0.08)))
    y = (waist + high) / 2
    built.pair(block((half + 0.05, y - 0.3, front - 0.35), (half + 0.22, y + 0.3, front - 0.28)))
    built.pair(beam((half * 0.9, y, front - 0.32), (half + 0.15, y, front - 0.32), (0.05, 0.05), across="yz"))
    if rng.random() < 0.35:  # what leads the wind over the load
        top = rng.uniform(0.25, 0.7)
        wide = width * 0.8
        built.add(
            beam(
                (0, high - 0.15, (back + front) / 2 - 0.1),
                (0, high + top, back + 0.3),
                (wide, (front - back) * 0.6),
                (wide * 0.9, 0.4),
            )
        )


def _load(built: Builder, rng: np.random.Generator, ends: tuple[int | float, int | float], size: tuple) -> None:
    back, front = ends
    width, frame, high = size
    half = width / 2
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
        lean = rng.uniform(0, 0.15)
        built.pair(
            beam((half - 0.1, frame, (back + front) / 2), (half + lean, rim, (back + front) / 2), (0.08, front - back))
        )
        built.add(block((-half, frame, back), (half, rim - 0.05, back + 0.08)))


def tractor(rng: np.random.Generator) -> Mesh:
    """Return a tractor: a narrow bonnet, big wheels behind, a cab or a roll bar."""
    built = Builder()
    big, small = rng.uniform(0.65, 1.0), rng.uniform(0.35, 0.6)
    length = rng.uniform(2.6, 3.6)
    nose, half = length / 2, rng.uniform(0.3, 0.45)
    rear, front = -nose + big * 0.7, nose - small - rng.uniform(0.0, 0.3)
    waist, top = rng.uniform(1.15, 1.5), rng.uniform(2.2, 2.9)
    cowl = rear + rng.uniform(0.5, 0.9)
    low = small * 1.2
    drop = rng.uniform(0.02, 0.3)
    built.add(
        beam(
            (0, (low + waist) / 2, cowl - 0.1),
            (0, (low + waist - drop) / 2, nose),
            (2 * half, waist - low),
            (2 * half * 0.8, waist - drop - low),
            across="xy",
        )
    )
    built.add(block((-half * 0.8, low * 0.8, rear - 0.4), (half * 0.8, waist * 0.8, cowl)))
    track = rng.uniform(0.75, 1.0)
    tyre = big * rng.uniform(0.4, 0.6)
    built.pair(rod((track - tyre, big, rear), (track, big, rear), big, sides=20))
    built.pair(rod((track - tyre * 0.75, small, front), (track - 0.1, small, front), small, sides=16))
    built.add(rod((-track + 0.2, small, front), (track - 0.2, small, front), 0.08, sides=6))
    built.pair(block((half * 0.7, big * 1.5, rear - big * 0.8), (track, 2 * big + 0.1, rear + big * 0.6)))
    floor = min(waist, 1.1)
    wide = 2 * track * rng.uniform(0.7, 0.85)
    if rng.random() < 0.7:
        slopes = rng.uniform(0, 0.3), rng.uniform(0, 0.25)
        built.add(cabin(wide, (rear - 0.4, cowl + 0.15), (floor, top), slopes, rng.uniform(0.85, 1.0)))
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
