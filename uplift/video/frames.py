"""Where frames come from: videos, pictures, folders of pictures and cameras, opened by what their names say."""

from __future__ import annotations

import os
import re
from pathlib import Path

from uplift.config.files import files_of
from uplift.data.parsers.json import in_order
from uplift.errors import UserError, listed
from uplift.video.base import Frame, Frames
from uplift.video.camera import CameraFrames
from uplift.video.pictures import PictureFrames
from uplift.video.video_file import VideoFrames

__all__ = ["PICTURES", "VIDEOS", "Frame", "Frames", "is_frames", "open_frames"]

VIDEOS = (
    ".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts", ".mts", ".m2ts", ".wmv", ".asf", ".flv", ".3gp",
    ".3g2", ".ogv", ".mxf", ".gif",
)  # fmt: skip
PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff", ".heic", ".heif")
_OF_KEYPOINTS = (
    ".json", ".csv", ".tsv", ".h5", ".hdf5", ".slp", ".npz", ".npy", ".mat", ".pkl", ".pickle", ".nwb", ".txt", ".xml",
    ".parquet", ".jsonl",
)  # fmt: skip
"""A folder that has one of these beside its pictures is that of a tracker."""
_CAMERA = re.compile(r"camera:(.+)", re.DOTALL)


def is_frames(source: str | Path) -> bool:
    """Return whether ``source`` names a video, pictures or a camera: by its ending, or by what a folder has in it.

    Of several with commas or a pattern the endings decide. No file is opened.
    """
    text = str(source)
    path = Path(text)
    try:
        if path.is_dir():
            endings = {Path(name).suffix.lower() for name in os.listdir(path) if not name.startswith(".")}
            return not endings.isdisjoint(PICTURES) and endings.isdisjoint(_OF_KEYPOINTS)
    except (OSError, ValueError):  # not to be looked at: whoever opens it says so
        return False
    parts = [text] if path.exists() else [part for part in text.split(",") if part]
    return bool(_CAMERA.fullmatch(text)) or (
        bool(parts) and all(Path(part).suffix.lower() in (*VIDEOS, *PICTURES) for part in parts)
    )


def open_frames(
    source: str | Path, *, start_s: int | float | None = None, end_s: int | float | None = None, as_stored: bool = False
) -> Frames:
    """Open a video, a picture, pictures (a folder, a pattern, several with commas) or a camera, ``camera:0``.

    Args:
        source: where the frames are. Pictures come in the order of the numbers in their names.
        start_s, end_s: the part of a video that is read, seconds from its beginning; numbers of frames stay those of
            the whole. Of a camera, ``end_s`` is how long it is watched; unset, for ever.
        as_stored: number the frames of a video as they are stored, as trackers do, and not by their times; the two
            differ where the frame rate varies.

    Raises:
        UserError: nothing there, not to be read, damaged from the start, without a picture in it, too large; no such
            camera; a cut that has nothing in it; the package that reads videos is absent.
    """
    if camera := _CAMERA.fullmatch(str(source)):
        if start_s is not None:
            raise UserError(f"{source}: video.start_s= goes with a video; a camera begins now.")
        return CameraFrames(str(source), camera[1], end_s)
    if start_s is not None and end_s is not None and end_s <= start_s:
        raise UserError(f"video.end_s={end_s:g} is not after video.start_s={start_s:g}.")
    paths = files_of(source)
    if len(paths) == 1 and paths[0].is_dir():
        paths = _pictures_in(paths[0])
    if len(paths) == 1 and paths[0].suffix.lower() not in PICTURES:
        return VideoFrames(paths[0], start_s or 0.0, end_s, as_stored)
    others = [path.name for path in paths if path.suffix.lower() not in PICTURES]
    if others:
        raise UserError(
            f"{source}: expected one video, or pictures alone, found {listed(others, 3)}. Give one at a time."
        )
    if start_s is not None or end_s is not None:
        raise UserError(f"{source}: video.start_s and video.end_s cut a video, pictures have no times.")
    return PictureFrames(str(source), sorted(paths, key=lambda path: in_order(path.name)))


def _pictures_in(folder: Path) -> list[Path]:
    """Return the pictures of a folder; raises UserError for none."""
    try:
        names = [name for name in os.listdir(folder) if not name.startswith(".")]
    except PermissionError:
        raise UserError(f"{folder}: no permission to read the folder.") from None
    found = [folder / name for name in names if Path(name).suffix.lower() in PICTURES and (folder / name).is_file()]
    if found:
        return found
    videos = [name for name in names if Path(name).suffix.lower() in VIDEOS]
    hint = f" It has videos ({listed(videos, 2)}): give one of them." if videos else ""
    raise UserError(f"{folder}: no picture in this folder. Expected {', '.join(PICTURES[:6])}.{hint}")
