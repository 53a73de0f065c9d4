"""From density grids to silhouettes: points along the rays of a camera, and the sparse matrix that sums along them."""

from __future__ import annotations

import warnings

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["BASE", "Projector"]

BASE = 0.62
"""Scale at which silhouettes are drawn: the whole cube of a shape stays inside the image."""
_DEEP = 1.45
"""Half the depth that is looked through, in units of the own frame."""


def _rays(side: int, steps: int, distance: float) -> Tensor:
    """Return points (steps * side * side, 3) of the camera's frame along the rays of an image, in own units."""
    at = (2 * torch.arange(side) + 1) / side - 1
    z = ((2 * torch.arange(steps) + 1) / steps - 1) * _DEEP
    z, y, x = torch.meshgrid(z, at / BASE, at / BASE, indexing="ij")
    return torch.stack([x * (1 + z / distance), y * (1 + z / distance), z], -1).reshape(-1, 3)


def _corner_weights(points: Tensor, resolution: int) -> tuple[Tensor, Tensor]:
    """Return voxels (points 8) and weights (points 8) of trilinear sampling; weight 0 outside the grid."""
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
    """A sparse matrix times a dense one; its gradient by the transposed matrix, made once."""

    @staticmethod
    def forward(context, dense, matrix, transposed):
        """Return the product."""
        context.transposed = transposed
        return torch.sparse.mm(matrix, dense)

    @staticmethod
    def backward(context, gradient):
        """Return the gradient of the dense factor."""
        return torch.sparse.mm(context.transposed, gradient.contiguous()), None, None


class Projector:
    """Silhouettes of many shapes from the same fixed views, as one sparse product.

    What hides the light is the root of the summed squares of density along a ray: four voxels of haze hide
    twice what one does, not four times, so that haze is no cheap way to be opaque. A sum over voxels and one
    function of it is all a silhouette is, so that the matrix of fixed views is made once.
    """

    def __init__(self, views: Float[Tensor, "views 3 3"], *, resolution: int, side: int, distance: float):
        self.views, self.resolution, self.side = len(views), resolution, side
        steps = side
        camera = _rays(side, steps, distance)
        pixel = torch.arange(side * side).repeat(steps)
        # Steps of depth count as their length in voxels.
        length = (2 * _DEEP / steps) / (2 / resolution)
        rows, columns, values = [], [], []
        for number, view in enumerate(views):
            voxel, weight = _corner_weights(camera @ view, resolution)
            kept = weight > 1e-3
            rows.append((pixel + number * side * side)[:, None].expand_as(voxel)[kept])
            columns.append(voxel[kept])
            values.append(weight[kept] * length)
        size = (len(views) * side * side, resolution**3)
        index = torch.stack([torch.cat(rows), torch.cat(columns)])
        matrix = torch.sparse_coo_tensor(index, torch.cat(values), size, check_invariants=False).coalesce()
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
            self.matrix = matrix.to_sparse_csr()
            self.transposed = matrix.t().coalesce().to_sparse_csr()

    def to(self, device: torch.device | str) -> Projector:
        """Move the matrices."""
        self.matrix, self.transposed = self.matrix.to(device), self.transposed.to(device)
        return self

    def __call__(self, density: Float[Tensor, "shapes depth height width"]) -> Float[Tensor, "shapes views side side"]:
        """Return how much light each pixel loses, 0..1, from every view; ``density`` is per voxel."""
        flat = density.reshape(len(density), -1).T.contiguous()
        passed = _Sum.apply(flat.square(), self.matrix, self.transposed).clamp_min(1e-12).sqrt()
        return 1 - torch.exp(-passed.T.reshape(len(density), self.views, self.side, self.side))
