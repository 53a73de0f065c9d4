"""What every reader shares: a first look at a file, what the user says about it, and how a format is described."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["Format", "Peek", "ReadOptions", "need", "size_of"]

_START = 65_536
_HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class ReadOptions:
    """What a user says of a file that the file does not say itself; each wins over what the file says."""

    format: str | None = None
    """Name of the format; unset: guessed."""
    layout: str | None = None
    """Skeleton (shipped name or YAML) whose joints, in its order and without midpoints, name keypoints that have no names."""
    image_size: tuple[int, int] | None = None
    """Width and height of the image or video, px."""
    fps: float | None = None
    """Frames a second."""
    focal_px: float | None = None
    """Focal length of the camera, px."""
    min_confidence: float = 0.0
    """Keypoints of less confidence count as missing."""

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        for name in ("fps", "focal_px"):
            value = getattr(self, name)
            if value is not None and not (0 < value < 1e9):
                raise UserError(f"{name}={value}: expected a positive number.")
        if not 0 <= self.min_confidence <= 1:
            raise UserError(f"min_confidence={self.min_confidence}: expected a share from 0 to 1.")

    def set_names(self) -> list[str]:
        """Return the names of the options that differ from their defaults."""
        return [item.name for item in fields(self) if getattr(self, item.name) != item.default]


class Peek:
    """The first look at a file or folder, for guessing its format: never the whole file, never an exception.

    Raises:
        UserError: nothing there, or an empty file.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not self.path.exists():
            raise UserError(f"No file {self.path} (looked in {self.path.absolute().parent}).")
        self.is_folder = self.path.is_dir()
        self.ending = "" if self.is_folder else self.path.suffix.lower()
        self.start = b""
        """The first 64 KiB of a file."""
        if not self.is_folder:
            with self.path.open("rb") as file:
                self.start = file.read(_START)
            if not self.start:
                raise UserError(f"{self.path} is empty (0 bytes), expected keypoints.")

    @cached_property
    def text(self) -> str:
        """The start as text; nothing where it is none."""
        if b"\0" in self.start:
            return ""
        return self.start.decode("utf-8-sig", errors="replace")

    @cached_property
    def lines(self) -> list[str]:
        """The whole lines of the start, without their ends."""
        found = self.text.splitlines()
        return found if len(self.start) < _START else found[:-1]

    @cached_property
    def json_sign(self) -> str:
        """``{`` or ``[`` where the file looks like JSON, nothing otherwise."""
        sign = self.text.lstrip()[:1]
        return sign if sign in ("{", "[") else ""

    @cached_property
    def json_keys(self) -> tuple[str, ...]:
        """The keys of the JSON object, or of the first object of the list, as far as the start shows them, in order."""
        return tuple(_keys_at_the_top(self.text)) if self.json_sign else ()

    @cached_property
    def is_hdf5(self) -> bool:
        """Whether the file is HDF5."""
        return self.start.startswith(_HDF5)

    @cached_property
    def hdf5_names(self) -> tuple[str, ...]:
        """The names at the root of an HDF5 file; nothing for others, or where h5py is not installed."""
        if not self.is_hdf5:
            return ()
        try:
            import h5py

            with h5py.File(self.path, "r") as file:
                return tuple(file.keys())
        except (ImportError, OSError, RuntimeError, ValueError, KeyError):
            return ()

    @cached_property
    def npz_names(self) -> tuple[str, ...]:
        """The names of the arrays of an npz file; nothing for others."""
        if not self.start.startswith(b"PK"):
            return ()
        try:
            with zipfile.ZipFile(self.path) as archive:
                return tuple(n.removesuffix(".npy") for n in archive.namelist())
        except (zipfile.BadZipFile, OSError, NotImplementedError):
            return ()

    def first_file(self, pattern: str) -> Path | None:
        """Return the first file, by name, of a folder that fits ``pattern``; None where there is none."""
        return min(self.path.glob(pattern), default=None) if self.is_folder else None


@dataclass(frozen=True)
class Format:
    """A keypoint format: how to tell it from others, and how to read it."""

    name: str
    """As in ``format=``."""
    title: str
    """What it is, in a few words."""
    fits: Callable[[Peek], bool]
    """Whether a file looks like this format; quick, and never an exception whatever the content."""
    read: Callable[[Path, ReadOptions], PoseData]
    """Reads a whole file; raises UserError for one that is not of this format, or damaged."""


def size_of(text: str, name: str = "image_size") -> tuple[int, int]:
    """Return width and height of a text such as 1920x1080.

    Raises:
        UserError: another text.
    """
    found = re.fullmatch(r"\s*[(\[]?\s*(\d{1,6})\s*[x,]\s*(\d{1,6})\s*[)\]]?\s*", str(text))
    if not found or not all(int(side) for side in found.groups()):
        raise UserError(f"{name}={text!r}: expected width and height in pixels, such as 1920x1080.")
    return int(found[1]), int(found[2])


def need(package: str, extra: str, path: Path) -> UserError:
    """Return the error of a file whose reader needs a package that is not installed."""
    return UserError(f'{path}: reading it needs {package}: pip install "uplift3d[{extra}]".')


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
