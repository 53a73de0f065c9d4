"""Masks as pictures, one object each: black and white, or cut out by an alpha channel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from uplift.data.clean_masks import MaskOptions
from uplift.data.formats.masks import Look, MaskFormat, gather, kind_of, object_of, shuffled, wanted
from uplift.data.masks import Found, MaskData, Skipped
from uplift.data.parsers.pictures import Photos, PictureError, Place, open_picture, pictures_of
from uplift.errors import UserError

__all__ = ["FORMAT", "places_in"]


def _fits(look: Look) -> bool:
    return bool(look.pictures)


def _read(paths: list[Path], options: MaskOptions) -> MaskData:
    notes: list[str] = []
    places = places_in(paths, options, notes)
    told: Counter[str] = Counter()
    photos = Photos(options.images)
    data = gather(_items(places, options, photos, told), options, Look(paths).where, notes)
    more = [f"{told['inverted']:,} masks are black on white, and were inverted"] if told["inverted"] else []
    data.notes = (*more, *photos.notes(), *data.notes)
    return data


def places_in(paths: list[Path], options: MaskOptions, notes: list[str]) -> list[Place]:
    """Return the pictures that are to be read.

    Raises:
        UserError: none, or none of the categories that are asked for.
    """
    places, others = pictures_of(paths)
    where = Look(paths).where
    if not places:
        inside = f"in it: {', '.join(others[:3])}{', ...' if len(others) > 3 else ''}" if others else "it is empty"
        raise UserError(f"{where} has no pictures ({inside}), expected PNG, JPEG, WebP, TIFF, BMP or GIF masks.")
    if others:
        notes.append(f"{len(others):,} files of other kinds were left out ({others[0]}{', ...' * (len(others) > 1)})")
    taken = wanted(options, {place.category for place in places}, where)
    return [place for place in places if place.category in taken]


def _items(places: list[Place], options: MaskOptions, photos: Photos, told: Counter[str]) -> Iterator[Found | Skipped]:
    for order, place in shuffled(places, options):
        try:
            picture = open_picture(place.path)
        except PictureError as error:
            yield Skipped(place.name, str(error))
            continue
        kind = kind_of(picture)
        if kind in ("labels", "photo"):
            yield Skipped(place.name, kind)
            continue
        mask, inverted = object_of(picture)
        told["inverted"] += inverted
        yield Found(place.name, mask, place.category, photos.of_mask(place.name), order=order)


FORMAT = MaskFormat("png_folder", "pictures of masks, one object each", _fits, _read)
