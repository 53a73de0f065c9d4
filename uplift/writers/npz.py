"""Predictions as an ``.npz`` in the layout of the data files, readable without pickle."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from uplift.prediction import Prediction
from uplift.saving import replacing

__all__ = ["write_npz"]

_OLDEST = (1980, 1, 1, 0, 0, 0)


def write_npz(prediction: Prediction, path: str | Path) -> None:
    """Write keypoints, poses, unit, tilt, names, bones and identity; the same poses give the same bytes.

    ``pose`` and ``level_pose`` (frames joints 3) are in ``unit``, relative to the root; ``bones``
    (bones 2) indexes ``joint_names``; ``root`` (frames 3) is its place where that is known. The truth is not written: ``pose`` is the prediction.
    """
    arrays = _arrays(prediction)
    with replacing(path) as handle, zipfile.ZipFile(handle, "w") as archive:
        for name, array in arrays.items():
            _add(archive, name, array)


def _add(archive: zipfile.ZipFile, name: str, array: np.ndarray) -> None:
    entry = zipfile.ZipInfo(f"{name}.npy", date_time=_OLDEST)
    # Names repeat and shrink a hundredfold; floats hardly shrink and would make writing slow.
    entry.compress_type = zipfile.ZIP_DEFLATED if array.dtype.kind in "US" else zipfile.ZIP_STORED
    with archive.open(entry, "w", force_zip64=True) as stream:
        np.lib.format.write_array(stream, array, allow_pickle=False)


def _arrays(prediction: Prediction) -> dict[str, np.ndarray]:
    arrays = {
        "keypoints": np.asarray(prediction.keypoints, np.float32),
        "confidence": np.asarray(prediction.confidence, np.float32),
        "joint_names": np.asarray(prediction.joint_names, np.str_),
        "pose": np.asarray(prediction.pose, np.float32),
        "level_pose": np.asarray(prediction.level_pose, np.float32),
        "unit": np.asarray(prediction.unit),
        "bones": prediction.bone_indices,
        "skeleton": np.asarray(prediction.skeleton.name),
        "axes": np.asarray(prediction.axes),
    }
    optional = {
        "tilt_deg": (prediction.tilt_deg, np.float32),
        "spread": (prediction.spread, np.float32),
        "root": (prediction.root, np.float32),
        "filled": (prediction.filled, np.bool_),
        "fps": (prediction.fps, np.float32),
        "image_size": (prediction.image_size, np.int64),
    }
    arrays |= {name: np.asarray(value, kind) for name, (value, kind) in optional.items() if value is not None}
    for name, values in prediction.identity.items():
        if name in arrays:
            raise ValueError(f"prediction: identity '{name}' would overwrite the array of that name")
        values = np.asarray(values)
        arrays[name] = values.astype(np.str_) if values.dtype.kind == "O" else values
    return arrays
