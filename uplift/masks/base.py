"""What the readers of masks share: a first look at what a user gave, and how a format is described."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from random import Random
from typing import TypeVar

from uplift.errors import UserError, did_you_mean
from uplift.masks.clean import clean
from uplift.masks.container import MaskData
from uplift.masks.found import Found, Skipped
from uplift.masks.kinds import kind_of
from uplift.masks.options import MaskOptions
from uplift.masks.picture import ENDINGS, PictureError, open_picture
from uplift.masks.places import Place, pictures_of
from uplift.readers.base import Peek

__all__ = ["Look", "MaskFormat", "gather", "shuffled", "wanted"]

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
