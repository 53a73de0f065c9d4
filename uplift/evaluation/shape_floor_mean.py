"""The floor `mean_shape`: the mean of the training shapes in the camera frame, cut at one level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from uplift.evaluation.shape_training import TrainingTruth, extrusion

__all__ = ["MeanShape", "mean_occupancy", "mean_shape"]

_LEVELS = np.linspace(0.02, 0.98, 49)


@dataclass(frozen=True)
class MeanShape:
    """The mean occupancy of training shapes, and how it is cut."""

    mean: Float[np.ndarray, "depth height width"]
    level: float
    in_mask: bool
    """Whether each item's shape is what of it projects into the item's mask."""


def mean_shape(train: TrainingTruth) -> MeanShape:
    """Return the mean of the training shapes, cut at the level and in the way with the best mean volume IoU on them."""
    mean = train.inside.mean(0, dtype=np.float32)
    rank = np.searchsorted(_LEVELS, mean, side="left")  # how many levels lie below each voxel's mean
    ious = np.zeros((2, len(_LEVELS)))
    everywhere = _above(rank)
    for inside, extruded, volume in zip(train.inside, train.extruded, train.volume, strict=True):
        for way, (shared, own) in enumerate(
            [(_above(rank[inside]), everywhere), (_above(rank[inside & extruded]), _above(rank[extruded]))]
        ):
            ious[way] += shared / np.maximum(own + volume - shared, 1e-12)
    way, level = np.unravel_index(ious.argmax(), ious.shape)
    return MeanShape(mean, float(_LEVELS[level]), bool(way))


def _above(rank: np.ndarray) -> np.ndarray:
    """Return how many of the voxels are above each level."""
    return np.bincount(rank.ravel(), minlength=len(_LEVELS) + 1)[::-1].cumsum()[::-1][1:]


def mean_occupancy(found: MeanShape, mask: np.ndarray, distance: float) -> Float[np.ndarray, "depth height width"]:
    """Return the mean shape for one mask, scaled so that its surface is where the occupancy is 0.5."""
    occupancy = np.minimum(found.mean / (2 * found.level), 1)
    if found.in_mask:
        occupancy = np.minimum(occupancy, extrusion(mask, distance, found.mean.shape[-1]))
    return occupancy.astype(np.float32)
