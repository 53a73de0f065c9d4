"""Masks: the container, its files, and how they are cleaned."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from uplift.masks.container import MaskData
from uplift.masks.formats import FORMATS

if TYPE_CHECKING:
    from uplift.masks.reading import read

__all__ = ["FORMATS", "MaskData", "read"]


def __getattr__(name: str) -> Any:
    """Load `read` when it is asked for: it brings scikit-image, which masks alone do not need."""
    if name == "read":
        from uplift.masks.reading import read

        return read
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
