"""COCO's JSON with segmentations: polygons and run lengths; data sets, and results of detectors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uplift.config.files import without_folders
from uplift.data.clean_masks import MaskOptions
from uplift.data.formats.base import FileFormat, Peek
from uplift.data.formats.masks import gather, shuffled, wanted
from uplift.data.masks import Found, MaskData, Skipped
from uplift.data.parsers.json import JsonText, entries, is_text, members, objects
from uplift.data.parsers.outlines import (
    MAX_PIXELS,
    pixels_of_polygons,
    pixels_of_runs,
    window_of_polygons,
    window_of_runs,
)
from uplift.data.parsers.pictures import Photos
from uplift.errors import UserError

__all__ = ["FORMAT"]

# Segmentations as COCO's JSON holds them: what is kept of each annotation, and its mask.

_SLACK_PX = 2.0
"""Outlines by hand that stop as near as that to the border of the image go on beyond it."""
_FARTHEST_PX = 1e7


class _RecordError(Exception):
    """Why an annotation cannot be used: a key of `uplift.data.clean_masks.REASONS`."""


@dataclass(frozen=True)
class _Outline:
    """A segmentation, small enough to keep many of."""

    polygons: tuple[np.ndarray, ...] = ()
    """(corners 2) px each."""
    counts: Any = None
    """Run lengths, as a list or as text."""
    size: Any = None
    """[height, width] of the run lengths."""


def _outline_of(record: dict[str, Any]) -> _Outline:
    """Return an annotation's segmentation.

    Raises:
        RecordError: a crowd, of low score, or without a segmentation that is one.
    """
    if record.get("iscrowd") in (1, True):
        raise _RecordError("crowd")
    score = record.get("score")
    if isinstance(score, int | float) and not score >= 0.5:
        raise _RecordError("score")
    found = record.get("segmentation")
    if not found:
        raise _RecordError("no_outline")
    if isinstance(found, dict):
        if not isinstance(found.get("counts"), str | list):
            raise _RecordError("damaged")
        return _Outline(counts=found["counts"], size=found.get("size"))
    if not isinstance(found, list):
        raise _RecordError("damaged")
    if not isinstance(found[0], list):
        found = [found]  # one polygon without its list, as some tools write it
    return _Outline(polygons=tuple(_polygon(one) for one in found))


def _polygon(numbers: Any) -> np.ndarray:
    if (
        not isinstance(numbers, list)
        or len(numbers) < 6
        or len(numbers) % 2
        or not all(type(one) in (int, float) and abs(one) < _FARTHEST_PX for one in numbers)
    ):
        raise _RecordError("damaged")
    return np.array(numbers, np.float32).reshape(-1, 2)


def _window_of(
    outline: _Outline, image_size: tuple[int, int] | None
) -> tuple[np.ndarray, tuple[int, int], tuple[int, int] | None]:
    """Return a segmentation's mask in a window, the window's corner (x, y) and the size of the image, px.

    Raises:
        RecordError: nothing covered, damaged, or too large.
    """
    try:
        if outline.polygons:
            found = window_of_polygons([one.astype(np.float64) for one in outline.polygons], image_size)
            runs = None if found is None else (*found, image_size)
        else:
            runs = window_of_runs(outline.counts, outline.size)
    except OverflowError:
        raise _RecordError("huge") from None
    except ValueError:
        raise _RecordError("damaged") from None
    if runs is None:
        raise _RecordError("empty")
    return runs


# Read the file: a data set, or the results of a detector.

_UNKNOWN = (2**31, 2**31)
"""Size of an image that the file does not give: only its left and upper border are known."""


@dataclass(frozen=True)
class _Image:
    name: str
    size: tuple[int, int] | None
    """Width, height."""


@dataclass
class _Record:
    """One annotation."""

    number: str
    image: str | None
    category: str | None
    outline: _Outline | str
    """Or why it cannot be used."""


@dataclass
class _File:
    """What has been read of a file."""

    path: Path
    images: dict[str | None, _Image] = field(default_factory=dict)
    categories: dict[str | None, str] = field(default_factory=dict)
    records: list[_Record] = field(default_factory=list)

    def image(self, record: dict[str, Any]) -> None:
        """Take one image."""
        number = _key(record.get("id", record.get("image_id")))
        name = record.get("file_name")
        width, height = record.get("width"), record.get("height")
        size = None
        if isinstance(width, int) and isinstance(height, int) and width > 0 and height > 0:
            size = (int(width), int(height))
        self.images[number] = _Image(str(name) if is_text(name) else str(number), size)

    def category(self, record: dict[str, Any]) -> None:
        """Take one category."""
        name = record.get("name")
        self.categories[_key(record.get("id"))] = str(name) if is_text(name) else str(_key(record.get("id")))

    def annotation(self, record: dict[str, Any]) -> None:
        """Take one annotation."""
        try:
            outline: _Outline | str = _outline_of(record)
        except _RecordError as error:
            outline = str(error)
        number = _key(record.get("id")) or str(len(self.records))
        self.records.append(_Record(number, _key(record.get("image_id")), _key(record.get("category_id")), outline))

    def category_of(self, record: _Record) -> str:
        """Return the name of an annotation's category; its number where the file has no name for it."""
        return self.categories.get(record.category, record.category or "")


def _fits(peek: Peek) -> bool:
    return bool(peek.json_sign) and bool({"annotations", "segmentation", "images", "categories"} & set(peek.json_keys))


def _read(peek: Peek, options: MaskOptions) -> MaskData:
    files = [_load(path) for path in peek.paths]
    where = peek.where
    known = {name for file in files for name in file.categories.values()}
    known |= {file.category_of(record) for file in files for record in file.records}
    taken = wanted(options, known, where)
    jobs = [(file, record) for file in files for record in file.records if file.category_of(record) in taken]
    if not jobs:
        raise UserError(f"{where} has no annotations, expected COCO's, with a 'segmentation' each.")
    _check_pixels(jobs, options, where)
    photos = Photos(options.images)
    return gather(_items(jobs, options, photos), options, where, _unsized(jobs), photos)


_SMALL_PIXELS = 300_000_000
_PIXELS_A_BYTE = 20_000
"""Pixels to look at for each byte of a file: a coarse outline of all of a 4k photo has fewer."""


def _check_pixels(jobs: list[tuple[_File, _Record]], options: MaskOptions, where: str) -> None:
    """Raise UserError where outlines in few bytes would take hours: those that claim to be huge, again and again."""
    size = sum(path.stat().st_size for path in {file.path for file, _ in jobs})
    allowed = _SMALL_PIXELS + _PIXELS_A_BYTE * size
    share = min(1.0, (options.most or len(jobs)) / len(jobs))
    found = [(record.outline, file.images.get(record.image, _Image("", None)).size) for file, record in jobs]
    outlines = [(outline, size) for outline, size in found if isinstance(outline, _Outline)]
    for pixels_of in (_most_pixels, _pixels):  # the first is quick, and seldom too many
        pixels = share * min(sum(pixels_of(*one) for one in outlines), 10**18)
        if pixels <= allowed:
            return
    raise UserError(
        f"{where}: its {len(jobs):,} outlines cover {pixels:,.0f} pixels in a file of {size / 1e6:.1f} MB, as no real "
        "ones do. Scale images and outlines down, or take a few of them (most=10; data.most=10 of a fit)."
    )


def _most_pixels(outline: _Outline, image_size: tuple[int, int] | None) -> int:
    """Return no fewer than `_pixels` of an outline in an image of ordinary size."""
    if not image_size or not outline.polygons:
        return MAX_PIXELS
    width, height = image_size
    return len(outline.polygons) * width * height + 10 * height * sum(map(len, outline.polygons))


def _pixels(outline: _Outline, image_size: tuple[int, int] | None) -> int:
    """Return how many pixels reading an outline looks at; none where it will be refused."""
    try:
        if outline.polygons:
            return pixels_of_polygons([one.astype(np.float64) for one in outline.polygons], image_size)
        return pixels_of_runs(outline.counts, outline.size)
    except (OverflowError, ValueError):
        return 0


def _unsized(jobs: list[tuple[_File, _Record]]) -> list[str]:
    """Return the note about polygons whose image has no size."""
    polygons = [
        (file, record) for file, record in jobs if isinstance(record.outline, _Outline) and record.outline.polygons
    ]
    unsized = sum(file.images.get(record.image, _Image("", None)).size is None for file, record in polygons)
    note = f"{unsized:,} images have no width and height: whether their objects are cut off at the right or below is not known"
    return [note] if unsized else []


def _load(path: Path) -> _File:
    file = _File(path)
    if path.is_dir():
        raise UserError(f"{path} is a folder, expected COCO's JSON: give the file in it.")
    if JsonText(path).next_sign() == "[":  # results of a detector
        for _, record in entries(path, "the list"):
            file.annotation(record)
        return file
    for key, text in members(path):
        take = {"images": file.image, "annotations": file.annotation, "categories": file.category}.get(key)
        if take is not None and text.next_sign() == "[":
            for record in objects(text, f"'{key}'"):
                take(record)
            continue
        value = text.value()
        if key == "image" and isinstance(value, dict):  # a file for each image
            file.image(value)
            file.images[None] = file.images[_key(value.get("id", value.get("image_id")))]
    return file


def _items(jobs: list[tuple[_File, _Record]], options: MaskOptions, photos: Photos) -> Iterator[Found | Skipped]:
    for order, (file, record) in shuffled(jobs, options):
        image = file.images.get(record.image, _Image(record.image or "", None))
        name = f"{without_folders(image.name) or file.path.name}:{record.number}"
        try:
            if isinstance(record.outline, str):
                raise _RecordError(record.outline)
            if file.images and record.image not in file.images:
                raise _RecordError("no_image")
            mask, corner, size = _window_of(record.outline, image.size)
        except _RecordError as error:
            yield Skipped(name, str(error))
            continue
        yield Found(
            name,
            mask,
            file.category_of(record),
            photos.of_name(image.name, file.path) if image.name else "",
            corner_px=corner,
            image_size=size or _UNKNOWN,
            slack_px=_SLACK_PX if record.outline.polygons else 0,
            order=order,
        )


def _key(value: Any) -> str | None:
    """Return an id as text, as some files have 7 in one place and "7" in another; nothing for lists and the like."""
    return str(value)[:200] if isinstance(value, int | str) and not isinstance(value, bool) else None


FORMAT = FileFormat("coco", "COCO's JSON with segmentations", _fits, _read)
