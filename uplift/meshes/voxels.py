"""Occupancy grids of meshes: which voxels lie inside the union of a mesh's closed parts."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from uplift.meshes.closing import Parts, closed_parts
from uplift.meshes.flooding import flood_fill
from uplift.meshes.mesh import Mesh

__all__ = ["coverage", "fill"]

_NUDGE = (1.7e-7, 2.9e-7)
"""Rays pass beside the voxels' centres by a hair: made-up edges often lie exactly on them."""


def fill(mesh: Mesh, resolution: int) -> Bool[np.ndarray, "resolution resolution resolution"]:
    """Return which voxel centres of the cube -1..1 of the own frame are inside, indexed [z, y, x].

    Each closed part on its own (its winding number is not 0; where its triangles disagree on what is
    outside: an odd number of crossings), then their union. Holes in a part are closed first; what has no
    inside for all that is filled from its surface (`uplift.meshes.flooding`).
    """
    parts, loose = closed_parts(mesh.vertices, mesh.faces)
    inside = _fill_closed(parts, resolution)
    if len(loose):
        inside |= flood_fill(mesh.vertices, loose, resolution)
    return inside


def coverage(mesh: Mesh, resolution: int, finer: int = 2) -> Float[np.ndarray, "resolution resolution resolution"]:
    """Return how much of each voxel is inside, 0..1: the mean of ``finer`` x ``finer`` x ``finer`` samples."""
    fine = fill(mesh, resolution * finer)
    shape = (resolution, finer) * 3
    return fine.reshape(shape).mean((1, 3, 5), dtype=np.float32)


def _fill_closed(parts: Parts, resolution: int) -> np.ndarray:
    """Cast a ray along z through each column of voxels, and fill between where it enters and leaves a part."""
    ray, face, depth, sign = _crossings(parts.vertices, parts.faces, resolution)
    change = np.zeros((resolution + 1, resolution**2), np.int32)
    if len(ray):
        group = ray * parts.count + parts.part[face]
        order = np.lexsort((depth, group))
        group, depth, sign, ray = group[order], depth[order], sign[order], ray[order]
        first = np.concatenate([[True], group[1:] != group[:-1]])
        winding = _running(sign, first)
        crossed = _running(np.ones_like(sign), first)
        inside = np.where(parts.consistent[parts.part[face[order]]], winding != 0, crossed % 2 != 0)
        before = np.concatenate([[False], inside[:-1]]) & ~first
        # A voxel is inside from the first centre behind where the ray enters.
        index = np.clip(np.ceil((depth + 1) * resolution / 2 - 0.5), 0, resolution).astype(np.int64)
        np.add.at(change, (index, ray), inside.astype(np.int32) - before.astype(np.int32))
    return (np.cumsum(change[:-1], 0) > 0).reshape(resolution, resolution, resolution)


def _running(values: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Return sums so far, begun anew at each ``first``."""
    total = np.cumsum(values)
    starts = np.flatnonzero(first)
    return total - np.repeat(total[starts] - values[starts], np.diff(np.append(starts, len(values))))


def _crossings(
    vertices: np.ndarray, faces: np.ndarray, resolution: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return ray (y R + x), face, z and direction of each crossing of the voxels' rays with the triangles."""
    at = (vertices + (*_NUDGE, 0) + 1) * (resolution / 2) - 0.5  # voxel centres at whole numbers of x and y
    corners = at[faces]
    flat = corners[..., :2]
    low = np.clip(np.ceil(flat.min(1)), 0, resolution).astype(np.int64)
    extent = np.clip(np.floor(flat.max(1)) + 1, 0, resolution).astype(np.int64) - low
    extent = np.maximum(extent, 0)
    count = extent[:, 0] * extent[:, 1]
    face = np.repeat(np.arange(len(faces)), count)
    place = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    x, y = low[face, 0] + place % extent[face, 0], low[face, 1] + place // extent[face, 0]
    shares = np.stack([_edge(at, faces[:, [k, (k + 1) % 3]], face, x, y) for k in (1, 2, 0)], 1)
    hit = (shares > 0).all(1) | (shares < 0).all(1)
    shares, face, x, y = shares[hit], face[hit], x[hit], y[hit]
    z = (shares * corners[face, :, 2]).sum(1) / shares.sum(1)
    return y * resolution + x, face, (z + 0.5) * 2 / resolution - 1, np.sign(shares[:, 0]).astype(np.int64)


def _edge(at: np.ndarray, edge: np.ndarray, face: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return on which side of an edge each ray passes: the two triangles of an edge get exactly opposite values."""
    turned = edge[:, 0] > edge[:, 1]
    start, end = at[edge.min(1)][face], at[edge.max(1)][face]
    side = (end[:, 0] - start[:, 0]) * (y - start[:, 1]) - (end[:, 1] - start[:, 1]) * (x - start[:, 0])
    side = np.where(side == 0, 1e-300, side)
    return np.where(turned[face], -side, side)
