"""The npz layout of "your own data": keypoints, joint names, and whatever else is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from uplift.config.files import replacing
from uplift.data.formats import KEYPOINT_FORMATS, checked, read
from uplift.data.formats.base import FileFormat, ReadOptions
from uplift.data.formats.shards import Shards
from uplift.data.parsers.files import bytes_of
from uplift.data.parsers.npz import CheckedArrays, array_headers, first_rows, read_arrays
from uplift.data.parsers.pictures import PHOTO_ENDINGS
from uplift.data.poses import IDENTITY_KEYS, UNITS, PoseData, masks_of
from uplift.errors import UserError, listed
from uplift.geometry.gravity import angle_deg, gravity_at, roll_of, tilt_of

__all__ = [
    "FORMAT",
    "KNOWN",
    "camera_of",
    "contents_of",
    "joint_names_of",
    "memory_of",
    "poses_of",
    "read_npz",
    "refuse_other_axes",
    "unit_of",
    "write_keypoints",
]

# Read the npz layout of "your own data": keypoints, joint names, and whatever else is known.

KNOWN = {
    "keypoints", "confidence", "joint_names", "pose", "root", "unit", "fps", "image_size", "focal_px",
    "bones", "tilt_deg", "roll_deg", "gravity", "level_pose", "uncertainty", "spread", "filled", "hypotheses", "weights",
    "ground_point", "ground_normal", "contact",
    "axes", "skeleton", "masks", "mask_box",
    *IDENTITY_KEYS,
}  # fmt: skip


def read_npz(path: str | Path, image_size: tuple[int, int] | None = None) -> PoseData:
    """Read an npz file of the documented layout (docs/your-data.md) into a `PoseData`.

    Raises:
        UserError: missing or unknown arrays, wrong types or shapes, arrays of different lengths.
    """
    return poses_of(str(path), read_arrays(path, KNOWN, others=False), image_size)


def poses_of(where: str, arrays: dict[str, np.ndarray], image_size: tuple[int, int] | None = None) -> PoseData:
    """Return the `PoseData` of arrays of that layout; ``where`` they are from, for messages.

    Raises:
        UserError: missing arrays, wrong types, shapes or ranges, arrays of different lengths.
    """
    file = CheckedArrays(where, arrays)
    for needed in ("keypoints", "joint_names"):
        if needed not in arrays:
            raise UserError(
                f"{where}: no array '{needed}' (found: {listed(sorted(arrays)) or 'nothing'}). Expected at "
                "least 'keypoints' (frames, joints, 2) in pixels and 'joint_names' (joints,)."
            )
    refuse_other_axes(where, arrays)
    keypoints = file.floats("keypoints", (None, None, 2))
    assert keypoints is not None  # it is one of the needed
    frames, joints = keypoints.shape[:2]
    masks, mask_box = masks_of(where, arrays, frames)
    tilt_deg, gravity = camera_of(file, frames)
    data = PoseData(
        keypoints=keypoints,
        confidence=_confidence(file, (frames, joints)),
        joint_names=joint_names_of(where, arrays),
        pose=file.floats("pose", (frames, joints, 3)),
        root=file.floats("root", (frames, 3)),
        unit=unit_of(where, arrays, "mm"),
        identity=_identity(where, arrays, frames),
        fps=_scalar(where, arrays, "fps"),
        image_size=image_size or _image_size(where, arrays),
        tilt_deg=tilt_deg,
        gravity=gravity,
        masks=masks,
        mask_box=mask_box,
        source=where,
    )
    each = arrays["focal_px"].shape == (frames,) if frames > 1 and "focal_px" in arrays else False
    if each:
        return data.with_focal_px(_positive(where, arrays, "focal_px"))
    return replace(data, focal_px=_scalar(where, arrays, "focal_px"))


def joint_names_of(where: str, arrays: dict[str, np.ndarray]) -> tuple[str, ...]:
    """Return the joint names of a file's arrays; raises UserError where they are not a list of text."""
    names = arrays["joint_names"]
    if names.ndim != 1 or names.dtype.kind not in "US":
        raise UserError(f"{where}: 'joint_names' is {names.dtype} of shape {names.shape}, expected text (joints,).")
    return tuple(n.decode(errors="replace") if isinstance(n, bytes) else str(n) for n in names)


_AGREES_DEG = 1.0
"""By how much the gravity of a file may differ from its tilt and roll."""


def camera_of(file: CheckedArrays, frames: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return the cameras' `tilt_deg` (frames,) and `gravity` (frames 3) of a file; None for what it does not say.

    Gravity is the file's, or follows from `tilt_deg` and `roll_deg`; the tilt is the file's, or that of gravity.

    Raises:
        UserError: a roll without a tilt, a gravity of length 0, or one that says another tilt or roll than the file.
    """
    tilt_deg, roll_deg = (file.floats(name, (frames,)) for name in ("tilt_deg", "roll_deg"))
    gravity = file.floats("gravity", (frames, 3))
    if gravity is None:
        if roll_deg is not None and tilt_deg is None:
            raise UserError(f"{file.where}: 'roll_deg' without 'tilt_deg', expected both, or 'gravity' (frames, 3).")
        return tilt_deg, None if roll_deg is None or tilt_deg is None else _float32(gravity_at(tilt_deg, roll_deg))
    size = np.linalg.norm(gravity, axis=1, keepdims=True)
    if (size == 0).any():
        row = int(np.argmin(size))
        raise UserError(
            f"{file.where}: 'gravity' is 0 in row {row}, expected a direction in the camera's frame, or NaN."
        )
    gravity = gravity / size
    tilt, roll = tilt_of(gravity), roll_of(gravity)
    angles = gravity_at(tilt if tilt_deg is None else tilt_deg, roll if roll_deg is None else roll_deg)
    off = angle_deg(gravity, angles)
    if (off > _AGREES_DEG).any():
        row = int(np.nanargmax(off))
        raise UserError(
            f"{file.where}: 'gravity' says a tilt of {tilt[row]:.1f} and a roll of {roll[row]:.1f} degrees in row {row}, "
            f"'tilt_deg' or 'roll_deg' another: tilt is asin(z), roll atan2(-x, y) of gravity. Leave one of them out."
        )
    return _float32(tilt) if tilt_deg is None else tilt_deg, gravity


def _float32(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32)


def refuse_other_axes(where: str, arrays: dict[str, np.ndarray]) -> None:
    """Raise UserError for poses that are not in the camera's axes (`uplift.export.scene`)."""
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


def _confidence(file: CheckedArrays, shape: tuple[int, int]) -> np.ndarray:
    confidence = file.floats("confidence", shape)
    return np.ones(shape, np.float32) if confidence is None else confidence


def _identity(where: str, arrays: dict[str, np.ndarray], frames: int) -> dict[str, np.ndarray]:
    """Return what the frames are of; sequences named as photos are, without frame numbers, are images.

    The people in one photo are not a clip of one body.
    """
    found = {key: arrays[key] for key in IDENTITY_KEYS if key in arrays}
    found = {key: np.repeat(array, frames) if array.ndim == 0 else array for key, array in found.items()}
    for name, array in found.items():
        if array.shape != (frames,):
            raise UserError(
                f"{where}: '{name}' has shape {array.shape}, expected ({frames},) as 'keypoints' has frames."
            )
        found[name] = _column(where, name, array)
    names = found.get("sequence")
    if names is None or names.dtype.kind != "U" or not frames or {"frame", "image"} & set(found):
        return found
    if not all(name.lower().endswith(PHOTO_ENDINGS) for name in names.tolist()):
        return found
    return {"image" if key == "sequence" else key: values for key, values in found.items()}


def _column(where: str, key: str, values: np.ndarray) -> np.ndarray:
    """Return what the frames are of as text or numbers; raises UserError for anything else."""
    if values.dtype.kind == "O" and all(isinstance(value, str) for value in values):
        values = values.astype(str)
    if values.dtype.kind == "S":
        values = np.char.decode(values, "utf-8", "replace")
    kinds, expected = ("iuf", "numbers") if key == "frame" else ("iufUb", "text or numbers")
    if values.dtype.kind not in kinds or (values.dtype.kind == "f" and not np.isfinite(values).all()):
        shown = "not finite" if values.dtype.kind in kinds else f"{values.dtype}"
        raise UserError(f"{where}: '{key}' is {shown}, expected {expected} (frames,).")
    return values


def _positive(where: str, arrays: dict, name: str) -> np.ndarray:
    array = arrays[name].ravel()
    if array.dtype.kind not in "fiu" or not array.size or not (np.isfinite(array) & (array > 0)).all():
        raise UserError(f"{where}: '{name}' is {arrays[name]!r}, expected one positive number.")
    return array


def _scalar(where: str, arrays: dict, name: str) -> float | None:
    if name not in arrays:
        return None
    array = _positive(where, arrays, name)
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


FORMAT = FileFormat(
    "npz",
    "uplift's own npz",
    lambda peek: peek.ending == ".npz",  # the last to be asked: its errors say in full what is wrong
    lambda peek, options: read_npz(peek.path, options.image_size),
)


# Write a `PoseData` in the npz layout of "your own data".


def write_keypoints(data: PoseData, path: str | Path) -> None:
    """Write every array that ``data`` has; `uplift.data.formats.npz.read_npz` reads it back the same."""
    arrays: dict[str, np.ndarray] = {
        "keypoints": data.keypoints.astype(np.float32),
        "confidence": data.confidence.astype(np.float32),
        "joint_names": np.array(data.joint_names),
        "unit": np.array(data.unit),
        **data.identity,
    }
    for name in ("pose", "root", "tilt_deg", "gravity"):
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


# What a file of keypoints holds: of an npz out of its headers alone, little loaded but the joint names.

_PER_JOINT = {"keypoints": 2, "pose": 3}  # numbers of four bytes, whatever the file has
_PER_FRAME = {"root": 3, "tilt_deg": 1, "gravity": 3}
_NUMBER = 2
"""Bytes a frame of a column of text, which becomes numbers of names."""
_FIRST = 2000
"""Frames that are looked at for the scale of their numbers."""


@dataclass(frozen=True)
class _Contents:
    """What a reader would make of a file."""

    frames: int
    joint_names: tuple[str, ...]
    has_pose: bool
    memory: int
    """Bytes of the arrays."""
    read_as: str = ""
    """The note on the format; empty for an npz of this project."""


def contents_of(path: Path, options: ReadOptions | None = None) -> _Contents:
    """Return what the file at ``path`` holds: out of the headers of an npz of this project, of others by reading them.

    Raises:
        UserError: it is damaged, or of no known format.
    """
    options = options or ReadOptions()
    format = options.format or KEYPOINT_FORMATS.guess(path).name
    if format == "shards":
        shards = Shards(path)
        return _Contents(
            len(shards), shards.facts["joint_names"], shards.has_pose, shards.size, "read as uplift's shards"
        )
    if format != "npz":
        data = read(path, options)
        arrays = {name for name in ("pose", "root", "tilt_deg", "gravity") if getattr(data, name) is not None}
        memory = memory_of(arrays, len(data), len(data.joint_names))
        identity = sum(values.nbytes for values in data.identity.values())
        read_as = next((note for note in data.notes if note.startswith("read as ")), "")
        return _Contents(len(data), data.joint_names, data.pose is not None, memory + identity, read_as)
    small, headers = read_arrays(path, ("joint_names",)), array_headers(path)
    shape = headers["keypoints"][0] if "keypoints" in headers else ()
    if "joint_names" not in small or len(shape) != 3:
        raise UserError(f"{path}: 'keypoints' (frames, joints, 2) and 'joint_names' are needed (docs/your-data.md).")
    frames, joints = shape[:2]
    names = joint_names_of(str(path), small)
    if len(names) != joints:
        raise UserError(f"{path}: {len(names)} joint names for {joints} joints in 'keypoints'.")
    _check_scales(path, small, set(headers), options)
    columns = (headers[key] for key in IDENTITY_KEYS if key in headers)
    identity = sum(_NUMBER * frames if dtype.kind == "U" else bytes_of(shape, dtype) for shape, dtype in columns)
    return _Contents(frames, names, "pose" in headers, memory_of(set(headers), frames, joints) + identity)


def _check_scales(path: Path, small: dict[str, np.ndarray], names: set[str], options: ReadOptions) -> None:
    """Raise UserError where the first frames are in no pixels, or of no confidence that is known."""
    size = read_arrays(path, ("image_size",)) if "image_size" in names else {}
    start = {name: first_rows(path, name, _FIRST) for name in ("keypoints", "confidence") if name in names}
    checked(poses_of(str(path), {**small, **size, **start}), options)


def memory_of(arrays: set[str], frames: int, joints: int) -> int:
    """Return the bytes of what a reader makes of these arrays; a confidence there always is."""
    numbers = joints * (1 + sum(count for name, count in _PER_JOINT.items() if name in arrays))
    return 4 * frames * (numbers + sum(count for name, count in _PER_FRAME.items() if name in arrays))
