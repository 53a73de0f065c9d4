"""Made-up cars, vans and pick-ups; lengths in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uplift.meshes.mesh import Mesh
from uplift.meshes.procedural.bodywork import add_wheels, cabin, hull
from uplift.meshes.procedural.building import Builder, Part
from uplift.meshes.procedural.parts import beam, block

__all__ = ["car", "pickup", "van"]


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

    @property
    def nose(self) -> float:
        """The foremost z."""
        return self.length / 2


_STYLES = ("hatchback", "saloon", "estate", "coupe", "suv")
_STYLE_WEIGHTS = (0.28, 0.25, 0.17, 0.12, 0.18)


def car(rng: np.random.Generator) -> Mesh:
    """Return a car: hatchback, saloon, estate, coupe or a tall one for rough roads."""
    style = str(rng.choice(_STYLES, p=_STYLE_WEIGHTS))
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
    built = Builder()
    end = body.belt - rng.uniform(0.0, 0.1)
    built.add(_car_hull(rng, body, cowl, end))
    rise = body.roof - body.belt
    back_slope = {"hatchback": (0.4, 1.0), "estate": (0.1, 0.6), "suv": (0.1, 0.5)}.get(style, (1.0, 1.9))
    slopes = rise * rng.uniform(0.9, 1.9), min(rise * rng.uniform(*back_slope), (cowl - tail) * 0.45)
    built.add(cabin(body.width * 0.93, (tail, cowl), (body.belt - 0.06, body.roof), slopes, rng.uniform(0.74, 0.9)))
    add_wheels(built, rng, body.width, body.wheel, _axles(rng, body))
    _trim(built, rng, body, cowl, (tail + slopes[1], cowl - slopes[0]))
    return built.mesh(style)


def van(rng: np.random.Generator) -> Mesh:
    """Return a van or a minibus: a short bonnet and one long, high body."""
    body = _Body(
        rng.uniform(4.3, 6.2), rng.uniform(1.75, 2.1), rng.uniform(0.2, 0.35), rng.uniform(0.85, 1.1),
        rng.uniform(1.05, 1.3), rng.uniform(1.85, 2.7), rng.uniform(0.3, 0.38),
    )  # fmt: skip
    built = Builder()
    cowl = body.nose - rng.uniform(0.35, 0.95)
    built.add(_car_hull(rng, body, cowl, body.belt))
    rise = body.roof - body.belt
    slopes = min(rise, 1.0) * rng.uniform(0.5, 1.1), rise * rng.uniform(0.02, 0.15)
    built.add(
        cabin(
            body.width * 0.97, (-body.nose + 0.03, cowl), (body.belt - 0.06, body.roof), slopes, rng.uniform(0.82, 0.96)
        )
    )
    add_wheels(built, rng, body.width, body.wheel, _axles(rng, body))
    _trim(built, rng, body, cowl, (-body.nose + 0.5, cowl - slopes[0]))
    return built.mesh("van")


def pickup(rng: np.random.Generator) -> Mesh:
    """Return a pick-up: a cabin in the middle and an open bed behind."""
    body = _Body(
        rng.uniform(4.7, 5.8), rng.uniform(1.7, 2.05), rng.uniform(0.3, 0.5), rng.uniform(0.85, 1.1),
        rng.uniform(1.08, 1.25), rng.uniform(1.65, 1.95), rng.uniform(0.34, 0.45),
    )  # fmt: skip
    built = Builder()
    cowl = body.nose - body.length * rng.uniform(0.22, 0.29)
    tail = cowl - body.length * rng.uniform(0.28, 0.42)
    bed = body.floor + rng.uniform(0.25, 0.4)
    front = _Body(body.nose - tail, body.width, body.floor, body.bonnet, body.belt, body.roof, body.wheel)
    shift = (0, 0, body.nose - front.nose)
    hood = _car_hull(rng, front, cowl - shift[2], body.belt)
    built.add(Part(hood.vertices + shift, hood.faces))
    rise = body.roof - body.belt
    slopes = rise * rng.uniform(0.7, 1.3), rise * rng.uniform(0.05, 0.3)
    built.add(cabin(body.width * 0.93, (tail, cowl), (body.belt - 0.06, body.roof), slopes, rng.uniform(0.78, 0.9)))
    half, rim = body.width / 2 * 0.97, body.belt - rng.uniform(0.0, 0.15)
    built.add(block((-half, body.floor, -body.nose), (half, bed, tail + 0.05)))
    built.pair(block((half - 0.07, bed - 0.01, -body.nose), (half, rim, tail + 0.05)))
    built.add(block((-half, bed - 0.01, -body.nose), (half, rim, -body.nose + 0.07)))
    add_wheels(built, rng, body.width, body.wheel, _axles(rng, body))
    _trim(built, rng, body, cowl, (tail, cowl - slopes[0]))
    return built.mesh("pickup")


def _axles(rng: np.random.Generator, body: _Body) -> tuple[int | float, int | float]:
    return (
        body.nose - body.wheel - body.length * rng.uniform(0.07, 0.12),
        -body.nose + body.wheel + body.length * rng.uniform(0.07, 0.14),
    )


def _car_hull(rng: np.random.Generator, body: _Body, cowl: int | float, end: int | float) -> Part:
    """Return the lower body: bumper, bonnet up to the windscreen's foot, belt, tail."""
    nose, half, low = body.nose, body.width / 2, body.floor
    bumper = low + (body.bonnet - low) * rng.uniform(0.55, 0.8)
    ends = rng.uniform(0.78, 0.92)
    inset = rng.uniform(0.84, 0.95)
    return hull(
        np.array([
            (-nose, low + 0.12, low + (end - low) * rng.uniform(0.6, 0.95), half * ends, inset),
            (-nose + 0.15, low + 0.03, end, half * 0.96, inset),
            (-nose * 0.5, low, body.belt, half, inset),
            (cowl, low, body.belt, half, inset),
            (nose - 0.3, low, body.bonnet, half * 0.97, inset),
            (nose - 0.08, low, (body.bonnet + bumper) / 2, half * (ends + 0.06), inset),
            (nose, low + 0.08, bumper, half * ends * 0.93, inset),
        ])
    )  # fmt: skip


def _trim(
    built: Builder, rng: np.random.Generator, body: _Body, cowl: int | float, roof: tuple[int | float, int | float]
) -> None:
    """Add mirrors, and sometimes bars on the roof or a spoiler."""
    half, y, z = body.width / 2, body.belt + 0.05, cowl - rng.uniform(0.35, 0.6)
    size = rng.uniform(0.1, 0.2)
    built.pair(
        beam((half * 0.85, y, z), (half + size, y + 0.03, z - 0.03), (0.04, 0.05), (size * 0.8, 0.09), across="yz")
    )
    if rng.random() < 0.2:
        x = half * 0.66
        built.pair(beam((x, body.roof + 0.04, roof[0]), (x, body.roof + 0.04, roof[1]), (0.04, 0.05), across="xy"))
        for z in roof:
            built.pair(block((x - 0.02, body.roof - 0.1, z - 0.04), (x + 0.02, body.roof + 0.05, z + 0.04)))
    elif rng.random() < 0.12:
        y, z = max(body.belt + 0.18, body.roof - 0.35), -body.nose + 0.15
        built.add(block((-half * 0.8, y, z - 0.12), (half * 0.8, y + 0.03, z + 0.12)))
        built.pair(block((half * 0.6, body.belt * 0.8, z - 0.04), (half * 0.63, y + 0.01, z + 0.06)))
