"""`Standing`: an occupancy grid where it stands in the camera frame, sampled, moved and mirrored in depth."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from skimage.measure import marching_cubes
from torch import Tensor

from uplift.masks.container import Placed
from uplift.shapes.prediction import ShapePrediction

__all__ = ["Standing", "predicted", "true", "voxel_centres"]

_OF_GRID = ("inside", "empty", "span", "surface")


@dataclass(frozen=True, eq=False)
class Standing:
    """An occupancy grid [z, y, x] of its own cube of -1 to 1; own point p is at ``matrix`` @ p + ``origin``."""

    occupancy: Float[Tensor, "depth height width"]
    level: float
    matrix: Float[np.ndarray, "3 3"]
    """From the own frame to the camera's: a rotation times the scale, with a reflection where mirrored."""
    origin: Float[np.ndarray, "3"]
    """Where the own frame's origin is in the camera frame."""
    distance: float
    """Of the camera; infinite for parallel rays."""

    @cached_property
    def inside(self) -> Bool[np.ndarray, "depth height width"]:
        """Voxels that are occupied."""
        return (self.occupancy > self.level).numpy()

    @cached_property
    def empty(self) -> bool:
        """Whether no voxel is occupied."""
        return not self.inside.any()

    @cached_property
    def span(self) -> tuple[slice, slice, slice]:
        """Where along z, y and x voxels are occupied, of a shape that is not empty."""
        z, y, x = (np.flatnonzero(self.inside.any(other)) for other in ((1, 2), (0, 2), (0, 1)))
        return slice(int(z[0]), int(z[-1]) + 1), slice(int(y[0]), int(y[-1]) + 1), slice(int(x[0]), int(x[-1]) + 1)

    @cached_property
    def surface(self) -> tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]]:
        """Vertices in the own frame, and faces, of the surface at the level (marching cubes); none of an empty shape."""
        if self.empty:
            return np.zeros((0, 3)), np.zeros((0, 3), int)
        side = self.occupancy.shape[0]
        around = tuple(slice(s.start, s.stop + 2) for s in self.span)  # one more on each side, of a padded grid
        index, faces, _, _ = marching_cubes(np.pad(self.occupancy.numpy(), 1)[around], self.level)
        index = (index + [s.start - 1 for s in around])[:, ::-1]
        return (2 * index + 1) / side - 1, faces.astype(int)

    @cached_property
    def voxel(self) -> float:
        """Side of a voxel in the camera frame."""
        return 2 / self.occupancy.shape[0] * float(abs(np.linalg.det(self.matrix))) ** (1 / 3)

    @cached_property
    def occupied(self) -> Float[np.ndarray, "voxels 3"]:
        """Centres of the occupied voxels in the camera frame."""
        index = np.argwhere(self.inside)[:, ::-1]
        return self.to_camera((2 * index + 1) / self.occupancy.shape[0] - 1)

    @cached_property
    def volume(self) -> float:
        """Occupied volume in units of the camera frame."""
        return int(self.inside.sum()) * self.voxel**3

    @cached_property
    def depth(self) -> float:
        """Depth of the centroid of the occupied volume; the origin's where nothing is occupied."""
        return float(self.origin[2]) if self.empty else float(self.occupied[:, 2].mean())

    @cached_property
    def inverse(self) -> Float[np.ndarray, "3 3"]:
        """From the camera's directions to the own frame's."""
        return np.linalg.inv(self.matrix)

    def to_camera(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Return points of the own frame in the camera's."""
        return points @ self.matrix.T + self.origin

    def to_own(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Return points of the camera frame in the own one."""
        return (points - self.origin) @ self.inverse.T

    def inside_at(
        self, points: Float[Tensor, "depth height width 3"], matrix: np.ndarray, origin: np.ndarray
    ) -> Bool[np.ndarray, "depth height width"]:
        """Return which points of another frame are inside; that frame's point p is at ``matrix`` @ p + ``origin``."""
        turn = torch.from_numpy(self.inverse @ matrix).float()
        start = torch.from_numpy(self.inverse @ (origin - self.origin)).float()
        return (self.sample(points @ turn.T + start) > self.level).numpy()

    def sample(self, points: Float[Tensor, "depth height width 3"]) -> Float[Tensor, "depth height width"]:
        """Return the occupancy at points of the own frame, between voxels linearly; 0 outside the cube."""
        found = torch.nn.functional.grid_sample(self.occupancy[None, None], points[None].float(), align_corners=False)
        return found[0, 0]

    def moved(self, step: float) -> Standing:
        """Return the shape farther away by ``step``."""
        return self._elsewhere(origin=self.origin + np.array([0, 0, step]))

    def turned(self, rotation: Float[np.ndarray, "3 3"], about: Float[np.ndarray, "3"]) -> Standing:
        """Return the shape turned in the camera frame about a point, which becomes the frame's origin."""
        return self._elsewhere(matrix=rotation @ self.matrix, origin=rotation @ (self.origin - about))

    def mirrored(self) -> Standing:
        """Return the shape mirrored in depth, z to -z, its centroid where it was."""
        flip = np.array([1.0, 1.0, -1.0])
        middle = np.array([0, 0, 2 * self.depth])
        return self._elsewhere(matrix=flip[:, None] * self.matrix, origin=flip * self.origin + middle)

    def _elsewhere(self, **place: np.ndarray) -> Standing:
        """Return the same grid at another place: what is known of the grid itself is not found again."""
        other = replace(self, **place)
        other.__dict__.update({name: self.__dict__[name] for name in _OF_GRID if name in self.__dict__})
        return other


def predicted(prediction: ShapePrediction, row: int) -> Standing:
    """Return a lifted shape where the prediction says it stands."""
    placed = (prediction.view, prediction.scale, prediction.offset, prediction.distance)
    return _standing(prediction.occupancy[row], prediction.level, *(part[row] for part in placed))


def true(truth: Placed, row: int, filled: Bool[np.ndarray, "depth height width"]) -> Standing:
    """Return a true shape where it stands, given its filled grid."""
    return _standing(filled, 0.5, *(part[row] for part in (truth.view, truth.scale, truth.offset, truth.distance)))


def _standing(occupancy: np.ndarray, level: float, view, scale, offset, distance) -> Standing:
    return Standing(
        torch.from_numpy(np.ascontiguousarray(occupancy, np.float32)),
        level,
        np.asarray(view, np.float64) * float(scale),
        np.array([*offset, 0.0], np.float64),
        float(distance),
    )


@functools.lru_cache(3)
def voxel_centres(resolution: int) -> Float[Tensor, "depth height width 3"]:
    """Return the voxel centres (x, y, z) of the cube from -1 to 1, indexed [z, y, x]; not to be changed."""
    along = (2 * torch.arange(resolution) + 1) / resolution - 1
    return torch.stack(torch.meshgrid(along, along, along, indexing="ij")[::-1], -1)
