"""The connected parts of a mesh, each closed: holes are capped, and what cannot be closed is told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

__all__ = ["Parts", "closed_parts"]

_SHEET = 1e-3
"""A capped part whose volume is a smaller share of its area ** 1.5 is a sheet: it has no inside."""


@dataclass(frozen=True)
class Parts:
    """Closed surfaces: `part` says to which each face belongs."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    part: Int[np.ndarray, " faces"]
    consistent: Bool[np.ndarray, " parts"]
    """Whether a part's triangles agree on what is outside."""

    @property
    def count(self) -> int:
        """How many parts there are."""
        return len(self.consistent)


@dataclass(frozen=True)
class _Edges:
    """The edges of some faces, and how the triangles at each lie."""

    ends: np.ndarray
    """(edges 2), the lower vertex first."""
    part: np.ndarray
    count: np.ndarray
    balance: np.ndarray
    """How often an edge is gone along upwards rather than downwards: 0 where all is closed and agrees."""


def closed_parts(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> tuple[Parts, Int[np.ndarray, "loose 3"]]:
    """Return the closed parts of a mesh, and the faces that enclose nothing.

    Parts are told apart by shared vertices. What is not closed so is looked at again with vertices in the
    same place made one (files split them at seams); holes left then are capped by a fan about their middle.
    """
    part, edges = _parts_of(faces, len(vertices))
    consistent = _all_of(edges.balance == 0, edges.part, part)
    whole = consistent | _all_of(edges.count % 2 == 0, edges.part, part)
    kept = whole[part]
    if kept.all():
        return Parts(vertices, faces, part, consistent), faces[:0]
    vertices, capped, loose = _close(vertices, _joined(vertices, faces[~kept]))
    renumber = np.cumsum(whole) - 1
    both = Parts(
        vertices,
        np.concatenate([faces[kept], capped.faces]),
        np.concatenate([renumber[part[kept]], capped.part + int(whole.sum())]),
        np.concatenate([consistent[whole], capped.consistent]),
    )
    return both, loose


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


def _close(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, Parts, np.ndarray]:
    """Cap the holes of the parts whose triangles agree; return vertices, closed parts and the faces of the others."""
    part, edges = _parts_of(faces, len(vertices))
    # Both triangles of an edge gone along the same way: they disagree, and nothing says which is wrong.
    agrees = _all_of(np.abs(edges.balance) == edges.count % 2, edges.part, part)
    even = _all_of(edges.count % 2 == 0, edges.part, part)
    vertices, fans, fan_part = _fans(vertices, edges, agrees)
    all_faces, all_part = np.concatenate([faces, fans]), np.concatenate([part, fan_part])
    a, b, c = (vertices[all_faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    count = len(agrees)
    volume = np.bincount(all_part, (a * cross).sum(1) / 6, count)
    area = np.bincount(all_part, np.linalg.norm(cross, axis=1) / 2, count)
    solid = agrees & (np.abs(volume) > _SHEET * area**1.5)
    whole = solid | (even & ~agrees)
    kept, renumber = whole[all_part], np.cumsum(whole) - 1
    parts = Parts(vertices, all_faces[kept], renumber[all_part[kept]], agrees[whole])
    return vertices, parts, faces[~whole[part]]


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
