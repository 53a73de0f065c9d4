"""Where a body is: the place of its root in front of a camera whose focal length is known."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

__all__ = ["place_roots"]

_LEAST_JOINTS = 3


def place_roots(
    pose: Float[np.ndarray, "frames joints 3"],
    rays: Float[np.ndarray, "frames joints 2"],
    confidence: Float[np.ndarray, "frames joints"],
) -> Float[np.ndarray, "frames 3"]:
    """Return the root's place for which each pose projects onto its keypoints best, in the pose's unit.

    ``rays`` are keypoints as x/z and y/z of the camera frame. For a pose of known size the two
    equations of each joint, x + X = ray (z + Z), are linear in the place (X, Y, Z); they are solved
    by least squares, weighted by confidence. NaN where fewer than three joints are seen.
    """
    known = np.isfinite(pose).all(-1) & np.isfinite(rays).all(-1) & (confidence > 0)
    weight = np.where(known, confidence, 0).astype(np.float64)
    ray, pose = np.where(known[..., None], rays, 0.0), np.where(known[..., None], pose, 0.0)
    # The normal equations of [1 0 -rx; 0 1 -ry] (X Y Z) = ray z - xy.
    right = ray * pose[..., 2:] - pose[..., :2]
    total = weight.sum(1)
    across = -(weight[..., None] * ray).sum(1)
    square = (weight * (ray**2).sum(-1)).sum(1)
    matrix = np.zeros((len(pose), 3, 3))
    matrix[:, 0, 0] = matrix[:, 1, 1] = total
    matrix[:, 0, 2] = matrix[:, 2, 0] = across[:, 0]
    matrix[:, 1, 2] = matrix[:, 2, 1] = across[:, 1]
    matrix[:, 2, 2] = square
    flat = (weight[..., None] * right).sum(1)
    vector = np.concatenate([flat, -(weight * (ray * right).sum(-1)).sum(1)[:, None]], 1)
    place = np.full((len(pose), 3), np.nan)
    spread = square - (across**2).sum(1) / np.maximum(total, 1e-12)  # 0 where all are seen in one point
    solvable = (known.sum(1) >= _LEAST_JOINTS) & (spread > 1e-12 * np.maximum(total, 1e-12))
    place[solvable] = np.linalg.solve(matrix[solvable], vector[solvable][..., None])[..., 0]
    return place
