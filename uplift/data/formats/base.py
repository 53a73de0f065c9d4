"""What formats of files share: a first look at a file, what a user says about it, and the registry that picks a format."""

from __future__ import annotations

import heapq
import json
import os
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from uplift.config.files import refuse_special
from uplift.data.parsers.files import HDF5_START, encoding_of
from uplift.data.parsers.json import JSON_LINES, is_json
from uplift.errors import UserError, nearest

__all__ = ["FileFormat", "Formats", "Peek", "ReadOptions", "size_of"]

Options = TypeVar("Options", bound=Any)
"""`ReadOptions` for keypoints, `uplift.data.clean_masks.MaskOptions` for masks."""
Data = TypeVar("Data", bound=Any)
"""`uplift.data.poses.PoseData` or `uplift.data.masks.MaskData`."""


@dataclass(frozen=True)
class FileFormat(Generic[Options, Data]):
    """A format of keypoints or masks: how to tell it from others, and how to read it."""

    name: str
    """As in ``format=``."""
    title: str
    """What it is, in a few words."""
    fits: Callable[[Peek], bool]
    """Whether a file looks like this format; quick, and never an exception whatever the content."""
    read: Callable[[Peek, Options], Data]
    """Reads everything; raises UserError for what is not of this format, damaged, or empty."""
    ending: str = ""
    """Of the files that are read of a folder; a note counts the others."""
    coordinates: Literal["px", "shares", "placed"] = "px"
    """What keypoints are in: pixels; shares of the image as often as not, of a square one where its size is not known;
    or the reader sees to it itself."""


class Formats(Mapping[str, FileFormat[Options, Data]]):
    """The formats of one kind of data by name, the most specific first: the first that fits a file reads it."""

    def __init__(self, what: str, places: dict[str, str], own: str):
        """``what`` is "keypoints" or "masks"; ``places`` say ``module:NAME`` of each `FileFormat`, imported when asked for.

        ``own`` says it of a function that makes a `FileFormat` of a user's class, given its name and the option.
        """
        self.what, self._places, self._own = what, places, own

    def __getitem__(self, name: str) -> FileFormat[Options, Data]:
        return _imported(self._places[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def named(self, name: str, where: str = "format") -> FileFormat[Options, Data]:
        """Return the format that a user names in the option ``where``, of this package or a class of the user's own.

        Raises:
            UserError: an unknown name, no such file or class, or a class that is no format.
        """
        if name in self:
            return self[name]
        if ":" in name:
            return _imported(self._own)(name, where)
        own = "Your own is file.py:Class or package.module:Class"
        if name.endswith(".py"):
            raise UserError(f"{where}={name}: which class of that file? {own}.")
        raise UserError(f"{where}={name}: no such format.{nearest(name, self)} Known: {', '.join(self)}. {own}.")

    def guess(self, peek: Peek | str | Path) -> FileFormat[Options, Data]:
        """Return the first format that the file or folder looks like.

        Raises:
            UserError: no such file, an empty one, one of no known format, or files of several kinds.
        """
        peek = peek if isinstance(peek, Peek) else Peek(peek)
        endings = sorted({path.suffix.lower() for path in peek.paths if not path.is_dir()} & {".json", ".npz"})
        if endings and any(path.is_dir() or path.suffix.lower() != endings[0] for path in peek.paths):
            raise UserError(f"{peek.where} are files of several kinds. Give those of one kind at a time.")
        for found in self.values():
            if found.fits(peek):
                return found
        raise _unknown(peek, self)

    def chosen(self, peek: Peek, options: Options) -> FileFormat[Options, Data]:
        """Return the format that is named, or the first that fits; raises UserError as `named` and `guess`."""
        return self.guess(peek) if options.format is None else self.named(options.format)

    def read(self, peek: Peek, options: Options, found: FileFormat[Options, Data] | None = None) -> Data:
        """Read what was given, in the format ``found`` (unset: as `chosen`); the notes say which that is."""
        found = found or self.chosen(peek, options)
        if peek.is_empty:
            raise UserError(f"{peek.path} is empty (0 bytes), expected {self.what}.")
        data = found.read(peek, options)
        if found.name == "npz":  # the layout of this project needs no note
            return data
        guessed = "" if options.format else f" (guessed; format={found.name})"
        notes = (f"read as {found.title}{guessed}", *data.notes)
        if found.ending and peek.is_folder:
            right = Counter(one.name.lower().endswith(found.ending) for one in peek.path.iterdir() if one.is_file())
            others = right[False]
            if right[True] and others:
                notes += (f"{others} files of other kinds in the folder were left out",)
        return replace(data, notes=notes)


def _imported(place: str) -> Any:
    """Return what ``place``, a ``module:NAME``, names."""
    module, _, attribute = place.partition(":")
    return getattr(import_module(module), attribute)


_VIDEOS, _MODELS = ".mp4 .avi .mov .mkv .webm", ".glb .gltf .obj .ply .stl .off"
_WEIGHTS, _ARCHIVES = ".pt .pth .ckpt .onnx .safetensors", ".zip .tar .gz .tgz .7z"
_OTHERS = {
    "keypoints": {
        _VIDEOS: "a video. Run a tracker on it first, and give its output",
        ".png .jpg .jpeg .webp .tif .tiff .bmp .gif": "a picture. Run a tracker on it first, and give its output",
        ".trc .c3d": "3D marker data without 2D keypoints, which cannot be lifted",
        ".bvh .asf .amc": "3D motion capture; `uplift data cmu` makes keypoints of it",
        _MODELS: "a 3D model without keypoints",
        _WEIGHTS: "the weights of a network, not keypoints",
        _ARCHIVES: "an archive. Unpack it, and give a file in it",
    },
    "masks": {
        _VIDEOS: "a video. Cut its objects out first, and give the masks as pictures",
        ".csv .h5 .slp .nwb .trc .c3d .bvh .asf .amc": "a file of keypoints or motion, not of masks",
        _MODELS: "a 3D model, not masks; `uplift data render` makes masks of models",
        _WEIGHTS: "the weights of a network, not masks",
        _ARCHIVES: "an archive. Unpack it, and give the folder",
        ".xml": "XML. Give the pictures of the masks (SegmentationObject in a VOC folder)",
    },
}
"""Endings of files that hold no keypoints or no masks -> what they are instead."""


_SAVE = {
    "keypoints": "np.savez('keypoints.npz', keypoints=..., joint_names=[...]) of (frames, joints, 2) (docs/your-data.md)",
    "masks": "np.savez('masks.npz', masks=...) of (items, rows, columns) (docs/masks-input.md)",
}
_AS_CSV = "save the table as CSV in UTF-8, a row a frame (docs/trackers.md)"
_PICKLE = "a Python pickle: it can run code when it is opened, and so is not. Open it where it was made, and {save}."
_STARTS = {
    (b"\x93NUMPY",): "a bare NumPy array, which names nothing. np.load it, and {save}.",
    (b"\x80\2", b"\x80\3", b"\x80\4", b"\x80\5"): _PICKLE,
    (b"MATLAB 5.0", b"MATLAB 7.3"): "a MATLAB file. In MATLAB writetable(TABLE, 'keypoints.csv'); or in Python "
    "scipy.io.loadmat it (h5py from version 7.3 on), and {save}.",
    (b"\xd0\xcf\x11\xe0",): f"an old Excel file. In Excel, {_AS_CSV}.",
    (b"PAR1", b"ARROW1"): "a Parquet or Feather table. In Python, pandas.read_parquet (or read_feather) and to_csv.",
    (b"SQLite format 3",): f"an SQLite database. From it, {_AS_CSV}.",
    (b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf", b"\x28\xb5\x2f\xfd", b"Rar!"): "compressed. Unpack it.",
    (b"version https://git-lfs",): "a pointer of Git LFS, not the file itself. Fetch that: git lfs pull.",
}
"""What files that are not read begin with -> what they are, and what to do."""
_PACKED = {
    "xl/": f"an Excel file. In Excel, {_AS_CSV}.",
    "content.xml": f"an OpenDocument file. In its program, {_AS_CSV}.",
}
"""The same by what a zip archive has in it."""


def _content_of(peek: Peek, save: str) -> str:
    """Return what a file that is not read holds, by its content, and what to do; nothing where that is not known."""
    text = peek.text.lstrip()[:40].lower()
    known = [instead for starts, instead in _STARTS.items() if peek.start.startswith(starts)]
    known += [what for name, what in _PACKED.items() if any(one.startswith(name) for one in peek.npz_names)]
    known += [_PICKLE] if peek.ending in (".pkl", ".pickle") else []
    if text.startswith(("<!doctype html", "<html")):
        known.append("a web page. Was a link saved in place of the file?")
    elif text.startswith("<?xml"):
        known.append("XML. Export the annotations as COCO (JSON), which CVAT and others can.")
    elif _are_json_lines(peek):
        known.append(f"several JSON values. {JSON_LINES}")
    elif _is_wide(peek.start[:1000]):
        known.append("text in UTF-16 or UTF-32 that does not say so. Save it as UTF-8.")
    return known[0].format(save=save) if known else ""


def _are_json_lines(peek: Peek) -> bool:
    lines = [line for line in peek.lines if line.strip()][:2]
    with suppress(ValueError, RecursionError):
        return len(lines) == 2 and all(isinstance(json.loads(line), dict | list) for line in lines)
    return peek.ending in (".jsonl", ".ndjson")


def _is_wide(start: bytes) -> bool:
    """Return whether half of the bytes are the zeros of letters of two or four bytes."""
    quarters = [start[place::4] for place in range(4)]
    zero = [quarter.count(0) > 0.9 * len(quarter) for quarter in quarters]
    return (
        len(start) >= 16
        and zero[0] != zero[-1]
        and not any(a.count(0) and not z for a, z in zip(quarters, zero, strict=True))
    )


def _unknown(peek: Peek, formats: Formats) -> UserError:
    """Return the error that says what a file or folder of no known format is."""
    path, what = peek.path, formats.what
    for endings, instead in _OTHERS[what].items():
        if peek.ending in endings.split():
            return UserError(f"{path} is {instead}.")
    if peek.is_empty:
        return UserError(f"{path} is empty (0 bytes), expected {what}.")
    if peek.is_hdf5 and not peek.hdf5_names:
        return UserError(
            f'{path} is an HDF5 file that cannot be opened: damaged, or h5py is missing (pip install "uplift3d[trackers]").'
        )
    if instead := _content_of(peek, _SAVE[what]):
        return UserError(f"{path} is {instead}")
    known = f"Known formats: {', '.join(formats)}; format=NAME chooses one."
    if not peek.is_folder:
        content = f"it begins {peek.text[:60] or peek.start[:16]!r}"
        if names := peek.npz_names or peek.json_keys:
            content = f"its {'arrays' if peek.npz_names else 'keys'}: {', '.join(names[:5])}"
        return UserError(f"{path} is not in a known format of {what} ({content}). {known}")
    inside = sorted(child.name for child in path.iterdir())
    if not inside:
        return UserError(f"{path} is an empty folder, expected files of {what} in it.")
    shown = ", ".join(inside[:3]) + (", ..." if len(inside) > 3 else "")
    one = next((name for name in inside if name.endswith((".json", ".npz"))), None)
    hint = f" Several files of one format go as a pattern, such as {path}/*{Path(inside[0]).suffix}."
    if one is not None or len(inside) == 1:
        hint = f" Give a file in it: {path / (one or inside[0])}."
    return UserError(f"{path} is a folder without files of a known format of {what} (in it: {shown}).{hint} {known}")


_START = 65_536
_TRIES = 100
"""Files of a folder that are opened to guess its format."""


@dataclass(frozen=True)
class ReadOptions:
    """What a user says about a file; it takes precedence over what the file says."""

    format: str | None = None
    """Name of the format; unset: guessed."""
    layout: str | None = None
    """Skeleton (shipped name or YAML) whose joints, in its order and without midpoints, name keypoints that have no names."""
    image_size: tuple[int, int] | None = None
    """Width and height of the image or video, px."""
    fps: float | None = None
    """Frames a second."""
    focal_px: float | str | Mapping[str, float] | None = None
    """Focal length of the camera, px; of several, a text or mapping of `focal_lengths`."""
    min_confidence: float = 0.0
    """Keypoints of less confidence count as missing."""
    flip_x: bool = False
    """x is counted from the right side of the image (`uplift.data.turned`)."""
    flip_y: bool = False
    """y is counted from the bottom of the image."""
    rotate: int = 0
    """Degrees clockwise by which the image is turned to stand upright, after the flips: 0, 90, 180 or 270."""

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if self.fps is not None and not (0 < self.fps < 1e9):
            raise UserError(f"fps={self.fps}: expected a positive number.")
        if self.focal_px is not None:
            object.__setattr__(self, "focal_px", focal_lengths(self.focal_px))
        if not 0 <= self.min_confidence <= 1:
            raise UserError(f"min_confidence={self.min_confidence}: expected a share from 0 to 1.")
        if self.rotate not in (0, 90, 180, 270):
            raise UserError(f"rotate={self.rotate}: expected 0, 90, 180 or 270 degrees clockwise.")

    def set_names(self) -> list[str]:
        """Return the names of the options that differ from their defaults."""
        return [item.name for item in fields(self) if getattr(self, item.name) != item.default]


class Peek:
    """The first look at a file, a folder or several files, for guessing their format: never a complete file.

    Raises:
        UserError: nothing there.
    """

    def __init__(self, paths: str | Path | Sequence[Path]):
        self.paths = [Path(paths)] if isinstance(paths, str | Path) else list(paths)
        self.path = self.paths[0]
        for path in self.paths:
            refuse_special(path)
        if not self.path.exists():
            raise UserError(f"No file {self.path} (looked in {self.path.absolute().parent}).")
        self.is_folder = self.path.is_dir()
        self.ending = "" if self.is_folder else self.path.suffix.lower()
        self.start = b""
        """The first 64 KiB of the first file."""
        if not self.is_folder:
            with self.path.open("rb") as file:
                self.start = file.read(_START)

    @property
    def where(self) -> str:
        """The paths, short, for messages."""
        return str(self.path) if len(self.paths) == 1 else f"{self.path} and {len(self.paths) - 1:,} more"

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing in the first file; an empty picture is a damaged one among others."""
        return not (self.start or self.is_folder or self.pictures)

    @cached_property
    def pictures(self) -> list[Any]:
        """The pictures that the paths mean; none where one of them is another kind of file."""
        from uplift.data.parsers.pictures import ENDINGS, pictures_of

        if any(not path.is_dir() and path.suffix.lower() not in ENDINGS for path in self.paths):
            return []
        return pictures_of(self.paths)[0]

    @cached_property
    def text(self) -> str:
        """The start as text; empty where it is not text."""
        encoding = encoding_of(self.start)
        is_text = encoding == "utf-16" or b"\0" not in self.start
        return self.start.decode(encoding, errors="replace") if is_text else ""

    @cached_property
    def lines(self) -> list[str]:
        """The complete lines of the start, without their ends."""
        return self.text.splitlines()[: -1 if len(self.start) == _START else None]

    @cached_property
    def json_sign(self) -> str:
        """``{`` or ``[`` where the file looks like JSON, nothing otherwise."""
        return self.text.lstrip()[:1] if self.text.lstrip().startswith(("{", "[")) else ""

    @cached_property
    def json_keys(self) -> tuple[str, ...]:
        """The keys of the JSON object, or of the first object of the list, as far as the start shows them, in order."""
        return tuple(_keys_at_the_top(self.text)) if self.json_sign else ()

    @cached_property
    def is_hdf5(self) -> bool:
        """Whether the file is HDF5."""
        return self.start.startswith(HDF5_START)

    @cached_property
    def hdf5_names(self) -> tuple[str, ...]:
        """The names at the root of an HDF5 file; nothing for others, or where h5py is not installed."""
        if not self.is_hdf5:
            return ()
        with suppress(Exception):  # whatever h5py raises: the reader says what is wrong
            import h5py

            with h5py.File(self.path, "r") as file:
                return tuple(map(str, file.keys()))
        return ()

    @cached_property
    def npz_names(self) -> tuple[str, ...]:
        """The names of the arrays of an npz file; nothing for others."""
        if not self.start.startswith(b"PK"):
            return ()
        with suppress(Exception), zipfile.ZipFile(self.path) as archive:  # the reader says what is wrong
            return tuple(n.removesuffix(".npy") for n in archive.namelist())
        return ()

    @cached_property
    def first_json(self) -> Peek:
        """The first look at the first JSON file of a folder that is not an empty list; of no folder, this one."""
        found = self
        with suppress(OSError):
            inside = os.scandir(self.path) if self.is_folder else ()
            for name in heapq.nsmallest(_TRIES, (one.name for one in inside if is_json(one.name))):
                with suppress(UserError, OSError):
                    found = Peek(self.path / name)
                    if found.json_sign and not re.match(r"\s*[\[{]\s*[\]}]\s*$", found.text):
                        return found
        return found


def size_of(text: str, name: str = "image_size") -> tuple[int, int]:
    """Return width and height of a text such as 1920x1080.

    Raises:
        UserError: another text.
    """
    found = re.fullmatch(r"\s*[(\[]?\s*(\d{1,6})\s*[x,]\s*(\d{1,6})\s*[)\]]?\s*", str(text))
    if not found or not all(int(side) for side in found.groups()):
        raise UserError(f"{name}={text!r}: expected width and height in pixels, such as 1920x1080.")
    return int(found[1]), int(found[2])


def focal_lengths(given: float | str | Mapping[str, Any], name: str = "focal_px") -> float | dict[str, float]:
    """Return a focal length in pixels, or those of cameras by their name.

    Several are written ``left:1145,right:1200``, or given as a mapping. A name is that of a camera, sequence or file,
    and may be a pattern, such as ``*_left*``. Raises UserError for anything else.
    """
    several = given
    if isinstance(given, str) and ":" in given:
        several = {camera.strip(): length for camera, _, length in (part.rpartition(":") for part in given.split(","))}
    try:
        if not isinstance(several, Mapping):
            return _focal_length(given)
        if several and all(several):
            return {str(camera): _focal_length(length) for camera, length in several.items()}
        raise ValueError("a length without a camera, or none")
    except (TypeError, ValueError):
        forms = "pixels, such as 1145, or those of several cameras: left:1145,right:1200"
        raise UserError(f"{name}={given}: expected {forms}.") from None


def _focal_length(value: Any) -> float:
    if not 0 < float(value) < 1e9:
        raise ValueError(value)
    return float(value)


_TOKEN = re.compile(r'"((?:[^"\\]|\\.)*)"(\s*:)?|[{}\[\]]')


def _keys_at_the_top(text: str) -> list[str]:
    """Return the keys of the outermost object, or of the first object directly inside the outermost list."""
    keys: list[str] = []
    depth, wanted, listed = 0, 1, False
    for token in _TOKEN.finditer(text):
        sign = token[0]
        if sign in "{[":
            if depth == 0 and sign == "[":
                wanted, listed = 2, True
            depth += 1
        elif sign in "}]":
            depth -= 1
            if depth == 0 or (listed and depth == 1 and keys):
                return keys
        elif depth == wanted and token[2]:
            try:
                keys.append(json.loads(f'"{token[1]}"'))
            except ValueError:
                keys.append(token[1])
    return keys
