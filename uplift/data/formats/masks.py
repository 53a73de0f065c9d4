"""What mask formats share: which masks are taken, in what order, and how they are cleaned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from random import Random
from typing import TypeVar

from uplift.data.clean_masks import MaskOptions, clean
from uplift.data.masks import Found, MaskData, Skipped
from uplift.data.parsers.pictures import Photos
from uplift.errors import UserError, did_you_mean

__all__ = ["gather", "shuffled", "wanted"]

Item = TypeVar("Item")


def gather(
    items: Iterator[Found | Skipped], options: MaskOptions, source: str, notes: list[str], photos: Photos
) -> MaskData:
    """Return the masks that `clean` takes, with the notes of ``photos``, ``notes`` (as they are at the end) and its report.

    Raises:
        UserError: none is left.
    """
    data, report = clean(items, options, most=options.most, source=source)
    if options.most is not None and len(data) == options.most:
        notes.append(f"at most {options.most:,} masks are taken (most={options.most}), spread over the file")
    return replace(data, notes=(*photos.notes(), *notes, *report.lines()))


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
