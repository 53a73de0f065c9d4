"""Masks as pictures: one object each (black and white, or an alpha channel), or label images with an object a number."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import find_objects

from uplift.config.progress import progress
from uplift.data.clean_masks import MaskOptions
from uplift.data.formats.base import FileFormat, Peek
from uplift.data.formats.masks import gather, shuffled, wanted
from uplift.data.masks import Found, MaskData, Skipped
from uplift.data.parsers.pictures import Photos, Picture, PictureError, Place, open_picture, pictures_of
from uplift.errors import UserError

__all__ = ["LABELS", "MASKS"]

# A picture for each object.


def _read_masks(peek: Peek, options: MaskOptions) -> MaskData:
    notes: list[str] = []
    places = _places_in(peek, options, notes)
    counts: Counter[str] = Counter()
    photos = Photos(options.images)
    data = gather(_mask_items(places, options, photos, counts), options, peek.where, notes, photos)
    if counts["inverted"]:
        data.notes = (f"{counts['inverted']:,} masks are black on white, and were inverted", *data.notes)
    return data


def _places_in(peek: Peek, options: MaskOptions, notes: list[str]) -> list[Place]:
    """Return the pictures that are to be read.

    Raises:
        UserError: none, or none of the categories that are asked for.
    """
    places, others = pictures_of(peek.paths)
    where = peek.where
    if not places:
        inside = f"in it: {', '.join(others[:3])}{', ...' if len(others) > 3 else ''}" if others else "it is empty"
        raise UserError(f"{where} has no pictures ({inside}), expected PNG, JPEG, WebP, TIFF, BMP or GIF masks.")
    if others:
        notes.append(f"{len(others):,} files of other kinds were left out ({others[0]}{', ...' * (len(others) > 1)})")
    taken = wanted(options, {place.category for place in places}, where)
    return [place for place in places if place.category in taken]


def _opened(places: list[Place], options: MaskOptions) -> Iterator[tuple[int, Place, Picture | Skipped]]:
    """Yield the order, place and picture of each place; why not where a picture cannot be opened."""
    for order, place in progress(shuffled(places, options), "reading pictures", len(places)):
        try:
            yield order, place, open_picture(place.path)
        except PictureError as error:
            yield order, place, Skipped(place.name, str(error))


def _mask_items(
    places: list[Place], options: MaskOptions, photos: Photos, counts: Counter[str]
) -> Iterator[Found | Skipped]:
    for order, place, picture in _opened(places, options):
        if isinstance(picture, Skipped):
            yield picture
            continue
        kind = _kind_of(picture)
        if kind in ("labels", "photo"):
            yield Skipped(place.name, kind)
            continue
        mask, inverted = _object_of(picture)
        counts["inverted"] += inverted
        yield Found(place.name, mask, place.category, photos.of_mask(place.name), order=order)


MASKS = FileFormat("png_folder", "pictures of masks, one object each", lambda peek: bool(peek.pictures), _read_masks)


# Label images: each number above 0 is an object (DAVIS, Cityscapes, microscopes and annotation tools).

_MOST_IDS = 1 << 24
"""Numbers that the three bytes of a colour hold: more take a table of them too much memory."""
_MOST_OVERLAP = 20
"""How many times the boxes of a picture's objects may cover it: those of objects next to each other overlap a little."""
_TRIES = 12
"""Pictures that are opened to tell label images from masks."""
_CITYSCAPES = "_instanceIds.png"
_CITYSCAPES_CLASSES = {
    24: "person", 25: "rider", 26: "car", 27: "truck", 28: "bus", 29: "caravan", 30: "trailer", 31: "train", 32: "motorcycle", 33: "bicycle",
}  # fmt: skip
_NOTES = {
    "void": "label 255 is taken as void in {:,} label images",
    "alpha": "{:,} pictures have an alpha channel in place of labels: what is not transparent is their object",
    "stuff": "{:,} areas of classes without instances (road, sky and the like) were left out",
}


def _are_labels(peek: Peek) -> bool:
    kinds = _kinds(peek)
    return kinds["labels"] > 0 and kinds["labels"] >= kinds["photo"]


def _kinds(peek: Peek) -> Counter[str]:
    """Return what a few of the pictures are (`_kind_of`)."""
    found: Counter[str] = Counter()
    for place in peek.pictures[:: max(1, -(-len(peek.pictures) // _TRIES))]:
        try:
            found[_kind_of(open_picture(place.path))] += 1
        except PictureError:
            found["unreadable"] += 1
    return found


def _read_labels(peek: Peek, options: MaskOptions) -> MaskData:
    notes: list[str] = []
    places = _places_in(peek, replace(options, category=()), notes)
    instances = [place for place in places if place.path.name.endswith(_CITYSCAPES)]
    if instances and len(instances) < len(places):
        notes.append(f"{len(places) - len(instances):,} pictures that are not *{_CITYSCAPES} were left out")
    known = set(_CITYSCAPES_CLASSES.values()) if instances else {place.category for place in places}
    taken = wanted(options, known, peek.where) | ({""} if not options.category else set())
    counts: Counter[str] = Counter()
    photos = Photos(options.images)
    places = instances or [place for place in places if place.category in taken]
    items = (
        item
        for item in _label_items(places, options, photos, counts)
        if isinstance(item, Skipped) or item.category in taken
    )
    data = gather(items, options, peek.where, notes, photos)
    return replace(
        data, notes=(*(text.format(counts[key]) for key, text in _NOTES.items() if counts[key]), *data.notes)
    )


def _label_items(
    places: list[Place], options: MaskOptions, photos: Photos, counts: Counter[str]
) -> Iterator[Found | Skipped]:
    for order, place, picture in _opened(places, options):
        if isinstance(picture, Skipped):
            yield picture
            continue
        if picture.alpha:
            counts["alpha"] += 1
            yield Found(place.name, picture.values, place.category, photos.of_mask(place.name), order=order)
            continue
        if picture.lossy:
            picture = Picture(_object_of(picture)[0].astype(np.uint8))
        yield from _objects(picture.values, place, photos, counts, order)


def _objects(
    values: np.ndarray, place: Place, photos: Photos, counts: Counter[str], order: int
) -> Iterator[Found | Skipped]:
    """Yield each object of a label image, in the window around it."""
    ids, numbers = _numbered(values)
    cityscapes = place.path.name.endswith(_CITYSCAPES)
    if ids[0] > 0 and not cityscapes:
        yield Skipped(place.name, "no_background")
        return
    void = 255 if values.dtype == np.uint8 and len(ids) > 2 else None
    counts["void"] += int(void in ids)
    image = photos.of_mask(
        place.name.removesuffix(f"_gtFine{_CITYSCAPES}") + "_leftImg8bit.png" if cityscapes else place.name
    )
    windows = find_objects(numbers)
    boxes = sum((one[0].stop - one[0].start) * (one[1].stop - one[1].start) for one in windows if one)
    if boxes > _MOST_OVERLAP * values.size:
        yield Skipped(place.name, "scattered")
        return
    for number, (id_, window) in enumerate(zip(ids.tolist(), windows, strict=True), 1):
        if id_ == 0 or id_ == void or window is None:
            continue
        if cityscapes and id_ < 1000:
            counts["stuff"] += 1
            continue
        category = _CITYSCAPES_CLASSES.get(id_ // 1000, "") if cityscapes else place.category
        yield Found(
            f"{place.name}:{id_}",
            numbers[window] == number,
            category,
            image,
            corner_px=(window[1].start, window[0].start),
            image_size=(values.shape[1], values.shape[0]),
            order=order,
        )


def _numbered(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ids of a label image, rising, and the image with 1 for the first, 2 for the second, and so on."""
    most = values.max()
    if values.dtype.kind not in "iu" or most >= _MOST_IDS or most >= max(values.size, 1 << 16):
        ids, numbers = np.unique(values.astype(np.int64), return_inverse=True)
        return ids, numbers.reshape(values.shape).astype(np.int32) + 1
    there = np.zeros(int(most) + 1, bool)  # far quicker than sorting them
    there[values] = True
    return np.flatnonzero(there), np.cumsum(there, dtype=np.int32)[values]


LABELS = FileFormat("labels", "label images, an object for each number above 0", _are_labels, _read_labels)


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
_BLOCK = 1 << 24
"""Pixels that are counted at a time, as counting takes eight bytes for each."""
_REGION = 0.0005
"""Share of the picture that a label covers at least, apart from its edge."""


def _kind_of(picture: Picture) -> str:
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


def _object_of(picture: Picture) -> tuple[np.ndarray, bool]:
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
        counts = sum(np.bincount(part, minlength=65536) for part in np.array_split(inner, 1 + inner.size // _BLOCK))
        return np.flatnonzero(counts >= max(4, _REGION * size))
    found, counts = np.unique(inner, return_counts=True)
    return found[counts >= max(4, _REGION * size)]


def _ringing(regions: np.ndarray) -> bool:
    """Return whether these are a JPEG's black and white, saved as another format: near 0 or near 255, some beside it."""
    near_white = (regions >= 240) & (regions < 255)
    return bool(((regions <= 15) | ((regions >= 240) & (regions <= 255))).all() and near_white.any())
