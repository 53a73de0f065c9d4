"""Surfaces of occupancy grids: marching cubes, cleaned and closed, and thinned to be looked at."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.geometry.mesh import Mesh

if TYPE_CHECKING:
    import trimesh

__all__ = ["Surface", "surface_of", "thinned"]

_FROM_LEVEL = 1e-4
"""Corners of voxels keep so far from the level: a surface through a corner would have triangles without area."""
_SHRINK, _SWELL = 0.5, 0.53
"""Taubin 1995, section 3: a step inwards and a slightly larger one outwards."""


@dataclass(frozen=True)
class Surface:
    """What was cut out of one grid."""

    mesh: Mesh | None
    """In the frame of the grid, the cube from -1 to 1; None where the grid has no inside."""
    reason: str = ""
    """Why there is no mesh."""
    watertight: bool = False
    """Every edge joins two triangles that run alike: the mesh has an inside and a volume."""
    pieces: int = 0
    """Parts that do not touch each other and were kept."""
    specks: int = 0
    """Parts that were too small and were removed."""
    cavities: int = 0
    """Closed hollows that were filled."""

    def summary(self) -> str:
        """Return what was cleaned and what is wrong, in a few words; empty where nothing is."""
        if self.mesh is None:
            return self.reason
        facts = [
            (self.specks, f"{self.specks} speck{'s' * (self.specks > 1)} removed"),
            (self.cavities, f"{self.cavities} cavit{'ies' if self.cavities > 1 else 'y'} filled"),
            (self.pieces > 1, f"in {self.pieces} pieces"),
            (not self.watertight, "not watertight"),
        ]
        return ", ".join(text for holds, text in facts if holds)


def surface_of(
    occupancy: Float[np.ndarray, "depth height width"],
    *,
    level: int | float = 0.5,
    least_share: int | float = 0.02,
    cavity_share: int | float = 0.05,
    smooth: int = 0,
    name: str = "",
    category: str = "",
) -> Surface:
    """Return the surface where the occupancy, [z, y, x] at the centres of voxels, crosses ``level``.

    What lies outside of the grid is empty, so the surface is closed at its border. Parts below ``least_share``
    of the largest part's volume and hollows below ``cavity_share`` of it go. ``smooth`` rounds of Taubin's
    smoothing keep the volume. Raises ValueError for values that are not finite or a grid that is not a cube,
    UserError for a level that is not between 0 and 1.
    """
    if not 0 < level < 1:
        raise UserError(f"level={level}: the surface lies at an occupancy between 0 and 1.")
    if len(set(occupancy.shape)) != 1 or not np.isfinite(occupancy).all():
        raise ValueError(f"occupancy {occupancy.shape}: expected a cube of finite values")
    if occupancy.max() <= level:
        return Surface(None, f"empty: the largest occupancy is {occupancy.max():.2g}, the surface lies at {level:g}")
    surface = _cut(occupancy, level)
    kept, specks, cavities = _cleaned(surface, least_share, cavity_share)
    if smooth:
        _smoothed(kept, smooth)
    mesh = Mesh(np.asarray(kept.vertices, float), np.asarray(kept.faces, np.int64), name, category)
    return Surface(mesh, "", bool(kept.is_watertight), int(kept.body_count), specks, cavities)


def _cut(occupancy: np.ndarray, level: int | float) -> trimesh.Trimesh:
    """Return the surface in the cube from -1 to 1, corners once, faces anticlockwise from outside."""
    import trimesh
    from skimage.measure import marching_cubes

    grid = np.pad(np.asarray(occupancy, np.float64), 1)
    inside = grid > level
    grid = np.where(inside, np.maximum(grid, level + _FROM_LEVEL), np.minimum(grid, level - _FROM_LEVEL))
    corners, faces, _, _ = marching_cubes(grid.astype(np.float32), level)
    # Voxel 0 of the grid is number 1 of the padded one, its centre at 1 / R - 1.
    points = (2 * (corners[:, ::-1].astype(np.float64) - 1) + 1) / len(occupancy) - 1
    surface = trimesh.Trimesh(points, faces, process=False)
    if surface.volume < 0:
        surface.invert()
    return surface


def _cleaned(
    surface: trimesh.Trimesh, least_share: int | float, cavity_share: int | float
) -> tuple[trimesh.Trimesh, int, int]:
    """Return what is kept, how many specks and how many cavities are gone: the volume of a cavity is negative."""
    import trimesh
    from trimesh.util import concatenate

    parts = surface.split(only_watertight=False, repair=False)
    if len(parts) < 2:
        return surface, 0, 0
    volumes = np.array([part.volume for part in parts])
    largest = volumes.max()
    speck = (volumes >= 0) & (volumes < least_share * largest)
    hollow = volumes < 0
    # Hollows inside a speck go with it, as do small hollows.
    filled = hollow & (-volumes < cavity_share * largest)
    kept = [part for part, drop in zip(parts, speck | filled, strict=True) if not drop]
    joined = concatenate(kept)
    assert isinstance(joined, trimesh.Trimesh)
    return joined, int(speck.sum()), int(filled.sum())


def _smoothed(mesh: trimesh.Trimesh, rounds: int) -> None:
    """Smooth a mesh in place and restore its volume."""
    from trimesh.smoothing import filter_taubin

    before, middle = mesh.volume, mesh.center_mass if mesh.is_watertight else mesh.centroid
    filter_taubin(mesh, lamb=_SHRINK, nu=_SWELL, iterations=2 * rounds)
    if mesh.volume > 0 and before > 0:
        mesh.vertices = middle + (mesh.vertices - middle) * (before / mesh.volume) ** (1 / 3)


# Meshes with fewer triangles, to look at: corners that share a cell become one.

_TRUST = 1e-3
"""Singular values below this share of the largest are ignored: the corner stays near its cell's mean."""


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
