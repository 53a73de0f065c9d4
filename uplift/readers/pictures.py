"""Sizes of the pictures beside label files, from their headers."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.readers.base import ReadOptions

__all__ = ["PICTURES", "picture_sizes"]

PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff")


def picture_sizes(
    files: list[Path], rows: list[int], options: ReadOptions, notes: list[str]
) -> tuple[dict[str, str], np.ndarray | None]:
    """Return the picture's name of each label file, and (rows, 2) sizes in px; None where they are not known.

    Pictures are looked for beside the labels, and in images/ where the labels are in labels/.
    """
    found = _pictures(files[0].absolute().parent)
    names = {file.stem: found[file.stem].name for file in files if file.stem in found}
    if options.image_size is not None:
        return names, np.tile(np.array(options.image_size, np.float32), (len(rows), 1))
    if not names:
        return names, None
    used = sorted(set(rows))
    known = {row: _size(found[files[row].stem]) for row in used if files[row].stem in found}
    sizes = set(known.values())
    without = [row for row in used if row not in known]
    if without and len(sizes) != 1:
        raise UserError(
            f"{files[without[0]]} has no picture beside it or in images/ to tell its size, and the others differ. "
            "Say image_size=WIDTHxHEIGHT."
        )
    if without:
        notes.append(f"{len(without):,} labels have no picture: their size is taken to be that of the others")
    other = next(iter(sizes))
    return names, np.array([known.get(row, other) for row in rows], np.float32)


def _pictures(folder: Path) -> dict[str, Path]:
    """Return the pictures that belong to a folder of labels, by their names without ending."""
    places = [folder, folder.parent / "images"]
    parts = list(folder.parts)
    if "labels" in parts:
        last = len(parts) - 1 - parts[::-1].index("labels")
        places.append(Path(*parts[:last], "images", *parts[last + 1 :]))
    found: dict[str, Path] = {}
    for place in dict.fromkeys(places):
        for one in place.iterdir() if place.is_dir() else []:
            if one.suffix.lower() in PICTURES:
                found.setdefault(one.stem, one)
    return found


def _size(picture: Path) -> tuple[int, int]:
    """Return width and height of a picture from its header."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures: nothing is decoded
            with Image.open(picture) as opened:
                return opened.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise UserError(
            f"{picture} cannot be read as a picture, for the size of its labels: {error!s:.100}. Say "
            "image_size=WIDTHxHEIGHT."
        ) from None
