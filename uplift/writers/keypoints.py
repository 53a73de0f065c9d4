"""Write a `PoseData` in the npz layout of "your own data"."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.saving import replacing

__all__ = ["write_keypoints"]


def write_keypoints(data: PoseData, path: str | Path) -> None:
    """Write every array that ``data`` has; `uplift.readers.npz.read_npz` reads it back the same."""
    arrays: dict[str, np.ndarray] = {
        "keypoints": data.keypoints.astype(np.float32),
        "confidence": data.confidence.astype(np.float32),
        "joint_names": np.array(data.joint_names),
        "unit": np.array(data.unit),
        **data.identity,
    }
    for name in ("pose", "root", "tilt_deg"):
        value = getattr(data, name)
        if value is not None:
            arrays[name] = value.astype(np.float32)
    if data.masks is not None and data.mask_box is not None:
        arrays |= {"masks": data.masks, "mask_box": data.mask_box.astype(np.float32)}
    for name in ("fps", "focal_px", "image_size"):
        value = getattr(data, name)
        if value is not None:
            arrays[name] = np.asarray(value)
    with replacing(path) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
