"""What data check says of a file or folder of masks: a look at it, without opening every picture."""

from __future__ import annotations

from pathlib import Path

from uplift.config import DataSettings
from uplift.errors import UserError, did_you_mean
from uplift.masks.base import Look
from uplift.masks.formats import FORMATS, format_named
from uplift.masks.npz import read_masks
from uplift.masks.reading import guess_format
from uplift.meshes.procedural import FAMILIES

__all__ = ["made_up_masks", "masks_there"]


def made_up_masks(data: DataSettings) -> str:
    """Return what a fit makes up; raises UserError for no such family."""
    if data.family not in FAMILIES:
        raise UserError(f"data.family={data.family}: no such family of shapes.{did_you_mean(data.family, FAMILIES)}")
    return f"{data.simulate:,} masks of made-up {data.family}"


def masks_there(path: Path, data: DataSettings) -> str:
    """Return in a few words what ``path`` holds; raises UserError where that is no masks."""
    look = Look([path])
    if data.format is not None and data.format not in FORMATS:
        raise UserError(f"data.format={data.format}: no such format of masks.{did_you_mean(data.format, FORMATS)}")
    found = guess_format(look) if data.format is None else format_named(data.format)
    if found.name == "npz":
        masks = read_masks(path)
        truth = "no" if masks.truth is None else "with"
        return f"{len(masks):,} masks of {masks.side} x {masks.side} px, {truth} true shapes"
    count = f"{len(look.pictures):,} pictures, " if look.pictures else ""
    return f"{count}{found.title}; each is looked at when the fit starts"
