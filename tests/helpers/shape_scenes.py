"""Small true shapes made of boxes, and their placement."""

from __future__ import annotations

import numpy as np
import torch

from uplift.data.masks import FILL, MaskData, Placed
from uplift.geometry.mesh import Mesh
from uplift.geometry.rotation import about_y, level
from uplift.metrics.evaluate_shapes import filled_truths
from uplift.metrics.shape_metrics import silhouette, true
from uplift.models.prediction import ShapePrediction

SIDE = 40
"""Voxels along the grids of the tests."""

_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def box(low, high) -> Mesh:
    """Return a box with triangles anticlockwise from outside."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    return Mesh(np.array(low) + corners * (np.array(high) - np.array(low)), _FACES)


def union(*parts: Mesh, category: str = "") -> Mesh:
    """Return the parts as one normalised mesh; they may overlap."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)])
    return Mesh(np.concatenate([part.vertices for part in parts]), faces, category=category).in_unit()


def chair(width: float = 1.0, back: float = 1.0) -> Mesh:
    """Return a seat, a back, and a block of legs under the front half: not symmetric in depth."""
    half = width / 2
    seat = box((-half, 0, -0.5), (half, 0.2, 0.5))
    rest = box((-half, -back, 0.25), (half, 0.1, 0.5))
    legs = box((-half, 0.1, -0.5), (half, 0.8, -0.2))
    return union(seat, rest, legs, category="chair")


def views(azimuth_deg, tilt_deg: float = 20.0) -> np.ndarray:
    """Return views of a camera that tilts down."""
    azimuth = torch.deg2rad(torch.as_tensor(azimuth_deg, dtype=torch.float64))
    return (level(torch.full_like(azimuth, np.radians(tilt_deg))).mT @ about_y(azimuth)).numpy()


def placed(meshes, shape, azimuth_deg, tilt_deg: float = 20.0, distance: float = np.inf) -> Placed:
    """Return items whose bounding boxes fill the crop like those of masks (for parallel rays)."""
    view = views(azimuth_deg, tilt_deg)
    scale, offset = np.ones(len(shape)), np.zeros((len(shape), 2))
    for item, of in enumerate(shape):
        image = meshes[of].vertices @ view[item].T
        low, high = image[:, :2].min(0), image[:, :2].max(0)
        scale[item] = 2 * FILL / (high - low).max()
        offset[item] = -scale[item] * (low + high) / 2
    return Placed(meshes, np.array(shape), view, scale, offset, np.full(len(shape), float(distance)))


def grids(truth: Placed, resolution: int = SIDE) -> np.ndarray:
    """Return each item's true shape, filled."""
    found = np.zeros((len(truth), resolution, resolution, resolution), np.float32)
    for row, filled in filled_truths(truth, np.arange(len(truth)), resolution):
        found[row] = filled
    return found


def masks_of(truth: Placed) -> MaskData:
    """Return the items' masks at 64 pixels, with the truth."""
    masks = np.zeros((len(truth), 64, 64), np.uint8)
    for row, filled in filled_truths(truth, np.arange(len(truth)), SIDE):
        seen = silhouette(true(truth, row, filled), 2 / 64)
        image = np.zeros((256, 256), np.uint8)
        top, left = seen.row + 128, seen.column + 128
        image[top : top + seen.covered.shape[0], left : left + seen.covered.shape[1]] = 255 * seen.covered
        masks[row] = image[96:160, 96:160]
    names = [f"item {row}" for row in range(len(truth))]
    return MaskData(masks, names, np.zeros((len(truth), 2)), np.ones(len(truth)), truth=truth)


def prediction_of(truth: Placed, masks: np.ndarray, occupancy: np.ndarray | None = None) -> ShapePrediction:
    """Return the truth as a prediction, optionally with another occupancy."""
    return ShapePrediction(
        grids(truth) if occupancy is None else occupancy, truth.view, truth.scale, truth.offset, truth.distance,
        masks, [f"item {row}" for row in range(len(truth))], np.zeros((len(truth), 2)), np.ones(len(truth)),
    )  # fmt: skip
