"""Rays of a mask that a shape does not reach: where along them it most likely is."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from scipy import ndimage

from uplift.geometry.silhouette import project

__all__ = ["rays_reached"]

_LEAST = 0.02
"""Of the level: a ray whose occupancy is lower everywhere stays empty."""
_RAISED = 1.1
"""Of the level: what the occupancy is raised to."""
_NEAR = 1.0
"""Voxels: how far the occupancy is averaged, so that neighbouring rays choose the same depth."""


def rays_reached(
    occupancy: Float[np.ndarray, "depth height width"],
    level: int | float,
    mask: UInt8[np.ndarray, "side side"],
    view: Float[np.ndarray, "3 3"],
    scale: int | float | np.floating,
    offset: Float[np.ndarray, "2"],
    distance: int | float | np.floating,
) -> Float[np.ndarray, "depth height width"]:
    """Return the occupancy, raised above ``level`` where it is highest along each ray that the mask covers and it does not.

    Rays are those of pixels as wide as a voxel. ``mask`` is 0 to 255 over the crop; ``view``, ``scale``, ``offset``
    and ``distance`` are as in `uplift.data.masks.Placed`. A grid that is its own mirror image (x to -x) stays so.
    """
    voxels = len(occupancy)
    line = (2 * np.arange(voxels) + 1) / voxels - 1
    z, y, x = np.meshgrid(line, line, line, indexing="ij")
    points = np.stack([x, y, z], -1).reshape(-1, 3) @ (scale * np.asarray(view, float)).T + np.append(offset, 0.0)
    side = max(1, round(voxels / float(scale)))
    flat = np.floor((project(points, distance) + 1) * (side / 2)).astype(int)
    here = ((flat >= 0) & (flat < side)).all(1)
    pixel = np.where(here, flat[:, 1] * side + flat[:, 0], side * side)
    inside = (occupancy > level).reshape(-1)
    covered = np.zeros(side * side + 1, bool)
    covered[pixel[inside]] = True
    reached = ndimage.binary_dilation(covered[:-1].reshape(side, side), np.ones((3, 3)))
    wanted = ndimage.zoom(mask / 255.0, side / len(mask), order=1, grid_mode=True, mode="nearest") > 0.5
    open_rays = np.append((wanted & ~reached).reshape(-1), False)[pixel]
    if not open_rays.any():
        return occupancy
    near = ndimage.gaussian_filter(occupancy, _NEAR).reshape(-1)
    rows = np.flatnonzero(open_rays)
    rows = rows[np.lexsort((-near[rows], pixel[rows]))]
    best = rows[np.unique(pixel[rows], return_index=True)[1]]
    best = best[near[best] > _LEAST * level]
    raised = occupancy.copy().reshape(-1)
    raised[best] = np.maximum(raised[best], min(_RAISED * level, (1 + level) / 2))
    raised = raised.reshape(occupancy.shape)
    mirror = np.abs(occupancy - occupancy[:, :, ::-1]).max() < 1e-3
    return np.maximum(raised, raised[:, :, ::-1]) if mirror else raised
