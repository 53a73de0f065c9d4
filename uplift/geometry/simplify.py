"""Meshes with fewer triangles, to look at: closed ones stay closed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from uplift.geometry.mesh import Mesh

__all__ = ["thinned"]


def thinned(mesh: Mesh, faces: int) -> Mesh:
    """Return a mesh of at most ``faces`` triangles; the same mesh where it has no more.

    A closed mesh stays closed, and keeps its parts and holes: edges shrink to points, the flattest first (Garland and
    Heckbert 1997). It may keep more triangles where fewer would not be closed. Of any other mesh, corners that share
    a cell become one.
    """
    if len(mesh.faces) <= faces:
        return mesh
    return _shrunk(mesh, faces) if _is_closed(mesh.faces) else _clustered(mesh, faces)


def _is_closed(faces: Int[np.ndarray, "faces 3"]) -> bool:
    """Return whether each edge runs once each way."""
    there = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    codes, back = (np.sort(pairs @ [len(faces) * 3 + faces.max() + 1, 1]) for pairs in (there, there[:, ::-1]))
    return bool((codes == back).all() and (np.diff(codes) > 0).all())


# Closed meshes: rounds of edges that shrink at a time, each too far from the others to meddle with them.

_ROUNDS = 300
_SHORT = 1e-3
"""What an edge's length adds to its cost: on flat parts short edges go first, and triangles stay round."""
_STAY = 1e-3
"""Weight of an edge's middle against the planes around it, where these do not tell a point."""
_TURN = 0.2
"""Least cosine between a triangle's normals before and after: it must not fold over."""
_AGAIN = 4.0
"""What an edge's cost grows by each time that it would have folded a triangle over: others get their turn."""


def _shrunk(mesh: Mesh, faces: int) -> Mesh:
    points, left = np.array(mesh.vertices, float), np.asarray(mesh.faces)
    size = max(float(np.ptp(points, axis=0).max()), 1e-12)
    points /= size  # costs compare lengths with areas
    planes, tried = _planes(points, left), np.zeros(len(points))
    for _ in range(_ROUNDS):
        if len(left) <= faces:
            break
        edges = _shrinkable(left, len(points))
        place, cost = _places(points, planes, edges)
        chosen = _apart(left, edges, cost * _AGAIN ** np.minimum(tried[edges].sum(1), 50), len(points))
        fine = _unfolded(points, left, edges[chosen], place[chosen])
        tried[edges[chosen[~fine]]] += 1
        chosen = chosen[fine]
        first, second = edges[chosen[: (len(left) - faces + 1) // 2]].T  # each takes two triangles away
        points[first] = place[chosen[: len(first)]]
        planes[first] += planes[second]
        to = np.arange(len(points))
        to[second] = first
        left = to[left]
        left = left[(left[:, 0] != left[:, 1]) & (left[:, 1] != left[:, 2]) & (left[:, 2] != left[:, 0])]
    used, numbers = np.unique(left, return_inverse=True)
    return replace(mesh, vertices=points[used] * size, faces=numbers.reshape(-1, 3))


def _planes(points: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, "vertices 4 4"]:
    """Return the quadric of each corner: its form at (x, y, z, 1) is the squared distance from the planes around it."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(area, 1e-30)[:, None]
    plane = np.concatenate([normal, -(normal * a).sum(1, keepdims=True)], 1)
    of_face = area[:, None, None] * plane[:, :, None] * plane[:, None, :]
    found = np.zeros((len(points), 4, 4))
    for k in range(3):
        np.add.at(found, faces[:, k], of_face)
    return found


def _shrinkable(faces: np.ndarray, corners: int) -> Int[np.ndarray, "edges 2"]:
    """Return the edges that may shrink: their ends share two neighbours alone, so no handle or hole closes."""
    pairs = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    near = csr_array((np.ones(len(pairs), np.int32), pairs.T), shape=(corners, corners))
    edges = pairs[pairs[:, 0] < pairs[:, 1]]
    common = (near[edges[:, 0]] * near[edges[:, 1]]).sum(1)
    valence = np.bincount(pairs[:, 0], minlength=corners)
    return edges[(common == 2) & (valence[edges].min(1) > 3)]


def _places(points: np.ndarray, planes: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where each edge would shrink to, nearest to the planes around it, and what that costs."""
    both = planes[edges].sum(1)
    middle, length = points[edges].mean(1), np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    weight = np.trace(both[:, :3, :3], axis1=1, axis2=2)
    matrix = both[:, :3, :3] + (_STAY * weight + 1e-30)[:, None, None] * np.eye(3)
    pull = -both[:, :3, 3] - np.einsum("nij,nj->ni", both[:, :3, :3], middle)
    step = np.linalg.solve(matrix, pull[:, :, None])[:, :, 0]
    # Planes that are nearly parallel meet far away.
    step *= np.minimum(1, length / np.maximum(np.linalg.norm(step, axis=1), 1e-30))[:, None]
    place = middle + step
    at = np.concatenate([place, np.ones((len(place), 1))], 1)
    return place, np.einsum("ni,nij,nj->n", at, both, at) + _SHORT * weight * length**2


def _apart(faces: np.ndarray, edges: np.ndarray, cost: np.ndarray, corners: int) -> Int[np.ndarray, " chosen"]:
    """Return edges, the cheapest first, that are cheaper than every edge at a neighbour of their ends."""
    rank = np.empty(len(edges))
    order = np.argsort(cost, kind="stable")
    rank[order] = np.arange(len(edges))
    least = np.full(corners, np.inf)
    for end in edges.T:
        np.minimum.at(least, end, rank)
    around = least.copy()
    for k in range(3):
        for other in (1, 2):
            np.minimum.at(around, faces[:, k], least[faces[:, (k + other) % 3]])
    found = np.flatnonzero(rank <= around[edges].min(1))
    return found[np.argsort(rank[found])]


def _unfolded(points: np.ndarray, faces: np.ndarray, edges: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return which edges may shrink without a triangle around them that folds over."""
    which = np.full(len(points), -1)
    which[edges[:, 0]] = which[edges[:, 1]] = np.arange(len(edges))
    of = which[faces]
    touched = np.flatnonzero(of.max(1) >= 0)
    of, corners = of[touched], points[faces[touched]]
    # A triangle at both ends of an edge goes; at one end it is moved. No triangle touches two edges.
    stays = (of >= 0).sum(1) == 1
    of, corners = of[stays], corners[stays]
    moved = np.where((of >= 0)[:, :, None], place[of.max(1)][:, None], corners)
    before, after = (np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]) for c in (corners, moved))
    straight = (before * after).sum(1) > _TURN * np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    fine = np.ones(len(edges), bool)
    fine[of.max(1)[~straight]] = False
    return fine


# Any other mesh: corners that share a cell become one.

_TRUST = 1e-3
"""Singular values below this share of the largest are ignored: the corner stays near its cell's mean."""


def _clustered(mesh: Mesh, faces: int) -> Mesh:
    """Return a mesh whose corners are one for each cell, where the planes of its triangles come nearest to meeting.

    Edges so stay sharp (Lindstrom 2000, section 3). The surface may not be closed any more.
    """
    low = mesh.vertices.min(0)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    # A cell that the surface crosses gives one corner, and two triangles come with a corner.
    cell = max(np.sqrt(2 * area / faces), 1e-12)
    while True:
        cells, kept = _merged(mesh, low, cell)
        if len(kept) <= faces:
            break
        cell *= max(1.05, np.sqrt(len(kept) / faces))
    used, numbers = np.unique(kept, return_inverse=True)  # corners that no triangle has are left out
    return replace(mesh, vertices=_corners(mesh, cells)[used], faces=numbers.reshape(-1, 3))


def _merged(mesh: Mesh, low: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of each corner's cell, and the triangles over cells that keep an area, each once."""
    grid = np.floor((mesh.vertices - low) / cell).astype(np.int64)
    _, cells = np.unique(grid, axis=0, return_inverse=True)
    faces = cells.reshape(-1)[mesh.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    # The same triangle from its least corner on; the orientation stays.
    start = faces.argmin(1)
    faces = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, 1)
    return cells.reshape(-1), np.unique(faces, axis=0)


def _corners(mesh: Mesh, cells: np.ndarray) -> np.ndarray:
    """Return where each cell's corner is: from the mean of its corners to the least squared distance from its planes."""
    count = cells.max() + 1
    number = np.bincount(cells, minlength=count)
    mean = np.stack([np.bincount(cells, mesh.vertices[:, a], count) for a in range(3)], 1) / number[:, None]
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)  # its length weighs the planes by area
    matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for corner in range(3):
        cell = cells[mesh.faces[:, corner]]
        gap = (normal * (a - mean[cell])).sum(1)
        np.add.at(matrix, cell, normal[:, :, None] * normal[:, None, :])
        np.add.at(right, cell, normal * gap[:, None])
    step = np.einsum("nij,nj->ni", np.linalg.pinv(matrix, rcond=_TRUST, hermitian=True), right)
    # Planes that are nearly parallel meet far away: the corner stays within its cell.
    reach = np.zeros(count)
    np.maximum.at(reach, cells, np.linalg.norm(mesh.vertices - mean[cells], axis=1))
    length = np.linalg.norm(step, axis=1)
    return mean + step * np.minimum(1, reach / np.maximum(length, 1e-12))[:, None]
