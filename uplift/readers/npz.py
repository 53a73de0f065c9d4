"""Read the npz layout of "your own data": keypoints, joint names, and whatever else is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.body_masks import masks_of
from uplift.data.container import IDENTITY_KEYS, UNITS, PoseData
from uplift.errors import UserError
from uplift.readers.archive import read_arrays
from uplift.readers.base import Format, Peek, ReadOptions

__all__ = ["FORMAT", "joint_names_of", "read_npz", "refuse_other_axes", "unit_of"]

_KNOWN = {
    "keypoints", "confidence", "joint_names", "pose", "root", "unit", "fps", "image_size", "focal_px",
    "bones", "tilt_deg", "level_pose", "spread", "filled", "axes", "skeleton", "masks", "mask_box",
    *IDENTITY_KEYS,
}  # fmt: skip
_PHOTO_ENDINGS = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff")
_MOST_CONFIDENT = 2.0  # heat maps peak a little over 1, and COCO marks visible joints with 2


def read_npz(path: str | Path) -> PoseData:
    """Read an npz file of the documented layout (docs/your-data.md) into a `PoseData`.

    Raises:
        UserError: missing or unknown arrays, wrong types or shapes, arrays of different lengths.
    """
    arrays = read_arrays(path, _KNOWN, others=False)
    where = str(path)
    for needed in ("keypoints", "joint_names"):
        if needed not in arrays:
            raise UserError(
                f"{where}: no array '{needed}' (found: {', '.join(sorted(arrays)) or 'nothing'}). Expected at "
                "least 'keypoints' (frames, joints, 2) in pixels and 'joint_names' (joints,)."
            )
    refuse_other_axes(where, arrays)
    keypoints = _numbers(where, arrays, "keypoints", (None, None, 2))
    assert keypoints is not None  # it is one of the needed
    frames, joints = keypoints.shape[:2]
    masks, mask_box = masks_of(where, arrays, frames)
    return PoseData(
        keypoints=keypoints,
        confidence=_confidence(where, arrays, (frames, joints)),
        joint_names=joint_names_of(where, arrays),
        pose=_numbers(where, arrays, "pose", (frames, joints, 3)),
        root=_numbers(where, arrays, "root", (frames, 3)),
        unit=unit_of(where, arrays, "mm"),
        identity=_photos({key: _identity(where, arrays, key, frames) for key in IDENTITY_KEYS if key in arrays}),
        fps=_scalar(where, arrays, "fps"),
        image_size=_image_size(where, arrays),
        focal_px=_scalar(where, arrays, "focal_px"),
        tilt_deg=_numbers(where, arrays, "tilt_deg", (frames,)),
        masks=masks,
        mask_box=mask_box,
        source=where,
    )


def joint_names_of(where: str, arrays: dict[str, np.ndarray]) -> tuple[str, ...]:
    """Return the joint names of a file's arrays; raises UserError where they are no list of text."""
    names = arrays["joint_names"]
    if names.ndim != 1 or names.dtype.kind not in "US":
        raise UserError(f"{where}: 'joint_names' is {names.dtype} of shape {names.shape}, expected text (joints,).")
    return tuple(n.decode(errors="replace") if isinstance(n, bytes) else str(n) for n in names)


def refuse_other_axes(where: str, arrays: dict[str, np.ndarray]) -> None:
    """Raise UserError for poses that are not in the camera's axes (`uplift.axes`)."""
    axes = str(arrays["axes"].reshape(-1)[0]) if "axes" in arrays and arrays["axes"].size else "camera"
    if axes not in ("camera", "opencv"):
        raise UserError(f"{where}: its poses are in the axes '{axes}', expected the camera's: predict without axes=.")


def unit_of(where: str, arrays: dict[str, np.ndarray], default: str) -> str:
    """Return the unit of a file's poses; raises UserError for one that is not known."""
    if "unit" not in arrays:
        return default
    unit = arrays["unit"]
    if unit.size != 1 or str(unit.reshape(())) not in UNITS:
        shown = repr(str(unit.reshape(()))) if unit.size == 1 else f"of shape {unit.shape}"
        raise UserError(f"{where}: 'unit' is {shown}, expected one of {', '.join(UNITS)}: convert lengths to mm.")
    return str(unit.reshape(()))


def _confidence(where: str, arrays: dict, shape: tuple[int, int]) -> np.ndarray:
    confidence = _numbers(where, arrays, "confidence", shape)
    if confidence is None:
        return np.ones(shape, np.float32)
    most = np.max(confidence, initial=0, where=np.isfinite(confidence))
    if most > _MOST_CONFIDENT:
        raise UserError(f"{where}: 'confidence' goes up to {most:g}, expected 0..1: divide percentages by 100.")
    return confidence


def _numbers(where: str, arrays: dict, name: str, shape: tuple[int | None, ...]) -> np.ndarray | None:
    """Return ``arrays[name]`` as float32 after checking type and shape, None where absent."""
    if name not in arrays:
        return None
    array = arrays[name]
    wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
    if array.dtype.kind not in "fiub":
        raise UserError(f"{where}: '{name}' is {array.dtype}, expected numbers of shape {wanted}.")
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        raise UserError(f"{where}: '{name}' has shape {array.shape}, expected {wanted}.")
    with np.errstate(over="ignore"):
        return array.astype(np.float32)


def _identity(where: str, arrays: dict, name: str, frames: int) -> np.ndarray:
    array = arrays[name]
    if array.ndim == 0:
        array = np.repeat(array, frames)
    if array.shape != (frames,):
        raise UserError(f"{where}: '{name}' has shape {array.shape}, expected ({frames},) as 'keypoints' has frames.")
    return array


def _photos(identity: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return sequences that are named as photos are, and have no frame numbers, as `image`.

    The people in one photo are no clip of one body.
    """
    names = identity.get("sequence")
    if names is None or names.dtype.kind != "U" or not len(names) or {"frame", "image"} & set(identity):
        return identity
    if not all(name.lower().endswith(_PHOTO_ENDINGS) for name in names.tolist()):
        return identity
    return {"image" if key == "sequence" else key: values for key, values in identity.items()}


def _scalar(where: str, arrays: dict, name: str) -> float | None:
    if name not in arrays:
        return None
    array = arrays[name].ravel()
    if array.dtype.kind not in "fiu" or not array.size or not (np.isfinite(array) & (array > 0)).all():
        raise UserError(f"{where}: '{name}' is {arrays[name]!r}, expected one positive number.")
    if (array != array[0]).any():
        raise UserError(f"{where}: '{name}' goes from {array.min():g} to {array.max():g}, expected one number a file.")
    return float(array[0])


def _image_size(where: str, arrays: dict) -> tuple[int, int] | None:
    if "image_size" not in arrays:
        return None
    array = arrays["image_size"]
    if array.shape != (2,) or array.dtype.kind not in "fiu" or not (np.isfinite(array) & (array > 0)).all():
        raise UserError(f"{where}: 'image_size' is {array!r}, expected two positive numbers (width, height) in px.")
    return int(array[0]), int(array[1])


def _fits(peek: Peek) -> bool:
    return peek.ending == ".npz"  # the last to be asked: whatever is wrong with it is told in full


def _read(path: Path, options: ReadOptions) -> PoseData:
    return read_npz(path)


FORMAT = Format("npz", "uplift's own npz", _fits, _read)
