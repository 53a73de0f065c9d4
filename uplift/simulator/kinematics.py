"""Forward kinematics: joint angles to positions."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from uplift.simulator.body import Body

__all__ = ["forward_kinematics", "rotation_about"]


def rotation_about(
    axis: tuple[float, float, float] | Float[np.ndarray, " 3"], angle_rad: Float[np.ndarray, "*frames"]
) -> Float[np.ndarray, "*frames 3 3"]:
    """Return the rotation matrices about a unit axis (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=angle_rad.dtype)
    sine, cosine = np.sin(angle_rad)[..., None, None], np.cos(angle_rad)[..., None, None]
    return np.eye(3, dtype=angle_rad.dtype) + sine * cross + (1 - cosine) * (cross @ cross)


def forward_kinematics(
    body: Body, offsets: Float[np.ndarray, "frames points 3"], angles_deg: Float[np.ndarray, "frames angles"]
) -> Float[np.ndarray, "frames points 3"]:
    """Return the points of a posed body in its rest frame, root at the origin."""
    angles = np.radians(angles_deg)
    steps: dict[int, list] = {}
    for point, angle, axis in body.steps:
        steps.setdefault(point, []).append((angle, axis))
    positions = np.zeros_like(offsets)
    turned: dict[int, np.ndarray] = {}
    for point, parent in enumerate(body.parents):
        rotation = turned.get(int(parent))
        if parent >= 0:
            offset = offsets[:, point]
            step = offset if rotation is None else np.einsum("fij,fj->fi", rotation, offset)
            positions[:, point] = positions[:, parent] + step
        for angle, axis in steps.get(point, ()):
            local = rotation_about(axis, angles[:, angle])
            rotation = local if rotation is None else rotation @ local
        if rotation is not None:
            turned[point] = rotation
    return positions
