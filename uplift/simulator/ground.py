"""Put posed bodies on the floor of a stage."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from uplift.simulator.body import Body, rest_positions
from uplift.simulator.kinematics import rotation_about
from uplift.simulator.legs import find_legs

__all__ = ["level_feet", "on_floor", "on_stage"]

_STAGE = 2.0
"""Body heights that a clip's way over the floor spans at most: the volume of a capture studio."""


def on_floor(
    points: Float[np.ndarray, "clips frames points 3"], lift: Float[np.ndarray, "clips frames"]
) -> Float[np.ndarray, "clips frames points 3"]:
    """Return the points moved up or down: y of the lowest is ``-lift``, that of the floor 0."""
    lowest = points[..., 1].max(-1) + lift
    return points - lowest[..., None, None] * np.array([0.0, 1.0, 0.0])


def on_stage(travel: Float[np.ndarray, "clips frames 2"]) -> Float[np.ndarray, "clips frames 2"]:
    """Shrink ways that leave the stage, as on a treadmill."""
    way = np.ptp(travel, axis=1).max(-1)
    return travel * (_STAGE / np.maximum(way, _STAGE))[:, None, None]


def level_feet(
    body: Body, points: Float[np.ndarray, "clips frames points 3"]
) -> Float[np.ndarray, "clips frames points 3"]:
    """Pitch bodies on four or more legs so that the lowest fore and the lowest hind foot are at one height."""
    legs = find_legs(body)
    rest = rest_positions(body.parents, body.offsets)
    hips = np.array([rest[leg[0], 2] for leg in legs])
    if not len(hips) or np.ptp(hips) < 0.3 * np.ptp(rest, axis=0).max():
        return points
    share = (hips - hips.min()) / np.ptp(hips)
    fore, hind = ([legs[row][-1] for row in np.flatnonzero(rows)] for rows in (share < 0.3, share > 0.7))
    lowest = [points[..., feet, 1].max(-1) for feet in (fore, hind)]
    way = points[..., fore, :].mean(-2) - points[..., hind, :].mean(-2)
    length = np.linalg.norm(way[..., [0, 2]], axis=-1)
    angle = np.arctan2(lowest[0] - lowest[1], np.maximum(length, 1e-6)).clip(-0.35, 0.35)
    heading = np.arctan2(way[..., 0], way[..., 2])
    aside = rotation_about((0.0, 1.0, 0.0), heading)
    turn = aside @ rotation_about((1.0, 0.0, 0.0), angle) @ np.swapaxes(aside, -1, -2)
    return np.einsum("ctij,ctpj->ctpi", turn, points)
