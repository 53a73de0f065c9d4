"""Occupancy grids to clean, closed meshes: marching cubes, specks and cavities taken away, faces outwards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.meshes.mesh import Mesh

if TYPE_CHECKING:
    import trimesh

__all__ = ["Surface", "surface_of"]

_FROM_LEVEL = 1e-4
"""Corners of voxels keep so far from the level: a surface through a corner would have triangles without area."""
_SHRINK, _SWELL = 0.5, 0.53
"""Taubin 1995, section 3: a step inwards and a slightly larger one outwards."""


@dataclass(frozen=True)
class Surface:
    """What was cut out of one grid."""

    mesh: Mesh | None
    """In the grid's own frame, the cube from -1 to 1; none where the grid has no inside."""
    reason: str = ""
    """Why there is no mesh."""
    watertight: bool = False
    """Every edge joins two triangles that run alike: the mesh has an inside and a volume."""
    pieces: int = 0
    """Parts that do not touch each other and were kept."""
    specks: int = 0
    """Parts that were too small and are gone."""
    cavities: int = 0
    """Hollows without a way out that were filled."""

    def told(self) -> str:
        """Return what was cleaned and what is wrong, in a few words; empty where nothing is."""
        if self.mesh is None:
            return self.reason
        facts = [
            (self.specks, f"{self.specks} speck{'s' * (self.specks > 1)} removed"),
            (self.cavities, f"{self.cavities} cavit{'ies' if self.cavities > 1 else 'y'} filled"),
            (self.pieces > 1, f"in {self.pieces} pieces"),
            (not self.watertight, "not watertight"),
        ]
        return ", ".join(text for told, text in facts if told)


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
    smoothing keep the volume. Raises ValueError for values that are not finite or a grid that is no cube,
    UserError for a level that is not between 0 and 1.
    """
    if not 0 < level < 1:
        raise UserError(f"level={level}: the surface lies at an occupancy between 0 and 1.")
    if len(set(occupancy.shape)) != 1 or not np.isfinite(occupancy).all():
        raise ValueError(f"occupancy {occupancy.shape}: expected a cube of finite values")
    reason = _empty(occupancy, level)
    if reason:
        return Surface(None, reason)
    whole = _cut(occupancy, level)
    kept, specks, cavities = _cleaned(whole, least_share, cavity_share)
    if smooth:
        _smoothed(kept, smooth)
    mesh = Mesh(np.asarray(kept.vertices, float), np.asarray(kept.faces, np.int64), name, category)
    return Surface(mesh, "", bool(kept.is_watertight), int(kept.body_count), specks, cavities)


def _empty(occupancy: np.ndarray, level: int | float) -> str:
    if occupancy.max() <= level:
        return f"empty: the largest occupancy is {occupancy.max():.2g}, the surface lies at {level:g}"
    return ""


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
    whole = trimesh.Trimesh(points, faces, process=False)
    if whole.volume < 0:
        whole.invert()
    return whole


def _cleaned(
    whole: trimesh.Trimesh, least_share: int | float, cavity_share: int | float
) -> tuple[trimesh.Trimesh, int, int]:
    """Return what is kept, how many specks and how many cavities are gone: a cavity's own volume is negative."""
    import trimesh
    from trimesh.util import concatenate

    parts = whole.split(only_watertight=False, repair=False)
    if len(parts) < 2:
        return whole, 0, 0
    volumes = np.array([part.volume for part in parts])
    largest = volumes.max()
    speck = (volumes >= 0) & (volumes < least_share * largest)
    hollow = volumes < 0
    # What was hollow inside a speck goes with it, as do the small hollows.
    filled = hollow & (-volumes < cavity_share * largest)
    kept = [part for part, drop in zip(parts, speck | filled, strict=True) if not drop]
    joined = concatenate(kept)
    assert isinstance(joined, trimesh.Trimesh)
    return joined, int(speck.sum()), int(filled.sum())


def _smoothed(mesh: trimesh.Trimesh, rounds: int) -> None:
    """Smooth a mesh where it stands, and give it back the volume that it had."""
    from trimesh.smoothing import filter_taubin

    before, middle = mesh.volume, mesh.center_mass if mesh.is_watertight else mesh.centroid
    filter_taubin(mesh, lamb=_SHRINK, nu=_SWELL, iterations=2 * rounds)
    if mesh.volume > 0 and before > 0:
        mesh.vertices = middle + (mesh.vertices - middle) * (before / mesh.volume) ** (1 / 3)
