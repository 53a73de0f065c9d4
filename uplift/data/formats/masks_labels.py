"""Label images: each number above 0 is an object (DAVIS, Cityscapes, microscopes and annotation tools)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import find_objects

from uplift.data.clean_masks import MaskOptions
from uplift.data.formats.masks import Look, MaskFormat, gather, object_of, shuffled, wanted
from uplift.data.formats.masks_png import places_in
from uplift.data.masks import Found, MaskData, Skipped
from uplift.data.parsers.pictures import Photos, Picture, PictureError, Place, open_picture

__all__ = ["FORMAT"]

_CITYSCAPES = "_instanceIds.png"
_CITYSCAPES_CLASSES = {
    24: "person", 25: "rider", 26: "car", 27: "truck", 28: "bus", 29: "caravan", 30: "trailer", 31: "train", 32: "motorcycle", 33: "bicycle",
}  # fmt: skip
_NOTES = {
    "void": "label 255 is taken as void in {:,} label images",
    "alpha": "{:,} pictures have an alpha channel in place of labels: what is not transparent is their object",
    "stuff": "{:,} areas of classes without instances (road, sky and the like) were left out",
}


def _fits(look: Look) -> bool:
    kinds = look.kinds
    return kinds["labels"] > 0 and kinds["labels"] >= kinds["photo"]


def _read(paths: list[Path], options: MaskOptions) -> MaskData:
    notes: list[str] = []
    places = places_in(paths, replace(options, category=()), notes)
    instances = [place for place in places if place.path.name.endswith(_CITYSCAPES)]
    if instances and len(instances) < len(places):
        notes.append(f"{len(places) - len(instances):,} pictures that are no *{_CITYSCAPES} were left out")
    known = set(_CITYSCAPES_CLASSES.values()) if instances else {place.category for place in places}
    taken = wanted(options, known, Look(paths).where) | ({""} if not options.category else set())
    told: Counter[str] = Counter()
    photos = Photos(options.images)
    places = instances or [place for place in places if place.category in taken]
    items = (
        item for item in _items(places, options, photos, told) if isinstance(item, Skipped) or item.category in taken
    )
    data = gather(items, options, Look(paths).where, notes)
    more = [text.format(told[key]) for key, text in _NOTES.items() if told[key]]
    data.notes = (*more, *photos.notes(), *data.notes)
    return data


def _items(places: list[Place], options: MaskOptions, photos: Photos, told: Counter[str]) -> Iterator[Found | Skipped]:
    for order, place in shuffled(places, options):
        try:
            picture = open_picture(place.path)
        except PictureError as error:
            yield Skipped(place.name, str(error))
            continue
        if picture.alpha:
            told["alpha"] += 1
            yield Found(place.name, picture.values, place.category, photos.of_mask(place.name), order=order)
            continue
        if picture.lossy:
            picture = Picture(object_of(picture)[0].astype(np.uint8))
        yield from _objects(picture.values, place, photos, told, order)


def _objects(
    values: np.ndarray, place: Place, photos: Photos, told: Counter[str], order: int
) -> Iterator[Found | Skipped]:
    """Yield each object of a label image, in the window around it."""
    ids, numbers = _numbered(values)
    cityscapes = place.path.name.endswith(_CITYSCAPES)
    if ids[0] > 0 and not cityscapes:
        yield Skipped(place.name, "no_background")
        return
    void = 255 if values.dtype == np.uint8 and len(ids) > 2 else None
    told["void"] += int(void in ids)
    image = photos.of_mask(
        place.name.removesuffix(f"_gtFine{_CITYSCAPES}") + "_leftImg8bit.png" if cityscapes else place.name
    )
    windows = find_objects(numbers)
    for number, (id_, window) in enumerate(zip(ids.tolist(), windows, strict=True), 1):
        if id_ == 0 or id_ == void or window is None:
            continue
        if cityscapes and id_ < 1000:
            told["stuff"] += 1
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
    if values.dtype not in (np.uint8, np.uint16):
        ids, numbers = np.unique(values.astype(np.int64), return_inverse=True)
        return ids, numbers.reshape(values.shape).astype(np.int32) + 1
    there = np.bincount(values.reshape(-1)) > 0  # far quicker than sorting them
    return np.flatnonzero(there), np.cumsum(there, dtype=np.int32)[values]


FORMAT = MaskFormat("labels", "label images, an object for each number above 0", _fits, _read)
