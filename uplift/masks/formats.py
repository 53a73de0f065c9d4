"""All formats that masks come in, the most telling first: the first that fits reads them."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uplift.masks.base import MaskFormat

__all__ = ["FORMATS", "format_named"]

FORMATS: dict[str, str] = {
    "npz": "uplift.masks.own",
    "coco": "uplift.masks.coco",
    "labels": "uplift.masks.labels",
    "png_folder": "uplift.masks.png_folder",
}
"""Name of a format -> the module whose ``FORMAT`` it is."""


@cache
def format_named(name: str) -> MaskFormat:
    """Return a format of `FORMATS`."""
    return import_module(FORMATS[name]).FORMAT
