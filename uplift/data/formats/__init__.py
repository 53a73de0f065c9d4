"""Formats of keypoint files, one a file; `read` tells which one a file is in and reads it."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.poses import PoseData
from uplift.errors import UserError, nearest

__all__ = ["FORMAT", "FORMATS", "as_told", "format_named", "guess_format", "read"]

# All formats that keypoints come in, the most telling first: the first that fits a file reads it.

FORMATS: dict[str, str] = {
    # JSON, folders of it, and labels in text files
    "coco": "uplift.data.formats.coco",
    "openpose": "uplift.data.formats.openpose",
    "mmpose": "uplift.data.formats.mmpose",
    "kinetics_skeleton": "uplift.data.formats.kinetics",
    "alphapose": "uplift.data.formats.alphapose",
    "coco_results": "uplift.data.formats.coco_results",
    "mpii_json": "uplift.data.formats.mpii_json",
    "alphatracker": "uplift.data.formats.alphatracker",
    "ultralytics_json": "uplift.data.formats.ultralytics_json",
    "ultralytics": "uplift.data.formats.ultralytics",
    # tables, HDF5, and npz files of others
    "deeplabcut": "uplift.data.formats.deeplabcut",
    "mediapipe": "uplift.data.formats.mediapipe",
    "videopose3d": "uplift.data.formats.videopose3d",
    "csv": "uplift.data.formats.csv",
    "sleap_slp": "uplift.data.formats.sleap",
    "sleap_h5": "uplift.data.formats.sleap_analysis",
    "nwb": "uplift.data.formats.nwb",
    "jabs": "uplift.data.formats.jabs",
    "npz": "uplift.data.formats.npz",
}
"""Name of a format -> the module whose ``FORMAT`` it is."""


@cache
def format_named(name: str) -> Format:
    """Return a format of `FORMATS`."""
    return import_module(FORMATS[name]).FORMAT


# One keypoint file format per file; `read` tells which it is and reads it.

_ENDING = {"ultralytics": ".txt"}
"""Of the files in a folder, where it is not .json."""
_NOT_KEYPOINTS = {
    (".mp4", ".avi", ".mov", ".mkv", ".webm"): "a video. Run a tracker on it first, and give its output",
    (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp"): "a picture. Run a tracker on it first, and give its output",
    (".trc", ".c3d"): "3D marker data, no 2D keypoints; it can be no input of a lifter",
    (".bvh", ".asf", ".amc"): "3D motion capture; `uplift data cmu` makes keypoints of it",
    (".glb", ".gltf", ".obj", ".ply", ".stl"): "a 3D model, no keypoints",
    (".pt", ".pth", ".ckpt", ".onnx", ".safetensors"): "the weights of a network, no keypoints",
}  # fmt: skip


def read(path: str | Path, options: ReadOptions | None = None) -> PoseData:
    """Read a file or folder of keypoints, in the format that it is found or said to be in.

    `PoseData.notes` say which format that was, and what was assumed.

    Raises:
        UserError: no such file, no known format, or a file that is not what it looks like.
    """
    options = options or ReadOptions()
    path = Path(path)
    found = guess_format(path) if options.format is None else _named(path, options.format)
    data = found.read(path, options)
    if found.name != "npz":  # the layout of this project needs no word
        told = f"read as {found.title}" + ("" if options.format else f" (guessed; format={found.name})")
        data = replace(data, notes=(told, *data.notes))
    kinds = Counter(child.suffix.lower() for child in path.iterdir() if child.is_file()) if path.is_dir() else Counter()
    if found.name != "npz" and len(kinds) > 1 and (others := kinds.total() - kinds[_ENDING.get(found.name, ".json")]):
        data = replace(data, notes=(*data.notes, f"{others} files of other kinds in the folder were left out"))
    return as_told(replace(data, source=data.source or str(path)), options)


def guess_format(path: str | Path) -> Format:
    """Return the first format that the file or folder looks like.

    Raises:
        UserError: no such file, an empty one, or one of no known format.
    """
    peek = Peek(path)
    for name in FORMATS:
        if format_named(name).fits(peek):
            return format_named(name)
    known = f"Known formats: {', '.join(FORMATS)} (docs/trackers.md); format=NAME says which it is."
    for endings, what in _NOT_KEYPOINTS.items():
        if peek.ending in endings:
            raise UserError(f"{path} is {what}.")
    if peek.is_hdf5 and not peek.hdf5_names:
        raise UserError(
            f'{path} is HDF5 and cannot be looked into: damaged, or h5py is missing (pip install "uplift3d[trackers]").'
        )
    if not peek.is_folder:
        shown = repr(peek.text[:60] or peek.start[:16])
        raise UserError(f"{path} is a file of no known format (it begins {shown}). {known}")
    inside = sorted(child.name for child in peek.path.iterdir())
    if not inside:
        raise UserError(f"{path} is an empty folder, expected files of keypoints in it.")
    hint = (
        f" Several files of one format go as a pattern, such as {path}/*{Path(inside[0]).suffix}."
        if len(inside) > 1
        else ""
    )
    more = ", ..." if len(inside) > 3 else ""
    raise UserError(f"{path} is a folder of no known format (in it: {', '.join(inside[:3])}{more}).{hint} {known}")


def _named(path: Path, name: str) -> Format:
    if name not in FORMATS:
        raise UserError(f"format={name}: no such format.{nearest(name, FORMATS)} Known: {', '.join(FORMATS)}.")
    Peek(path)
    return format_named(name)


def as_told(data: PoseData, options: ReadOptions) -> PoseData:
    """Return ``data`` with what the user says of it in place of what the file says."""
    told = {name: getattr(options, name) for name in ("image_size", "fps", "focal_px")}
    data = replace(data, **{name: value for name, value in told.items() if value is not None})
    if options.min_confidence > 0:
        weak = (data.confidence > 0) & ~(data.confidence >= options.min_confidence)
        data = replace(data, confidence=np.where(weak, np.float32(0), data.confidence))
        if weak.any():
            said = f"{int(weak.sum()):,} keypoints of confidence below {options.min_confidence:g} are taken as missing"
            data = replace(data, notes=(*data.notes, said))
    return data
