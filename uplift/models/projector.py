"""`Projector`: differentiable silhouettes of density grids, by a sparse matrix for each view."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import coo_array, csr_array
from torch import Tensor

__all__ = ["BASE", "Projector"]

BASE = 0.62
"""Scale at which silhouettes are rendered: the cube of a shape stays inside the image."""
_DEEP = 1.45
"""Half the depth that rays are sampled over, in units of the shape frame."""


def _rays(side: int, distance: float) -> Tensor:
    """Return points (side * side * side, 3) along the rays of an image: camera frame, units of the shape frame."""
    at = (2 * torch.arange(side) + 1) / side - 1
    z, y, x = torch.meshgrid(at * _DEEP, at / BASE, at / BASE, indexing="ij")
    return torch.stack([x * (1 + z / distance), y * (1 + z / distance), z], -1).reshape(-1, 3)


def _corner_weights(points: Tensor, resolution: int) -> tuple[Tensor, Tensor]:
    """Return voxels (points 8) and weights (points 8) of trilinear interpolation; weights are 0 outside the grid."""
    place = ((points + 1) * resolution - 1) / 2
    low = place.floor()
    part = place - low
    voxels, weights = [], []
    for corner in range(8):
        step = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2 & 1], dtype=points.dtype)
        at = low + step
        weight = torch.where(step > 0, part, 1 - part).prod(-1)
        inside = ((at >= 0) & (at < resolution)).all(-1)
        x, y, z = at.clamp(0, resolution - 1).long().unbind(-1)
        voxels.append((z * resolution + y) * resolution + x)
        weights.append(weight * inside)
    return torch.stack(voxels, -1), torch.stack(weights, -1)


class _Sum(torch.autograd.Function):
    """A sparse matrix times a dense one; the gradient uses the transposed matrix, which is made once."""

    @staticmethod
    def forward(context, dense, matrix, transposed):
        context.transposed = transposed
        return torch.sparse.mm(matrix, dense)

    @staticmethod
    def backward(context, gradient):
        return torch.sparse.mm(context.transposed, gradient.contiguous()), None, None


class Projector:
    """Differentiable silhouettes of many shapes from fixed views, one sparse matrix product per view.

    The opacity of a ray is 1 - exp(-d), where d is the root of the sum of squared densities along it: four
    voxels of haze hide twice as much as one, not four times, so that haze is not a cheap way to be opaque. As a
    silhouette is a function of a sum over voxels, the matrix of a fixed view is made once.

    Args:
        views: rotations from the shape frame to the camera frame.
        resolution: voxels along each axis of a shape.
        side: pixels along each axis of a silhouette.
        distance: from the camera to the centre of the shape, in units of the shape frame.
    """

    def __init__(self, views: Float[Tensor, "views 3 3"], *, resolution: int, side: int, distance: float):
        self.resolution, self.side, self.device = resolution, side, views.device
        camera = _rays(side, distance)
        pixel = torch.arange(side * side).repeat(side)
        # Steps of depth count as their length in voxels.
        length = (2 * _DEEP / side) / (2 / resolution)
        self._views = [self._matrices(camera @ view.cpu(), pixel, length) for view in views]
        self.to(views.device)

    def _matrices(self, points: Tensor, pixel: Tensor, length: float) -> tuple[Tensor, Tensor]:
        voxel, weight = _corner_weights(points, self.resolution)
        kept = weight > 1e-3
        index = (pixel[:, None].expand_as(voxel)[kept].numpy(), voxel[kept].numpy())
        size = (self.side**2, self.resolution**3)
        matrix = coo_array(((weight[kept] * length).numpy(), index), shape=size).tocsr()
        return _compressed(matrix), _compressed(matrix.T.tocsr())

    def __len__(self) -> int:
        return len(self._views)

    def to(self, device: torch.device | str) -> Projector:
        """Move the matrices."""
        self.device = torch.device(device)
        self._views = [(matrix.to(device), transposed.to(device)) for matrix, transposed in self._views]
        return self

    def __deepcopy__(self, memo: object) -> Projector:
        """Return itself: the matrices are not trained, and copies of a mixture have the same views."""
        return self

    def __call__(
        self, density: Float[Tensor, "shapes depth height width"], rows: Sequence[int] | None = None
    ) -> Float[Tensor, "shapes views side side"]:
        """Return the opacity of each pixel, 0..1, from every view or those of ``rows``; ``density`` is per voxel."""
        flat = density.reshape(len(density), -1).T.contiguous().square()
        chosen = self._views if rows is None else [self._views[row] for row in rows]
        passed = torch.stack([_Sum.apply(flat, *matrices).T for matrices in chosen], 1)
        return 1 - torch.exp(-passed.clamp_min(1e-12).sqrt().unflatten(-1, (self.side, self.side)))


def _compressed(matrix: csr_array) -> Tensor:
    """Return a torch tensor with 32-bit indices, to save memory."""
    row, column, data = (torch.from_numpy(np.asarray(part)) for part in (matrix.indptr, matrix.indices, matrix.data))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(row.int(), column.int(), data, matrix.shape, check_invariants=False)
