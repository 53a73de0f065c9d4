"""Which points of a body are its legs, and in what order they step."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from uplift.simulator.body import Body, rest_positions

__all__ = ["find_legs", "leg_phases"]


def find_legs(body: Body) -> list[list[int]]:
    """Return legs as chains of points from hip to foot: limbs whose ends rest near the floor."""
    rest = rest_positions(body.parents, body.offsets)
    height = np.ptp(rest[:, 1]) or 1.0
    legs = []
    for point in range(len(body.points)):
        if (body.parents == point).any() or rest[point, 1] < rest[:, 1].max() - 0.15 * height:
            continue
        leg = [point]
        while (parent := int(body.parents[leg[0]])) > 0 and abs(rest[parent, 0]) > 1e-6:
            leg.insert(0, parent)
        if len(leg) > 1 and rest[point, 1] - rest[leg[0], 1] > 0.2 * height:
            legs.append(leg)
    return legs


def leg_phases(body: Body, legs: list[list[int]], gait: str) -> Float[np.ndarray, " legs"]:
    """Return each leg's place in the cycle: left and right opposed, rows opposed (trot, tripod) or a quarter behind.

    Walk is the lateral sequence, hind foot before fore foot of one side; trot moves diagonal pairs
    (Hildebrand 1965, Science 150); alternating rows give insects their tripod gait.
    """
    rest = rest_positions(body.parents, body.offsets)
    hips = np.array([rest[leg[0]] for leg in legs])
    rows = np.unique(np.round(hips[:, 2] / (np.ptp(rest, 0).max() * 0.1 + 1e-9)), return_inverse=True)[1]
    lag = 0.25 if gait == "walk" and rows.max() == 1 else 0.5
    return 0.5 * (hips[:, 0] < 0) + lag * (rows.max() - rows)
