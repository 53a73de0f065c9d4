"""Occupancy grids of meshes: which voxels lie inside the union of a mesh's closed parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from uplift.geometry.mesh import Mesh

__all__ = ["coverage", "fill"]

# The connected parts of a mesh, each closed: holes are capped, and what cannot be closed is set apart.

_SHEET = 1e-3
"""A capped part whose volume is a smaller share of its area ** 1.5 is a sheet: it has no inside."""


@dataclass(frozen=True)
class _Parts:
    """Closed surfaces: `part` is the one that each face belongs to."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    part: Int[np.ndarray, " faces"]
    consistent: Bool[np.ndarray, " parts"]
    """Whether a part's triangles agree on what is outside."""


@dataclass(frozen=True)
class _Edges:
    """The edges of some faces, and how the triangles at each lie."""

    ends: np.ndarray
    """(edges 2), the lower vertex first."""
    part: np.ndarray
    count: np.ndarray
    balance: np.ndarray
    """How often an edge is gone along upwards rather than downwards: 0 where all is closed and agrees."""


def _closed_parts(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> tuple[_Parts, Int[np.ndarray, "loose 3"]]:
    """Return the closed parts of a mesh, and the faces that enclose nothing.

    Parts are found by shared vertices. What is not closed so is looked at again with vertices in the
    same place made one (files split them at seams); holes left then are capped by a fan about their middle.
    Triangles that are there twice, from both sides as many CAD files have them, count once: the two would cancel out.
    """
    faces = _once(faces)
    part, edges = _parts_of(faces, len(vertices))
    consistent = _all_of(edges.balance == 0, edges.part, part)
    closed = consistent | _all_of(edges.count % 2 == 0, edges.part, part)
    kept = closed[part]
    if kept.all():
        return _Parts(vertices, faces, part, consistent), faces[:0]
    vertices, capped, loose = _close(vertices, _joined(vertices, faces[~kept]))
    renumber = np.cumsum(closed) - 1
    both = _Parts(
        vertices,
        np.concatenate([faces[kept], capped.faces]),
        np.concatenate([renumber[part[kept]], capped.part + int(closed.sum())]),
        np.concatenate([consistent[closed], capped.consistent]),
    )
    return both, loose


def _once(faces: Int[np.ndarray, "faces 3"]) -> Int[np.ndarray, "some 3"]:
    """Return the first of the faces that have the same corners."""
    _, first = np.unique(np.sort(faces, 1), axis=0, return_index=True)
    return faces if len(first) == len(faces) else faces[np.sort(first)]


def _parts_of(faces: np.ndarray, vertices: int) -> tuple[np.ndarray, _Edges]:
    start, end = faces.ravel(), np.roll(faces, -1, 1).ravel()
    label = connected_components(coo_matrix((np.ones(len(start), bool), (start, end)), (vertices, vertices)), False)[1]
    part = np.unique(label[faces[:, 0]], return_inverse=True)[1].ravel()
    key = np.minimum(start, end) * vertices + np.maximum(start, end)
    keys, first, edge = np.unique(key, return_index=True, return_inverse=True)
    balance = np.bincount(edge.ravel(), np.sign(end - start), len(keys)).astype(np.int64)
    count = np.bincount(edge.ravel(), minlength=len(keys))
    return part, _Edges(np.stack([keys // vertices, keys % vertices], 1), part[first // 3], count, balance)


def _all_of(holds: np.ndarray, of: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return for each part whether something holds for all its edges."""
    return np.bincount(of[~holds], minlength=int(part.max(initial=-1)) + 1) == 0


def _joined(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the faces with vertices in the same place made one; those without area are left out."""
    used = np.unique(faces)
    size = max(float(np.ptp(vertices[used], axis=0).max()), 1e-12)
    places = np.round(vertices[used] / size, 6)
    _, first, same = np.unique(places, axis=0, return_index=True, return_inverse=True)
    joined = used[first[same.ravel()]][np.searchsorted(used, faces)]
    return joined[(joined != np.roll(joined, 1, 1)).all(1)]


def _close(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, _Parts, np.ndarray]:
    """Cap the holes of the parts whose triangles agree; return vertices, closed parts and the faces of the others."""
    faces, part, edges, agrees = _turned_alike(vertices, faces)
    even = _all_of(edges.count % 2 == 0, edges.part, part)
    vertices, fans, fan_part = _fans(vertices, edges, agrees)
    all_faces, all_part = np.concatenate([faces, fans]), np.concatenate([part, fan_part])
    a, b, c = (vertices[all_faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    count = len(agrees)
    volume = np.bincount(all_part, (a * cross).sum(1) / 6, count)
    area = np.bincount(all_part, np.linalg.norm(cross, axis=1) / 2, count)
    solid = agrees & (np.abs(volume) > _SHEET * area**1.5)
    closed = solid | (even & ~agrees)
    kept, renumber = closed[all_part], np.cumsum(closed) - 1
    parts = _Parts(vertices, all_faces[kept], renumber[all_part[kept]], agrees[closed])
    return vertices, parts, faces[~closed[part]]


def _turned_alike(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, _Edges, np.ndarray]:
    """Return the faces, with those turned over that disagree with their neighbours; their parts, edges, and which agree."""
    import trimesh  # keypoints need no meshes

    for repaired in (False, True):
        part, edges = _parts_of(faces, len(vertices))
        # Two triangles that go along their edge the same way disagree: one of them is inside out.
        agrees = _all_of(np.abs(edges.balance) == edges.count % 2, edges.part, part)
        wrong = ~agrees[part]
        if repaired or not wrong.any():
            break
        fixed = trimesh.Trimesh(vertices, faces[wrong], process=False)
        trimesh.repair.fix_winding(fixed)
        faces = faces.copy()
        faces[wrong] = fixed.faces
    return faces, part, edges, agrees


def _fans(vertices: np.ndarray, edges: _Edges, agrees: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices with the middles of holes, and the triangles that cap them, with their parts."""
    open_ones = (edges.balance != 0) & agrees[edges.part]
    ends, balance = edges.ends[open_ones], edges.balance[open_ones]
    if not len(ends):
        return vertices, np.empty((0, 3), np.int64), np.empty(0, np.int64)
    rim, local = np.unique(ends, return_inverse=True)
    local = local.reshape(-1, 2)
    links = coo_matrix((np.ones(len(local), bool), (local[:, 0], local[:, 1])), (len(rim), len(rim)))
    holes, hole = connected_components(links, False)
    sizes = np.bincount(hole, minlength=holes)
    middles = np.stack([np.bincount(hole, vertices[rim, axis], holes) / sizes for axis in range(3)], 1)
    apex = len(vertices) + hole[local[:, 0]]
    low, high = ends[:, 0], ends[:, 1]
    up = balance > 0  # gone along upwards by a triangle: the cap goes back downwards
    fans = np.stack([np.where(up, high, low), np.where(up, low, high), apex], 1)
    return np.concatenate([vertices, middles]), fans, edges.part[open_ones]


_MOST_SAMPLES = 4_000_000


def _flood_fill(
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
    label = np.empty(surface.shape, np.int32)
    ndimage.label(~surface, output=label)
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


_NUDGE = (1.7e-7, 2.9e-7, 2.3e-7)
"""Samples lie beside the voxels' centres by a hair: synthetic edges often lie exactly on them."""


def fill(mesh: Mesh, resolution: int) -> Bool[np.ndarray, "resolution resolution resolution"]:
    """Return which voxel centres of the cube -1..1 of the shape's frame are inside, indexed [z, y, x].

    Each closed part on its own (its winding number is not 0; where its triangles disagree on what is
    outside: an odd number of crossings), then their union. Holes in a part are closed first; what has no
    inside for all that is filled from its surface (`uplift.geometry.mesh`).
    """
    parts, loose = _closed_parts(mesh.vertices, mesh.faces)
    inside = _fill_closed(parts, resolution)
    if len(loose):
        inside |= _flood_fill(mesh.vertices, loose, resolution)
    return inside


def coverage(mesh: Mesh, resolution: int, finer: int = 2) -> Float[np.ndarray, "resolution resolution resolution"]:
    """Return how much of each voxel is inside, 0..1: the mean of ``finer`` x ``finer`` x ``finer`` samples."""
    fine = fill(mesh, resolution * finer).reshape((resolution, finer) * 3)
    return fine.mean((1, 3, 5), dtype=np.float32)


def _fill_closed(parts: _Parts, resolution: int) -> np.ndarray:
    """Cast a ray along z through each column of voxels, and fill between where it enters and leaves a part."""
    ray, face, depth, sign = _crossings(parts.vertices, parts.faces, resolution)
    change = np.zeros((resolution + 1, resolution**2), np.int32)
    if len(ray):
        group = ray * len(parts.consistent) + parts.part[face]
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
    at = (vertices + _NUDGE + 1) * (resolution / 2) - 0.5  # voxel centres at whole numbers of x and y
    corners = at[faces]
    flat = corners[..., :2]
    low = np.clip(np.ceil(flat.min(1)), 0, resolution).astype(np.int64)
    extent = np.maximum(np.clip(np.floor(flat.max(1)) + 1, 0, resolution).astype(np.int64) - low, 0)
    count = extent.prod(1)
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
