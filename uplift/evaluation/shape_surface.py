"""Surfaces: points and normals of meshes and of occupancy grids, and how near two of them are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from uplift.evaluation.shape_standing import Standing
from uplift.meshes.mesh import Mesh

__all__ = ["NOTHING", "POINTS", "Surface", "compare_surfaces", "grid_surface", "mesh_surface"]

POINTS = 10_000
"""Points on each surface."""
THRESHOLD = 0.02
"""Of the f_score, in the truth's longest side."""
NOTHING = {"chamfer": 1.0, "f_score": 0.0, "normal_consistency": 0.0}
"""What a shape without surface scores: its distance is taken for the truth's longest side."""


@dataclass(frozen=True)
class Surface:
    """Points of a surface and the unit normals there, in the camera frame."""

    points: Float[np.ndarray, "points 3"]
    normals: Float[np.ndarray, "points 3"]

    @cached_property
    def tree(self) -> KDTree:
        """Of the points; built for few questions."""
        return KDTree(self.points, leafsize=32, compact_nodes=False, balanced_tree=False)

    def nearest_to(self, other: Surface) -> tuple[np.ndarray, np.ndarray]:
        """Return how far each point of ``other`` is from the nearest one here, and which that is."""
        away, which = self.tree.query(other.points, workers=torch.get_num_threads())
        return away, np.asarray(which)


def mesh_surface(mesh: Mesh, truth: Standing, points: int = POINTS) -> Surface:
    """Return points spread evenly over the mesh's outer surface, where ``truth`` (its filled grid) stands.

    A point is inside the union, and left out, where the filled grid is occupied a voxel away on both
    sides of its triangle.
    """
    corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
    found, normals = _spread(corners, 2 * points)
    step = normals * (2 / truth.inside.shape[0])
    outer = ~(_occupied(truth.inside, found + step) & _occupied(truth.inside, found - step))
    if outer.any():
        found, normals = found[outer], normals[outer]
    return _standing(truth, found[:points], normals[:points])


def grid_surface(shape: Standing, points: int = POINTS) -> Surface | None:
    """Return points spread evenly over the surface at the shape's level (marching cubes); None for an empty shape."""
    if shape.empty:
        return None
    vertices, faces = shape.surface
    return _standing(shape, *_spread(vertices[faces], points))


def _spread(corners: Float[np.ndarray, "faces 3 3"], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ``count`` points, uniform over the area of the triangles, and their normals; always the same ones."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    rng = np.random.default_rng(0)
    area = np.cumsum(length)
    face = np.searchsorted(area, rng.random(count) * area[-1], side="right").clip(max=len(area) - 1)
    root, along = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    a, b, c = corners[face].transpose(1, 0, 2)
    points = (1 - root) * a + root * ((1 - along) * b + along * c)
    return points, normals[face] / np.maximum(length[face], 1e-30)[:, None]


def _occupied(inside: Bool[np.ndarray, "depth height width"], points: np.ndarray) -> Bool[np.ndarray, " points"]:
    side = inside.shape[0]
    index = np.floor((points + 1) * side / 2).astype(int)
    within = ((index >= 0) & (index < side)).all(1)
    x, y, z = index.clip(0, side - 1).T
    return inside[z, y, x] & within


def _standing(shape: Standing, points: np.ndarray, normals: np.ndarray) -> Surface:
    """Return own points and normals in the camera frame; its matrix is a rotation, perhaps mirrored, times a scale."""
    turned = normals @ shape.matrix.T
    return Surface(shape.to_camera(points), turned / np.maximum(np.linalg.norm(turned, axis=1), 1e-30)[:, None])


def compare_surfaces(found: Surface | None, truth: Surface, longest: float) -> dict[str, float]:
    """Return chamfer (in ``longest``), f_score and normal_consistency of two surfaces."""
    if found is None:
        return dict(NOTHING)
    to_truth, nearest_true = truth.nearest_to(found)
    to_found, nearest_found = found.nearest_to(truth)
    precision, recall = ((away <= THRESHOLD * longest).mean() for away in (to_truth, to_found))
    cosines = [
        np.abs((found.normals * truth.normals[nearest_true]).sum(1)).mean(),
        np.abs((truth.normals * found.normals[nearest_found]).sum(1)).mean(),
    ]
    return {
        "chamfer": float((to_truth.mean() + to_found.mean()) / 2 / longest),
        "f_score": float(2 * precision * recall / max(precision + recall, 1e-12)),
        "normal_consistency": float(np.mean(cosines)),
    }
