"""What made-up vehicles have in common: hull, cabin, wheels."""

from __future__ import annotations

import numpy as np

from uplift.meshes.procedural.building import Builder, Part
from uplift.meshes.procedural.parts import loft, rod

__all__ = ["add_wheels", "cabin", "hull"]


def hull(stations: np.ndarray) -> Part:
    """Return a body through sections of z, low, high, half width and how much narrower it is at its top."""
    z, low, high, half, inset = np.asarray(stations, float).T
    x = np.stack([half * 0.9, half, half, half * inset], 1)
    y = np.stack([low, low + 0.3 * (high - low), low + 0.75 * (high - low), high], 1)
    rings = np.empty((len(z), 8, 3))
    rings[..., 0] = np.concatenate([x, -x[:, ::-1]], 1)
    rings[..., 1] = np.concatenate([y, y[:, ::-1]], 1)
    rings[..., 2] = z[:, None]
    return loft(rings)


def cabin(
    width: int | float,
    ends: tuple[int | float, int | float],
    heights: tuple[int | float, int | float],
    slopes: tuple[int | float, int | float],
    narrow: float,
) -> Part:
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


def add_wheels(
    built: Builder,
    rng: np.random.Generator,
    width: int | float,
    radius: int | float,
    axles: tuple[int | float, ...],
    share: int | float = 1.0,
) -> None:
    """Add a wheel at either side of each axle; ``share`` of the body's width is the track's outer edge."""
    tyre, out = rng.uniform(0.5, 0.75) * radius, width / 2 * share + rng.uniform(-0.01, 0.04)
    for z in axles:
        built.pair(rod((out - tyre, radius, z), (out, radius, z), radius, sides=16))
