"""Occupancy from a surface that has no inside of its own: whatever a flood from outside does not reach."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

__all__ = ["flood_fill"]

_MOST_SAMPLES = 4_000_000


def flood_fill(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], resolution: int
) -> Bool[np.ndarray, "resolution resolution resolution"]:
    """Return the voxels on the surface and those it shuts off from the outside, indexed [z, y, x].

    Done on a grid twice as fine: a voxel counts where at least half of its eight parts do, so that an
    open sheet comes out about one voxel thick.
    """
    fine = 2 * resolution
    surface = np.zeros((fine + 2,) * 3, bool)
    samples = _samples((vertices[faces] + 1) * (fine / 2), 0.45)
    index = np.floor(samples).astype(np.int64)
    index = index[((index >= 0) & (index < fine)).all(1)] + 1
    surface[index[:, 2], index[:, 1], index[:, 0]] = True
    label, _ = ndimage.label(~surface)
    solid = (label != label[0, 0, 0])[1:-1, 1:-1, 1:-1]
    return solid.reshape((resolution, 2) * 3).sum((1, 3, 5)) >= 4


def _samples(corners: np.ndarray, spacing: float) -> np.ndarray:
    """Return points of triangles (triangles 3 3), at most about ``spacing`` apart."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2).max(1)
    steps = np.maximum(np.ceil(longest / spacing), 1).astype(np.int64)
    found = []
    for count in np.unique(steps):
        chosen = corners[steps == count]
        u, v = (grid.ravel() / count for grid in np.meshgrid(np.arange(count + 1), np.arange(count + 1)))
        inside = u + v <= 1 + 1e-9
        u, v = u[inside], v[inside]
        for part in np.array_split(chosen, max(1, len(chosen) * len(u) // _MOST_SAMPLES)):
            a, b, c = part[:, 0, None], part[:, 1, None], part[:, 2, None]
            found.append((a + u[:, None] * (b - a) + v[:, None] * (c - a)).reshape(-1, 3))
    return np.concatenate(found) if found else np.empty((0, 3))
