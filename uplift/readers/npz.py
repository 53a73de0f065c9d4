"""Read the npz layout of "your own data": keypoints, joint names, and whatever else is known."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np

from uplift.data.container import IDENTITY_KEYS, PoseData
from uplift.errors import UserError, did_you_mean

__all__ = ["read_arrays", "read_npz"]

_KNOWN = {
    "keypoints", "confidence", "joint_names", "pose", "root", "unit", "fps", "image_size", "focal_px",
    "bones", "tilt_deg", "level_pose", "spread", *IDENTITY_KEYS,
}  # fmt: skip
_MAX_HEADER_BYTES = 10_000


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Read every array of an npz file, after checking that it is what it claims to be.

    No pickle is ever opened, and no memory is taken before each array's header has been held
    against the bytes that are really there.

    Raises:
        UserError: not a file, not an npz, damaged, pickled, or larger than the memory at hand.
    """
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path} is a folder, expected an .npz file.")
    if not path.is_file():
        raise UserError(f"No file {path} (looked in {path.absolute().parent}).")
    if path.stat().st_size == 0:
        raise UserError(f"{path} is empty (0 bytes), expected an .npz file with at least 'keypoints'.")
    try:
        with zipfile.ZipFile(path) as archive:
            _check_sizes(path, archive)
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except zipfile.BadZipFile as error:
        raise UserError(f"{path} is not a whole .npz file ({error}): truncated, or another format?") from error
    except (ValueError, EOFError, OSError, KeyError, NotImplementedError, RuntimeError) as error:
        raise UserError(f"{path} cannot be read as .npz: {error}") from error


def _check_sizes(path: Path, archive: zipfile.ZipFile) -> None:
    total = 0
    for member in archive.infolist():
        if not member.filename.endswith(".npy"):
            raise UserError(f"{path}: holds '{member.filename}', expected only arrays (.npy) in an .npz file.")
        with archive.open(member) as file:
            try:
                version = np.lib.format.read_magic(file)
                read = (
                    np.lib.format.read_array_header_1_0
                    if version == (1, 0)
                    else np.lib.format.read_array_header_2_0
                )
                shape, _, dtype = read(file, max_header_size=_MAX_HEADER_BYTES)
            except ValueError as error:
                raise UserError(f"{path}: array '{member.filename}' is damaged: {error}") from error
            header = file.tell()
        name = member.filename.removesuffix(".npy")
        if dtype.hasobject:
            raise UserError(
                f"{path}: '{name}' holds pickled Python objects, which could run code and are never "
                "opened. Save plain numbers or text: np.savez(file, keypoints=array.astype('float32'), ...)."
            )
        claimed = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
        if claimed != member.file_size - header:
            raise UserError(
                f"{path}: '{name}' claims {claimed:,} bytes but holds {member.file_size - header:,}: damaged file."
            )
        total += claimed
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if total > memory // 2:
        raise UserError(
            f"{path}: would take {total / 1e9:.1f} GB, more than half of this machine's memory "
            f"({memory / 1e9:.1f} GB). Split it into smaller files."
        )


def read_npz(path: str | Path) -> PoseData:
    """Read an npz file of the documented layout (docs/your-data.md) into a `PoseData`.

    Raises:
        UserError: missing or unknown arrays, wrong types or shapes, arrays of different lengths.
    """
    arrays = read_arrays(path)
    where = str(path)
    for needed in ("keypoints", "joint_names"):
        if needed not in arrays:
            raise UserError(
                f"{where}: no array '{needed}' (found: {', '.join(sorted(arrays)) or 'nothing'}). Expected at "
                "least 'keypoints' (frames, joints, 2) in pixels and 'joint_names' (joints,)."
            )
    for name in arrays:
        if name not in _KNOWN:
            raise UserError(f"{where}: unknown array '{name}'.{did_you_mean(name, sorted(_KNOWN))}")
    keypoints = _numbers(where, arrays, "keypoints", (None, None, 2))
    frames, joints = keypoints.shape[:2]
    confidence = _numbers(where, arrays, "confidence", (frames, joints))
    names = arrays["joint_names"]
    if names.ndim != 1 or names.dtype.kind not in "US":
        raise UserError(f"{where}: 'joint_names' is {names.dtype} of shape {names.shape}, expected text (joints,).")
    return PoseData(
        keypoints=keypoints,
        confidence=np.ones((frames, joints), np.float32) if confidence is None else confidence,
        joint_names=tuple(n.decode() if isinstance(n, bytes) else str(n) for n in names),
        pose=_numbers(where, arrays, "pose", (frames, joints, 3)),
        root=_numbers(where, arrays, "root", (frames, 3)),
        unit=str(arrays["unit"]) if "unit" in arrays else "mm",
        identity={key: _identity(where, arrays, key, frames) for key in IDENTITY_KEYS if key in arrays},
        fps=_scalar(where, arrays, "fps"),
        image_size=_image_size(where, arrays),
        focal_px=_scalar(where, arrays, "focal_px"),
        tilt_deg=_numbers(where, arrays, "tilt_deg", (frames,)),
        source=where,
    )


def _numbers(where: str, arrays: dict, name: str, shape: tuple[int | None, ...]):
    """Return ``arrays[name]`` as float32 after checking type and shape, None where absent."""
    if name not in arrays:
        return None
    array = arrays[name]
    wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
    if array.dtype.kind not in "fiub":
        raise UserError(f"{where}: '{name}' is {array.dtype}, expected numbers of shape {wanted}.")
    if array.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, array.shape, strict=True)
    ):
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


def _scalar(where: str, arrays: dict, name: str) -> float | None:
    if name not in arrays:
        return None
    array = arrays[name]
    if array.size != 1 or array.dtype.kind not in "fiu" or not float(array.reshape(())) > 0:
        raise UserError(f"{where}: '{name}' is {array!r}, expected one positive number.")
    return float(array.reshape(()))


def _image_size(where: str, arrays: dict) -> tuple[int, int] | None:
    if "image_size" not in arrays:
        return None
    array = arrays["image_size"]
    if array.shape != (2,) or array.dtype.kind not in "fiu" or not (array > 0).all():
        raise UserError(f"{where}: 'image_size' is {array!r}, expected two positive numbers (width, height) in px.")
    return int(array[0]), int(array[1])
