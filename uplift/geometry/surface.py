"""Surfaces of occupancy grids: marching cubes on a finer field, cleaned and closed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.geometry.mesh import Mesh

if TYPE_CHECKING:
    import trimesh

__all__ = ["Surface", "surface_of", "written_surface"]

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
    finer: int = 1,
    joined: bool = False,
    least_share: int | float = 0.02,
    cavity_share: int | float = 0.05,
    smooth: int = 0,
    name: str = "",
    category: str = "",
) -> Surface:
    """Return the surface where the occupancy, [z, y, x] at the centres of voxels, crosses ``level``.

    What lies outside of the grid is empty, so the surface is closed at its border. ``finer`` times as many voxels a
    side are cut, between the given ones by cubic splines of the occupancy's log odds. ``joined`` first raises ridges
    below the level where they join parts (`_joined`). Parts below ``least_share`` of the largest part's volume and
    hollows below ``cavity_share`` of it go. ``smooth`` rounds of Taubin's smoothing keep the volume.

    Raises ValueError for values that are not finite, a grid that is not a cube or ``finer`` below 1, UserError for a
    level that is not between 0 and 1.
    """
    if not 0 < level < 1:
        raise UserError(f"level={level}: the surface lies at an occupancy between 0 and 1.")
    if len(set(occupancy.shape)) != 1 or not np.isfinite(occupancy).all() or finer < 1:
        raise ValueError(f"occupancy {occupancy.shape}, {finer} times finer: expected a cube of finite values")
    if occupancy.max() <= level:
        return Surface(None, f"empty: the largest occupancy is {occupancy.max():.2g}, the surface lies at {level:g}")
    grid = np.asarray(occupancy, np.float64)
    surface = _cut(_joined(grid, level) if joined else grid, level, finer)
    kept, specks, cavities = _cleaned(surface, least_share, cavity_share)
    if smooth:
        _smoothed(kept, smooth)
    mesh = Mesh(np.asarray(kept.vertices, float), np.asarray(kept.faces, np.int64), name, category)
    return Surface(mesh, "", bool(kept.is_watertight), int(kept.body_count), specks, cavities)


_FINER, _SMOOTH = 2, 4


def written_surface(
    occupancy: Float[np.ndarray, "depth height width"],
    level: int | float,
    *,
    smooth: int = _SMOOTH,
    finer: int = _FINER,
    name: str = "",
) -> Surface:
    """Return the surface of a lifted shape as files and pages have it, and as it is scored: `surface_of`, fine and joined."""
    return surface_of(
        np.asarray(occupancy, np.float32), level=level, finer=finer, joined=True, smooth=smooth, name=name
    )


def _cut(occupancy: np.ndarray, level: int | float, finer: int) -> trimesh.Trimesh:
    """Return the surface in the cube from -1 to 1, corners once, faces anticlockwise from outside."""
    import trimesh
    from skimage.measure import marching_cubes

    grid, level = (np.pad(occupancy, 1), level) if finer == 1 else _refined(occupancy, level, finer)
    inside = grid > level
    grid = np.where(inside, np.maximum(grid, level + _FROM_LEVEL), np.minimum(grid, level - _FROM_LEVEL))
    corners, faces, _, _ = marching_cubes(grid.astype(np.float32), level)
    # Voxel 0 of the grid is number `finer` of the padded one, its centre at 1 / R - 1.
    points = (2 * (corners[:, ::-1].astype(np.float64) / finer - 1) + 1) / len(occupancy) - 1
    surface = trimesh.Trimesh(points, faces, process=False)
    if surface.volume < 0:
        surface.invert()
    return surface


_SURE = 0.02
"""Occupancy is never taken to be surer than this, or 1 less this: log odds are finite."""


def _refined(occupancy: np.ndarray, level: int | float, finer: int) -> tuple[np.ndarray, float]:
    """Return log odds of the occupancy, padded by an empty voxel, at its voxels and ``finer`` - 1 places between; and the level's."""
    from scipy import ndimage

    sure = min(_SURE, level / 4, (1 - level) / 4)
    padded = np.clip(np.pad(occupancy, 1), sure, 1 - sure)
    odds, middle = np.log(padded / (1 - padded)), float(np.log(level / (1 - level)))
    side = (len(odds) - 1) * finer + 1
    found = np.asarray(ndimage.zoom(odds, side / len(odds), order=3, mode="nearest"))
    found[::finer, ::finer, ::finer] = odds  # as given, not nearly: what is just above the level stays so
    # Splines swing: the border must stay empty for the surface to close.
    found[[0, -1]] = found[:, [0, -1]] = found[:, :, [0, -1]] = odds[0, 0, 0]
    return found, middle


# Thin parts whose occupancy falls below the level here and there are joined again.

_RIDGE = 0.15
"""Of the level: where the occupancy is lower there is no ridge."""
_SPECK = 3
"""Voxels: smaller parts are noise."""
_RAISED = 1.1
"""Of the level: what a ridge is raised to."""


def _joined(occupancy: np.ndarray, level: int | float) -> np.ndarray:
    """Return the occupancy with the likeliest way from each part to the largest one raised above the level.

    The way has the greatest product of occupancies (of those below the level), and none below `_RIDGE` of the level;
    a part without such a way stays as it is. A grid that is its own mirror image (x to -x) stays so.
    """
    from scipy import ndimage
    from skimage.graph import MCP_Geometric

    parts = np.zeros(occupancy.shape, np.int32)
    if ndimage.label(occupancy > level, np.ones((3, 3, 3)), output=parts) == 1:
        return occupancy
    size = np.bincount(parts.ravel())[1:]
    largest = 1 + int(size.argmax())
    share = occupancy / level
    cost = np.where(share < _RIDGE, -1.0, 0.02 - np.log(np.clip(share, _RIDGE, 1)))  # below 0: no way through
    ways = MCP_Geometric(cost)
    far, _ = ways.find_costs(np.argwhere(parts == largest))
    raised = occupancy.copy()
    for part in np.flatnonzero(size >= _SPECK) + 1:
        ends = np.argwhere(parts == part)
        away = far[tuple(ends.T)]
        if part != largest and np.isfinite(away.min()):
            way = tuple(np.transpose(ways.traceback(ends[away.argmin()])))
            raised[way] = np.maximum(raised[way], min(_RAISED * level, (1 + level) / 2))
    return np.maximum(raised, raised[:, :, ::-1]) if _is_mirror(occupancy) else raised


def _is_mirror(occupancy: np.ndarray) -> bool:
    return bool(np.abs(occupancy - occupancy[:, :, ::-1]).max() < 1e-3)


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
