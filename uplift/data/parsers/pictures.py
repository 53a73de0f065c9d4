"""Pictures: their files and sizes, their pixels as numbers, and the photos that masks belong to."""

from __future__ import annotations

import os
import struct
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from uplift.config.files import inside
from uplift.data.parsers.json import in_order
from uplift.data.parsers.outlines import MAX_PIXELS
from uplift.errors import UserError

__all__ = ["ENDINGS", "PHOTO_ENDINGS", "Photos", "Picture", "PictureError", "Place", "open_picture", "pictures_of"]

_DAMAGE = (OSError, ValueError, SyntaxError, EOFError, IndexError, KeyError, TypeError, struct.error, zlib.error)
"""What Pillow raises on a damaged picture; memory that runs out is not the picture's fault."""

PHOTO_ENDINGS = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff")
ENDINGS = (*PHOTO_ENDINGS, ".gif", ".pgm", ".pbm", ".ppm")
_KINDS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "GIF", "PPM")
_LUMINANCE = np.array([299, 587, 114])
_JPEG_HUE = 24
"""Grey saved as a colour JPEG comes back with channels that differ by a few levels."""


class PictureError(Exception):
    """Why a picture cannot be used: a key of `uplift.data.clean_masks.REASONS`."""


@dataclass(frozen=True)
class Picture:
    """One picture's numbers."""

    values: np.ndarray
    """(height width): grey levels, alpha, or ids; a colour's id is red + 256 green + 65536 blue."""
    alpha: bool = False
    """Whether the values are an alpha channel that says what is there."""
    lossy: bool = False
    """Whether values are near what was saved, and not exactly that."""
    shades: np.ndarray | None = None
    """(height width) how bright each pixel looks, where the values are ids."""


def open_picture(path: Path) -> Picture:
    """Return a picture's numbers; of several frames, the first.

    Raises:
        PictureError: not a picture, damaged, or of more than `MAX_PIXELS`; half of them in colours or of 32 bits.
    """
    if not path.is_file():  # a pipe or a device, which may never end
        raise PictureError("unreadable")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures: refused below, before anything is decoded
            with Image.open(path, formats=_KINDS) as image:
                pixels = image.width * image.height
                if pixels > MAX_PIXELS:
                    raise PictureError("huge")
                if pixels > MAX_PIXELS // 2 and (len(image.getbands()) > 1 or image.mode in ("I", "F")):
                    raise PictureError("wide")
                image.load()
                return _numbers(image, image.format in ("JPEG", "WEBP"))
    except Image.DecompressionBombError:
        raise PictureError("huge") from None
    except _DAMAGE:
        raise PictureError("unreadable") from None


def _numbers(image: Image.Image, lossy: bool) -> Picture:
    if image.mode == "P":
        return _palette(image)
    if "A" in image.getbands():
        alpha = np.asarray(image.getchannel("A"))
        if alpha.size and alpha.min() < alpha.max():
            return Picture(alpha, alpha=True)
        image = image.convert("L" if image.mode.startswith("L") else "RGB")
    if image.mode in ("1", "L"):
        return Picture(np.asarray(image, np.uint8), lossy=lossy)
    if image.mode.startswith("I"):
        return Picture(np.maximum(np.asarray(image), 0))  # 16 bits and more
    if image.mode == "F":
        return Picture(np.nan_to_num(np.asarray(image), nan=0.0, posinf=0.0, neginf=0.0))
    return _colours(image.convert("RGB"), lossy)


def _palette(image: Image.Image) -> Picture:
    """Return a palette picture's ids, or its grey levels where all its colours are grey."""
    ids = np.asarray(image)
    used = np.flatnonzero(image.histogram())
    transparent = image.info.get("transparency")
    colours = np.zeros((256, 3), np.int64)
    table = np.array(image.getpalette("RGB") or [], np.int64)[: 3 * 256].reshape(-1, 3)
    colours[: len(table)] = table
    if transparent is not None and len(used) > 2:
        alpha = np.asarray(image.convert("RGBA").getchannel("A"))
        if alpha.min() < alpha.max() and len(used) > 32:  # a drawing cut out, not a palette of labels
            return Picture(alpha, alpha=True)
    if (colours[used] == colours[used][:, :1]).all() and len(np.unique(colours[used, 0])) == len(used):
        return Picture(colours[:, 0].astype(np.uint8)[ids])
    return Picture(ids, shades=_shades(colours)[ids])


def _colours(image: Image.Image, lossy: bool) -> Picture:
    """Return a colour picture's grey levels where it has no colours, else their ids."""
    red, green, blue = (np.asarray(image.getchannel(name)) for name in "RGB")
    spread = np.maximum(np.maximum(red, green), blue) - np.minimum(np.minimum(red, green), blue)
    if spread.max(initial=0) <= (_JPEG_HUE if lossy else 0):
        return Picture(green, lossy=lossy)
    shades = np.empty_like(green)
    for row in range(len(green)):  # row by row: as wide numbers all of it would take much memory
        shades[row] = _shades(np.stack([red[row], green[row], blue[row]], -1))
    if lossy:
        return Picture(shades, lossy=True)
    ids = blue.astype(np.int32)
    for channel in (green, red):
        ids <<= 8
        ids |= channel
    return Picture(ids, shades=shades)


def _shades(colours: np.ndarray) -> np.ndarray:
    """Return how bright colours look, 0..255."""
    return ((colours.astype(np.int32) @ _LUMINANCE.astype(np.int32)) // 1000).astype(np.uint8)


class Photos:
    """The pictures in the folder given as ``images=``; without one, those in the folder of the file that names them.

    A name that leads out of that folder, by itself or over links, is left out: a stranger's file shows no other photo.

    Raises:
        UserError: no such folder, or no picture in it.
    """

    def __init__(self, folder: str | None):
        self.folder = None if folder is None else Path(folder)
        self.missing = 0
        """Photos that were asked for and do not exist."""
        self.elsewhere: list[str] = []
        """Names that lead out of the folder."""
        self._files: dict[str, str] = {}
        if self.folder is None:
            return
        if not self.folder.is_dir():
            raise UserError(f"images={folder}: no such folder (looked in {self.folder.absolute().parent}).")
        for path in sorted(self.folder.rglob("*")):
            if path.suffix.lower() in ENDINGS:
                inside = path.relative_to(self.folder)
                for key in (inside.as_posix(), path.name, inside.with_suffix("").as_posix(), path.stem):
                    self._files.setdefault(key, str(path))
        if not self._files:
            raise UserError(f"images={folder}: no picture in that folder.")

    def of_name(self, name: str, file: Path) -> str:
        """Return the photo that ``file`` names so; nothing where it is not in the folder."""
        if self.folder is not None:
            return self._found(name, Path(name).name)
        return self._inside(file if file.is_dir() else file.parent, name) if name else ""

    def of_mask(self, name: str) -> str:
        """Return the photo named as a mask is, apart from the ending; nothing without a folder of photos."""
        if self.folder is None:
            return ""
        bare = Path(name).with_suffix("")
        return self._found(bare.as_posix(), bare.name)

    def notes(self) -> list[str]:
        """Return a note on photos that are missing, if any."""
        notes = [f"{self.missing:,} masks have no photo in {self.folder}"] if self.missing else []
        if self.elsewhere:
            where = "beside the file that names them" if self.folder is None else f"in {self.folder}"
            named = f"{len(self.elsewhere):,} photos, such as {self.elsewhere[0][:80]!r}"
            notes.append(f"{named}, are not {where} and are left out: images=FOLDER says where photos are")
        return notes

    def _found(self, *keys: str) -> str:
        photo = next((self._files[key] for key in keys if key in self._files), "")
        self.missing += not photo
        return self._inside(self.folder, os.path.relpath(photo, self.folder)) if photo and self.folder else ""

    def _inside(self, folder: Path, name: str) -> str:
        found = inside(folder, name)
        if found is None:
            self.elsewhere.append(name)
        return "" if found is None else str(found)


@dataclass(frozen=True)
class Place:
    """Where one picture is."""

    path: Path
    name: str
    category: str
    """The subfolder, or the folder where several were given."""


def pictures_of(paths: list[Path]) -> tuple[list[Place], list[str]]:
    """Return the pictures that paths name, folders with all their sub-folders, and the names of other files beside them.

    A file that is named is taken for a picture whatever its ending.
    """
    folders = [path for path in paths if path.is_dir()]
    found: list[Place] = []
    others: list[str] = []
    for path in paths:
        if not path.is_dir():
            found.append(Place(path, path.name, ""))
            continue
        for file in _files(path):
            inside = file.relative_to(path)
            if file.suffix.lower() not in ENDINGS:
                others.append(inside.as_posix())
                continue
            parts = (path.absolute().name, *inside.parts) if len(folders) > 1 else inside.parts
            found.append(Place(file, "/".join(parts), "/".join(parts[:-1])))
    return found, others


def _files(folder: Path) -> list[Path]:
    """Return the files in a folder and in those below it, their numbers in order; hidden ones left out."""
    found: list[Path] = []
    for at, folders, names in os.walk(folder):
        folders[:] = sorted((one for one in folders if not one.startswith((".", "__"))), key=in_order)
        found += [Path(at, name) for name in sorted(names, key=in_order) if not name.startswith(".")]
    return found
