"""Lifted shapes as an ``.npz``: grids and where they stand, readable without pickle."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.saving import replacing
from uplift.shapes.prediction import ShapePrediction

__all__ = ["write_npz"]


def write_npz(prediction: ShapePrediction, path: str | Path) -> None:
    """Write what a `ShapePrediction` holds under the same names; the same shapes give the same bytes.

    ``occupancy`` (items depth height width) is float16, 0..1 at the centres of the voxels of the own cube,
    indices along z, y, x. A point p of the own frame is at scale * (view @ p) + (offset, 0) in the camera
    frame, in units of the mask's crop; ``scale_px`` of these are pixels, from ``centre_px``.
    """
    arrays = {
        "occupancy": prediction.occupancy.astype(np.float16),
        "view": np.asarray(prediction.view, np.float32),
        "scale": np.asarray(prediction.scale, np.float32),
        "offset": np.asarray(prediction.offset, np.float32),
        "distance": np.asarray(prediction.distance, np.float32),
        "names": np.asarray(prediction.names, np.str_),
        "centre_px": np.asarray(prediction.centre_px, np.float32),
        "scale_px": np.asarray(prediction.scale_px, np.float32),
        "masks": np.asarray(prediction.masks, np.uint8),
        "level": np.asarray(prediction.level, np.float32),
    }
    if prediction.images is not None:
        arrays["images"] = np.asarray(prediction.images, np.str_)
    with replacing(path) as handle:
        np.savez_compressed(handle, allow_pickle=False, **arrays)
