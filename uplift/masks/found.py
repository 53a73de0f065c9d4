"""What a reader hands over, one at a time: a mask, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Found", "Skipped"]


@dataclass
class Found:
    """One object's mask as a file has it, or the window of it that has all of the object."""

    name: str
    """Where it came from: a file, ``file:instance``."""
    mask: np.ndarray
    """(height width), true or false, 0 and 1, 0 to 255, or a coverage from 0 to 1."""
    category: str = ""
    image: str = ""
    """The photo's file, where there is one."""
    corner_px: tuple[int, int] = (0, 0)
    """Of the window in the image: x, y."""
    image_size: tuple[int, int] | None = None
    """Width and height of the image; unset: the mask is all of it."""
    slack_px: int | float = 0
    """How near the image's border counts as touching: outlines by hand stop a little short of it."""
    order: int = 0
    """Place in the file, where masks are taken in another order."""


@dataclass(frozen=True)
class Skipped:
    """A mask that is not taken, and the reason, a key of `uplift.masks.report.REASONS`."""

    name: str
    reason: str
