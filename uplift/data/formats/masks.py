"""Formats of mask files: what they share, which there are, and `read`, which tells which one a file is in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from random import Random
from typing import TypeVar

import numpy as np

from uplift.config.files import files_of
from uplift.data.clean_masks import MaskOptions, clean
from uplift.data.formats.base import Peek
from uplift.data.masks import Found, MaskData, Skipped
from uplift.data.parsers.pictures import ENDINGS, Picture, PictureError, Place, open_picture, pictures_of
from uplift.errors import UserError, did_you_mean, nearest

__all__ = [
    "FORMATS",
    "Look",
    "MaskFormat",
    "format_named",
    "gather",
    "guess_format",
    "kind_of",
    "object_of",
    "read",
    "shuffled",
    "wanted",
]

# What a picture is: a mask of one object, labels of several, a photo, or nothing at all.

_FLAT = 0.5
"""Share of a mask's or label image's pixels that are as their four neighbours; a photo has fewer."""
_NEAR = 0.0625
"""Of the span of grey levels: as near as that to black or white is black or white."""
_EXTREME, _EXTREME_LOSSY = 0.85, 0.95
"""Share of a mask's pixels that are black or white; where that is meant more widely, more of them."""
_RINGING = 32
"""Grey levels that a lossy picture may be off by, of 255."""
_CONTRAST = 32
"""Grey levels between black and white, at least, of what a lossy picture shows."""
_REGION = 0.0005
"""Share of the picture that a label covers at least, apart from its edge."""


def kind_of(picture: Picture) -> str:
    """Return ``mask``, ``labels``, ``photo``, or ``blank`` where all pixels are equal."""
    values = picture.values
    if values.size == 0:
        return "blank"
    low, high = values.min(), values.max()
    if low == high or (picture.lossy and float(high) - float(low) < _CONTRAST):
        return "blank"
    if picture.alpha or ((values == low) | (values == high)).all():
        return "mask"
    inner = _inner(values)
    regions = _regions(inner, values.size)
    flat = inner.size / values.size
    if not picture.lossy and len(regions) > 2 and flat >= _FLAT and not _ringing(regions):
        return "labels"
    grey = values if picture.shades is None else picture.shades
    low, high = float(grey.min()), float(grey.max())
    near = min(_RINGING, (high - low) / 4) if picture.lossy else _NEAR * (high - low)
    if ((grey <= low + near) | (grey >= high - near)).mean() >= (_EXTREME_LOSSY if picture.lossy else _EXTREME):
        return "mask"
    return "mask" if picture.shades is not None and len(regions) == 2 and flat >= _FLAT else "photo"


def object_of(picture: Picture) -> tuple[np.ndarray, bool]:
    """Return which pixels of a mask's picture are the object, and whether that is black on white.

    The object is white, or the brighter colour, or what is not transparent; it is black where the picture's
    border is white nearly all around.
    """
    grey = picture.values if picture.shades is None else picture.shades
    if picture.alpha:
        return grey >= 128, False
    low, high = grey.min(), grey.max()
    if low == high:  # of a palette that shows two ids alike, or a blank picture
        grey = picture.values
        low, high = grey.min(), grey.max()
    if low == high:
        return np.full(grey.shape, bool(high)), False
    if picture.lossy and float(high) - float(low) < _CONTRAST:
        return np.full(grey.shape, float(high) >= 128), False
    white = grey >= (float(low) + float(high)) / 2
    rim = np.concatenate([white[0], white[-1], white[1:-1, 0], white[1:-1, -1]])
    black_on_white = bool(rim.mean() >= 0.9 and white.mean() <= 0.995)
    return white != black_on_white, black_on_white


def _inner(values: np.ndarray) -> np.ndarray:
    """Return the values of the pixels that are as their four neighbours."""
    middle = values[1:-1, 1:-1]
    same = (middle == values[:-2, 1:-1]) & (middle == values[2:, 1:-1])
    same &= (middle == values[1:-1, :-2]) & (middle == values[1:-1, 2:])
    return middle[same]


def _regions(inner: np.ndarray, size: int) -> np.ndarray:
    """Return the values that cover more than specks."""
    if inner.dtype in (np.uint8, np.uint16):
        counts = np.bincount(inner)
        return np.flatnonzero(counts >= max(4, _REGION * size))
    found, counts = np.unique(inner, return_counts=True)
    return found[counts >= max(4, _REGION * size)]


def _ringing(regions: np.ndarray) -> bool:
    """Return whether these are a JPEG's black and white, saved as another format: near 0 or near 255, some beside it."""
    near_white = (regions >= 240) & (regions < 255)
    return bool(((regions <= 15) | ((regions >= 240) & (regions <= 255))).all() and near_white.any())


# What the readers of masks share: a first look at what a user gave, and how a format is described.

_TRIES = 12
Item = TypeVar("Item")


class Look:
    """The first look at a user's paths, for guessing their format: never an exception but for what is not there."""

    def __init__(self, paths: list[Path]):
        self.paths = paths

    @property
    def where(self) -> str:
        """The paths, short, for messages."""
        return str(self.paths[0]) if len(self.paths) == 1 else f"{self.paths[0]} and {len(self.paths) - 1:,} more"

    @cached_property
    def pictures(self) -> list[Place]:
        """The pictures that the paths mean; none where one of them is another kind of file."""
        named = [path for path in self.paths if not path.is_dir()]
        if any(path.suffix.lower() not in ENDINGS for path in named):
            return []
        return pictures_of(self.paths)[0]

    @cached_property
    def kinds(self) -> Counter[str]:
        """What a few of the pictures are (`kind_of`), those that can be opened."""
        some = self.pictures[:: max(1, -(-len(self.pictures) // _TRIES))]
        found: Counter[str] = Counter()
        for place in some:
            try:
                found[kind_of(open_picture(place.path))] += 1
            except PictureError:
                found["unreadable"] += 1
        return found

    @cached_property
    def peek(self) -> Peek | None:
        """The first look at the first file; None for a folder or an empty file."""
        try:
            return None if self.paths[0].is_dir() else Peek(self.paths[0])
        except (UserError, OSError):
            return None


@dataclass(frozen=True)
class MaskFormat:
    """A format of masks: how to tell it from others, and how to read it."""

    name: str
    """As in ``format=``."""
    title: str
    """What it is, in a few words."""
    fits: Callable[[Look], bool]
    """Whether it looks like this format; quick, and never an exception whatever the content."""
    read: Callable[[list[Path], MaskOptions], MaskData]
    """Reads it all; raises UserError where it is not of this format, damaged, or has no mask that can be used."""


def gather(items: Iterator[Found | Skipped], options: MaskOptions, source: str, notes: list[str]) -> MaskData:
    """Return the masks that `clean` takes, with ``notes`` (as they are at the end) and what it has to tell.

    Raises:
        UserError: none is left.
    """
    data, report = clean(items, options, most=options.most, source=source)
    if options.most is not None and len(data) == options.most:
        notes.append(f"at most {options.most:,} masks are taken (most={options.most}), spread over the file")
    return replace(data, notes=(*notes, *report.lines()))


def shuffled(items: list[Item], options: MaskOptions) -> list[tuple[int, Item]]:
    """Return all items with their places; where only some masks are asked for, in an order that is always the same."""
    numbered = list(enumerate(items))
    if options.most is not None:
        Random(len(items)).shuffle(numbered)
    return numbered


def wanted(options: MaskOptions, known: set[str], where: str) -> set[str]:
    """Return the categories that are asked for, as the file writes them; all where none is.

    Raises:
        UserError: one that the file does not have.
    """
    folded = {name.casefold(): name for name in known}
    for name in options.category:
        if name.casefold() not in folded:
            if not known - {""}:
                raise UserError(f"category={name}: {where} has no categories (sub-folders, or names in COCO's JSON).")
            raise UserError(f"category={name}: {where} has no such category.{did_you_mean(name, sorted(known))}")
    return {folded[name.casefold()] for name in options.category} or known


# All formats that masks come in, the most telling first: the first that fits reads them.

FORMATS: dict[str, str] = {
    "npz": "uplift.data.formats.masks_npz",
    "coco": "uplift.data.formats.masks_coco",
    "labels": "uplift.data.formats.masks_labels",
    "png_folder": "uplift.data.formats.masks_png",
}
"""Name of a format -> the module whose ``FORMAT`` it is."""


@cache
def format_named(name: str) -> MaskFormat:
    """Return a format of `FORMATS`."""
    return import_module(FORMATS[name]).FORMAT


# Read masks of any known format: `read` tells which it is.

_NOT_MASKS = {
    (".mp4", ".avi", ".mov", ".mkv", ".webm"): "a video. Cut its objects out first, and give the masks as pictures",
    (".glb", ".gltf", ".obj", ".ply", ".stl", ".off"): "a 3D model, no masks; `uplift data render` makes masks of models",
    (".csv", ".h5", ".slp", ".nwb", ".trc", ".c3d", ".bvh"): "a file of keypoints or motion, no masks",
    (".pt", ".pth", ".ckpt", ".onnx", ".safetensors"): "the weights of a network, no masks",
    (".zip", ".tar", ".gz", ".tgz", ".7z"): "an archive. Unpack it, and give the folder",
    (".xml",): "XML. Give the pictures of the masks (SegmentationObject in a VOC folder)",
}  # fmt: skip


def read(
    path: str | Path,
    *,
    format: str | None = None,
    side: int = 64,
    border: str = "skip",
    pieces: str = "skip",
    category: str | Sequence[str] | None = None,
    most: int | None = None,
    images: str | Path | None = None,
) -> MaskData:
    """Read a file or folder of masks, in the format that it is found or said to be in, and clean them.

    ``path`` may be several with commas, or a pattern. `MaskData.notes` say which format that was, what was
    assumed, and what was skipped, and why. ``category`` names those that are taken, ``most`` how many,
    ``images`` the folder of the photos.

    Raises:
        UserError: nothing there, no known format, files that are not what they look like, no mask that can be used.
    """
    categories = category.split(",") if isinstance(category, str) else list(category or ())
    options = MaskOptions(
        side=side,
        border=border,
        pieces=pieces,
        format=format,
        category=tuple(one.strip() for one in categories if one.strip()),
        most=most,
        images=None if images is None else str(images),
    )
    look = Look(files_of(path))
    found = guess_format(look) if format is None else _named(format)
    data = found.read(look.paths, options)
    if found.name != "npz":  # the layout of this project needs no word
        told = f"read as {found.title}" + ("" if format else f" (guessed; format={found.name})")
        data = replace(data, notes=(told, *data.notes))
    return replace(data, source=str(path))


def guess_format(look: Look) -> MaskFormat:
    """Return the first format that what was given looks like.

    Raises:
        UserError: files of no known format, or of several.
    """
    endings = sorted({path.suffix.lower() for path in look.paths if not path.is_dir()} & {".json", ".npz"})
    if endings and any(path.is_dir() or path.suffix.lower() != endings[0] for path in look.paths):
        raise UserError(f"{look.where} are files of several kinds. Give those of one kind at a time.")
    for name in FORMATS:
        if format_named(name).fits(look):
            return format_named(name)
    raise _no_format(look)


def _no_format(look: Look) -> UserError:
    known = f"Known formats: {', '.join(FORMATS)}; format=NAME says which it is."
    path = look.paths[0]
    for endings, what in _NOT_MASKS.items():
        if path.suffix.lower() in endings:
            return UserError(f"{path} is {what}.")
    if path.is_dir():
        inside = sorted(child.name for child in path.iterdir())
        if not inside:
            return UserError(f"{path} is an empty folder, expected pictures of masks in it.")
        shown = ", ".join(inside[:3]) + (", ..." if len(inside) > 3 else "")
        better = next((one for one in inside if one.endswith((".json", ".npz"))), None)
        hint = f" Give a file in it: {path / better}." if better else ""
        return UserError(f"{path} has no pictures of masks in it, only {shown}.{hint} {known}")
    if look.peek is None:
        return UserError(f"{path} is empty (0 bytes), expected masks.")
    if look.peek.npz_names:
        shown = ", ".join(look.peek.npz_names[:5])
        what = "keypoints" if "keypoints" in look.peek.npz_names else "no 'masks'"
        return UserError(f"{path} holds {what} (its arrays: {shown}), expected masks: (items, side, side) uint8.")
    if look.peek.json_sign:
        keys = ", ".join(look.peek.json_keys[:5]) or "nothing that has a name"
        return UserError(
            f"{path} is JSON without annotations (it has {keys}), expected COCO's, with 'segmentation'. {known}"
        )
    return UserError(
        f"{path} is a file of no known format (it begins {look.peek.text[:60] or look.peek.start[:16]!r}). {known}"
    )


def _named(name: str) -> MaskFormat:
    if name not in FORMATS:
        raise UserError(f"format={name}: no such format.{nearest(name, FORMATS)} Known: {', '.join(FORMATS)}.")
    return format_named(name)
