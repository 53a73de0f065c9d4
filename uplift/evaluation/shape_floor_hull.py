"""The floor `hull`: the visual hull of one view, every mask extruded along its rays by one share of its size."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from uplift.evaluation.shape_training import TrainingTruth, extrusion, mask_half

__all__ = ["best_thickness", "hull_occupancy"]

_THICKNESSES = np.linspace(0.02, 1.2, 60)


def best_thickness(train: TrainingTruth) -> float:
    """Return the thickness, in the longer side of the mask's box, with the best mean volume IoU on the training truth.

    Source: the visual hull of Laurentini (1994) from one silhouette, which bounds no depth, cut to a slab.
    """
    middle = (2 * np.arange(train.resolution) + 1) / train.resolution - 1
    layer = np.argsort(np.abs(middle), kind="stable")
    reach = np.concatenate([[0], np.sort(np.abs(middle))[1::2] + 1 / train.resolution])
    ious = np.zeros(len(_THICKNESSES))
    for inside, extruded, volume, half in zip(train.inside, train.extruded, train.volume, train.half, strict=True):
        both = (inside & extruded).sum((1, 2))[layer]
        hull = extruded.sum((1, 2))[layer]
        shared, own = (
            np.interp(_THICKNESSES * half, reach, np.concatenate([[0], x.cumsum()[1::2]])) for x in (both, hull)
        )
        ious += shared / np.maximum(own + volume - shared, 1e-12)
    return float(_THICKNESSES[ious.argmax()])


def hull_occupancy(
    mask: np.ndarray, distance: float, thickness: float, resolution: int
) -> Float[np.ndarray, "depth height width"]:
    """Return the slab of the mask's extrusion on the crop's cube: its surface is where the occupancy is 0.5."""
    depth = np.abs((2 * np.arange(resolution) + 1) / resolution - 1)
    slab = np.clip((thickness * mask_half(mask) - depth) * resolution / 2 + 0.5, 0, 1)
    return np.minimum(extrusion(mask, distance, resolution), slab[:, None, None]).astype(np.float32)
