"""What the floors learn from: a part of the training truth in the camera frame, with each mask's extrusion."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from uplift.evaluation.shape_evaluator import filled_truths
from uplift.evaluation.shape_standing import Standing, true, voxel_centres
from uplift.masks.container import MaskData, Placed

__all__ = ["TrainingTruth", "extrusion", "mask_half", "training_truth"]


@dataclass(frozen=True)
class TrainingTruth:
    """True shapes on one grid of the camera frame, the cube of -1 to 1 of the crop, centroids at depth 0."""

    inside: Bool[np.ndarray, "items depth height width"]
    extruded: Bool[np.ndarray, "items depth height width"]
    """What projects into the item's mask."""
    volume: Float[np.ndarray, " items"]
    """True volumes in voxels of the grid, with what lies outside it."""
    half: Float[np.ndarray, " items"]
    """Half of the longer side of each mask's box, in units of the crop."""
    distance: float
    """Of the camera: the median."""

    @property
    def resolution(self) -> int:
        """Voxels along the grid."""
        return self.inside.shape[-1]


def training_truth(train: MaskData, truth: Placed, count: int, resolution: int, seed: int) -> TrainingTruth:
    """Return ``count`` items of the training set, chosen by ``seed``, or all where there are no more."""
    rows = np.arange(len(train))
    if len(rows) > count:
        rows = np.sort(np.random.default_rng(seed).choice(rows, count, replace=False))
    distance = float(np.median(truth.distance))
    inside = np.zeros((len(rows), resolution, resolution, resolution), bool)
    volume = np.zeros(len(rows))
    place = {int(row): at for at, row in enumerate(rows)}
    for row, filled in filled_truths(truth, rows, resolution):
        shape = true(truth, row, filled)
        inside[place[row]] = _on_grid(shape, resolution)
        volume[place[row]] = shape.volume * (resolution / 2) ** 3
    return TrainingTruth(
        inside=inside,
        extruded=np.stack([extrusion(train.masks[row], distance, resolution) > 0.5 for row in rows]),
        volume=volume,
        half=np.array([mask_half(train.masks[row]) for row in rows]),
        distance=distance,
    )


def _on_grid(shape: Standing, resolution: int) -> Bool[np.ndarray, "depth height width"]:
    """Return the shape on the camera frame's grid, its centroid at depth 0."""
    return shape.moved(-shape.depth).inside_at(voxel_centres(resolution), np.eye(3), np.zeros(3))


def extrusion(mask: np.ndarray, distance: float, resolution: int) -> Float[np.ndarray, "depth height width"]:
    """Return how much of the ray through each voxel centre of the crop's cube the mask (0 to 255) covers, 0 to 1."""
    flat = _seen_at(float(distance), resolution)
    covered = torch.from_numpy(mask.astype(np.float32) / 255)[None, None]
    found = torch.nn.functional.grid_sample(covered, flat, align_corners=False)
    return found.reshape(resolution, resolution, resolution).numpy()


@functools.lru_cache(2)
def _seen_at(distance: float, resolution: int) -> Float[Tensor, "one rows columns 2"]:
    """Return where each voxel centre of the crop's cube is seen."""
    points = voxel_centres(resolution)
    image = points[..., :2] / (1 + points[..., 2:] / distance).clamp_min(0.05)
    return image.reshape(1, resolution * resolution, resolution, 2)


def mask_half(mask: np.ndarray) -> float:
    """Return half of the longer side of the mask's box, in units of the crop; 0 for an empty mask."""
    found = [np.flatnonzero((mask > 127).any(axis)) for axis in (0, 1)]
    return max((float(f[-1] - f[0] + 1) for f in found if len(f)), default=0.0) / mask.shape[0]
