"""A user's own format of masks: the class to subclass, and what it gives cut out and cleaned as other masks are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.clean_masks import MaskOptions, clean
from uplift.data.concat import concat_masks
from uplift.data.formats.base import FileFormat, Peek
from uplift.data.formats.masks import wanted
from uplift.data.formats.masks_npz import arrays_of, chosen, masks_of_arrays, with_photos
from uplift.data.formats.own import Made, OwnFormat, own_format
from uplift.data.masks import Found, MaskData
from uplift.data.parsers.pictures import Photos
from uplift.errors import UserError

__all__ = ["MaskFormat", "own_masks"]

Mask = np.ndarray | tuple[str, np.ndarray] | Found
"""(height, width) of the whole image, alone, with its name, or with what else is known."""


class MaskFormat(OwnFormat):
    """Subclass this, write `read`, and name the class: ``format=my_masks.py:MyMasks``, ``data.format=`` in a fit.

    The class is made without arguments.
    """

    def read(self, path: Path, options: MaskOptions) -> Iterable[Mask] | Mapping[str, np.ndarray] | MaskData:
        """Return or yield the masks of a file or folder, which is there; or `MaskData`, where they are cut out already.

        Each mask is (height, width) of any kind of numbers, one object in its whole image, alone or with its name;
        `uplift.data.masks.Found` has a category and more beside it. Masks are cleaned, cut out and chosen afterwards,
        as ``options`` say.
        """
        return super().read(path, options)


def own_masks(name: str, where: str) -> FileFormat[MaskOptions, MaskData]:
    """Return the format of masks that a user's class makes; raises UserError as `uplift.data.formats.own.made_of`."""
    return own_format(name, where, MaskFormat, _read)


def _read(made: Made, peek: Peek, options: MaskOptions) -> MaskData:
    files, ready, photos = made.files(peek.paths), [], Photos(options.images)
    masks = _chosen(made, files, options, photos, ready)
    first = next(masks, None)
    if ready:
        return chosen(concat_masks(ready), options, peek.where, photos)
    if first is None:
        raise UserError(f"{made.where(files[0])}: {type(made.maker).__name__}.read gave no mask.")
    data, report = clean(chain([first], masks), options, most=options.most, source=peek.where)
    most = options.most is not None and len(data) == options.most
    taken = (f"the first {len(data):,} masks are taken (most={options.most})",) if most else ()
    return replace(data, notes=(*photos.notes(), *taken, *report.lines()))


def _chosen(
    made: Made, files: list[Path], options: MaskOptions, photos: Photos, ready: list[MaskData]
) -> Iterator[Found]:
    """Yield the masks of the categories that are asked for; ``ready`` takes what is cut out already.

    Raises:
        UserError: what is no mask, or, at the end, a category that no mask has.
    """
    asked, seen, order = {name.casefold() for name in options.category}, set[str](), 0
    for path in files:
        given = made.run(path, lambda path=path: made.maker.read(path, options))
        if isinstance(given, MaskData):
            ready.append(with_photos(_checked(given, path, made), photos, path))
        else:
            for number, item in enumerate(_steps(made, path, _several(given, made, path))):
                found = _found(item, number, path, made)
                seen.add(found.category)
                if not asked or found.category.casefold() in asked:
                    found.image = photos.of_name(found.image, path) if found.image else photos.of_mask(found.name)
                    found.order = order
                    yield found
                order += 1
        if ready and order:
            raise UserError(
                f"{made.where(path)}: MaskData from one file and masks from another, expected one of the two."
            )
    if order:
        wanted(options, seen, made.where(files[0]))


def _several(given: Any, made: Made, path: Path) -> Iterable[Any]:
    """Return what `read` gave as something to go through; raises UserError for what holds no masks."""
    if isinstance(given, np.ndarray) and given.ndim == 2:
        return [given]
    if isinstance(given, Mapping):
        return given.items()
    if isinstance(given, str | bytes | np.generic) or not isinstance(given, Iterable):
        found = "nothing" if given is None else type(given).__name__
        raise UserError(
            f"{made.where(path)}: {type(made.maker).__name__}.read returned {found}, expected masks: arrays "
            "(height, width), pairs of a name and an array, or uplift.MaskData."
        )
    return given


def _steps(made: Made, path: Path, given: Iterable[Any]) -> Iterator[Any]:
    """Yield the items of what `read` gave, one by one; an error in it names the user's file and line."""
    end = object()
    steps = made.run(path, lambda: iter(given))
    while True:
        item = made.run(path, lambda: next(steps, end))
        if item is end:
            return
        yield item


def _found(item: Any, number: int, path: Path, made: Made) -> Found:
    """Return one mask with its name; raises UserError for what is none."""
    where = f"{made.where(path)}: mask {number}"
    if not isinstance(item, Found):
        named = isinstance(item, tuple) and len(item) == 2 and isinstance(item[0], str)
        name, given = item if named else (f"{path.name}:{number}", item)
        item = Found(name, given)  # pyright: ignore[reportArgumentType] (checked below)
    mask: Any = item.mask
    if not isinstance(mask, np.ndarray):
        raise UserError(
            f"{where} is {type(mask).__name__}, expected an array (height, width), or a pair of a name and one."
        )
    if mask.ndim != 2 or mask.dtype.kind not in "buif" or not mask.size:
        raise UserError(f"{where} is {mask.dtype} of shape {mask.shape}, expected numbers of shape (height, width).")
    wrong = _odd(item)
    if wrong:
        raise UserError(f"{where}: '{wrong}' is {getattr(item, wrong)!r}, expected what uplift.data.masks.Found says.")
    return replace(item)


def _odd(item: Found) -> str:
    """Return the name of a field that is of another kind than it should be; empty where none is."""
    pairs = {"corner_px": (item.corner_px, 0), "image_size": (item.image_size or (1, 1), 1)}
    for name, (pair, least) in pairs.items():
        whole = isinstance(pair, tuple | list) and len(pair) == 2 and all(isinstance(n, int | np.integer) for n in pair)
        if not whole or min(pair) < least:
            return name
    if not isinstance(item.slack_px, int | float):
        return "slack_px"
    return next((name for name in ("name", "category", "image") if not isinstance(getattr(item, name), str)), "")


def _checked(data: MaskData, path: Path, made: Made) -> MaskData:
    """Return what was read as what a file of this project would hold; raises UserError for what one would be refused for."""
    where = made.where(path)
    if not len(data):
        raise UserError(f"{where}: no masks.")
    found = made.run(path, lambda: masks_of_arrays(where, arrays_of(data), path.name))
    notes = (data.notes,) if isinstance(data.notes, str) else tuple(map(str, data.notes))
    return replace(found, labelled=None, notes=notes, source=str(path))
