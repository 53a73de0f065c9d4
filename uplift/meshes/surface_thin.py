"""Meshes with fewer triangles, to look at: corners that share a cell become one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uplift.meshes.mesh import Mesh

__all__ = ["thinned"]

_TRUST = 1e-3
"""Singular values below this share of the largest say nothing: the corner stays near its cell's mean."""


def thinned(mesh: Mesh, faces: int) -> Mesh:
    """Return a mesh of at most ``faces`` triangles; the same mesh where it has no more.

    Each cell's corner lies where the planes of its triangles come nearest to meeting (Lindstrom 2000,
    section 3), so that edges stay sharp. The surface may not be closed any more.
    """
    if len(mesh.faces) <= faces:
        return mesh
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
    return _ordered(replace(mesh, vertices=_corners(mesh, cells), faces=kept))


def _merged(mesh: Mesh, low: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of each corner's cell, and the triangles over cells that keep an area, each once."""
    grid = np.floor((mesh.vertices - low) / cell).astype(np.int64)
    _, cells = np.unique(grid, axis=0, return_inverse=True)
    faces = cells.reshape(-1)[mesh.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    # The same triangle begun at its least corner; the way round stays.
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
    # Planes that are nearly parallel meet far away: the corner stays within its cell's own.
    reach = np.zeros(count)
    np.maximum.at(reach, cells, np.linalg.norm(mesh.vertices - mean[cells], axis=1))
    length = np.linalg.norm(step, axis=1)
    return mean + step * np.minimum(1, reach / np.maximum(length, 1e-12))[:, None]


def _ordered(mesh: Mesh) -> Mesh:
    """Return the mesh without corners that no triangle has."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return replace(mesh, vertices=mesh.vertices[used], faces=faces.reshape(-1, 3))
