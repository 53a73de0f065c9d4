"""What a file of keypoints holds: of an npz out of its headers alone, nothing loaded but the joint names."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uplift.data.container import IDENTITY_KEYS, PoseData
from uplift.errors import UserError
from uplift.readers import ReadOptions, guess_format, read
from uplift.readers.archive import read_arrays
from uplift.readers.npz import joint_names_of

__all__ = ["Contents", "contents_of", "memory_of"]

_PER_JOINT = {"keypoints": 2, "pose": 3}  # numbers of four bytes, whatever the file has
_PER_FRAME = {"root": 3, "tilt_deg": 1}


@dataclass(frozen=True)
class Contents:
    """What a reader would make of a file."""

    frames: int
    joint_names: tuple[str, ...]
    has_pose: bool
    memory: int
    """Bytes of the arrays."""


def contents_of(path: Path, options: ReadOptions | None = None) -> Contents:
    """Return what the file at ``path`` holds: out of the headers of an npz of this project, of others by reading them.

    Raises:
        UserError: it is not whole, or of no known format.
    """
    options = options or ReadOptions()
    if (options.format or guess_format(path).name) != "npz":
        data = read(path, options)
        arrays = {name for name in ("pose", "root", "tilt_deg") if getattr(data, name) is not None}
        memory = memory_of(arrays, len(data), len(data.joint_names))
        return Contents(len(data), data.joint_names, data.pose is not None, memory + _bytes(data))
    small = read_arrays(path, ("joint_names",))  # also holds every header against the bytes that are there
    shapes, stored = _headers(path)
    shape = shapes.get("keypoints", ())
    if "joint_names" not in small or len(shape) != 3:
        raise UserError(f"{path}: 'keypoints' (frames, joints, 2) and 'joint_names' are needed (docs/your-data.md).")
    frames, joints = shape[:2]
    names = joint_names_of(str(path), small)
    if len(names) != joints:
        raise UserError(f"{path}: {len(names)} joint names for {joints} joints in 'keypoints'.")
    identity = sum(stored[key] for key in IDENTITY_KEYS if key in stored)
    return Contents(frames, names, "pose" in shapes, memory_of(set(shapes), frames, joints) + identity)


def _bytes(data: PoseData) -> int:
    return sum(values.nbytes for values in data.identity.values())


def memory_of(arrays: set[str], frames: int, joints: int) -> int:
    """Return the bytes of what a reader makes of these arrays; a confidence there always is."""
    numbers = joints * (1 + sum(count for name, count in _PER_JOINT.items() if name in arrays))
    return 4 * frames * (numbers + sum(count for name, count in _PER_FRAME.items() if name in arrays))


def _headers(path: Path) -> tuple[dict[str, tuple[int, ...]], dict[str, int]]:
    """Return shape and bytes of each array of an npz that was found whole."""
    shapes, stored = {}, {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as file:
                version = np.lib.format.read_magic(file)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shapes[name] = read(file)[0]
            stored[name] = member.file_size
    return shapes, stored
