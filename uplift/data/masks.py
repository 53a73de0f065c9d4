"""`MaskData`: 2D masks, and what is known beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from jaxtyping import Float, Int

from uplift.errors import UserError
from uplift.geometry.mesh import Mesh

__all__ = ["FILL", "Found", "MaskData", "Placed", "Skipped"]

# The one container of 2D masks and what is known beside them.

FILL = 0.85
"""Half of the longer side of a mask's box, of the half side of its crop."""


@dataclass
class Placed:
    """Shapes and where each item has one: `scale` * (`view` @ point) + (`offset`, 0) is the item's camera frame.

    That frame is in units of the item's crop: x right and y down from -1 to 1 over the crop, z away from
    the camera; depth is relative, 0 at the shape's own origin. A point projects to
    (x, y) / (1 + (z / distance)), and to (x, y) where `distance` is infinite.
    """

    meshes: Sequence[Mesh]
    shape: Int[np.ndarray, " items"]
    """Which mesh, by its place in `meshes`; several items may show one."""
    view: Float[np.ndarray, "items 3 3"]
    """Rotation from the shape's own frame to the camera's."""
    scale: Float[np.ndarray, " items"]
    offset: Float[np.ndarray, "items 2"]
    distance: Float[np.ndarray, " items"]
    """Of the camera, in units of the crop."""

    def __len__(self) -> int:
        return len(self.shape)

    def select(self, rows: np.ndarray) -> Placed:
        """Return some items; the meshes are all kept."""
        return Placed(
            self.meshes, self.shape[rows], self.view[rows], self.scale[rows], self.offset[rows], self.distance[rows]
        )


@dataclass
class MaskData:
    """Masks cut out, centred and scaled: the longer side of each one's box is `FILL` of its crop, the box's middle its centre.

    `truth` is never an input of training from masks alone; `labelled` says where it may be.
    """

    masks: np.ndarray
    """(items side side) uint8: how much of each pixel the object covers, 0..255; row 0 is the top."""
    names: list[str]
    """Where each came from: a file, ``file:instance``, a mesh."""
    centre_px: np.ndarray
    """(items 2), the crop's centre in the image the mask came from: x right, y down."""
    scale_px: np.ndarray
    """(items,), pixels of that image in one unit, half the crop's side."""
    category: np.ndarray | None = None
    """(items,) text: species, class."""
    images: np.ndarray | None = None
    """(items,) text: the photo's file, where there is one, else empty."""
    truth: Placed | None = None
    labelled: np.ndarray | None = None
    """(items,) bool: items whose truth training may learn from; None: no item's."""
    notes: tuple[str, ...] = ()
    """What was assumed, mended or skipped, one sentence each."""
    source: str = ""
    extra: dict[str, np.ndarray] = field(default_factory=dict)
    """(items, ...) each: whatever a reader knows besides."""

    def __post_init__(self) -> None:
        items = len(self.masks)
        if self.masks.ndim != 3 or self.masks.shape[1] != self.masks.shape[2] or self.masks.dtype != np.uint8:
            raise UserError(
                f"masks are {self.masks.dtype} of shape {self.masks.shape}, expected uint8 (items, side, side)."
            )
        for name in ("names", "centre_px", "scale_px", "category", "images", "truth", "labelled"):
            value = getattr(self, name)
            if value is not None and len(value) != items:
                raise UserError(f"'{name}' has {len(value)} rows, expected {items}, one for each mask.")

    def __len__(self) -> int:
        return len(self.masks)

    @property
    def side(self) -> int:
        """Pixels along a crop."""
        return self.masks.shape[1]

    def select(self, rows: np.ndarray) -> MaskData:
        """Return some items, by their numbers or by a mask of them."""
        rows = np.flatnonzero(rows) if rows.dtype == bool else rows
        found = {}
        for part in fields(self):
            value = getattr(self, part.name)
            if part.name == "names":
                found[part.name] = [value[row] for row in rows]
            elif part.name == "extra":
                found[part.name] = {key: of[rows] for key, of in value.items()}
            elif part.name == "truth":
                found[part.name] = None if value is None else value.select(rows)
            elif isinstance(value, np.ndarray):
                found[part.name] = value[rows]
        return replace(self, **found)

    def without_truth(self) -> MaskData:
        """Return the masks alone."""
        return replace(self, truth=None, labelled=None)


# What a reader hands over, one at a time: a mask, or why there is none.


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
    """A mask that is not taken, and the reason, a key of `uplift.data.clean_masks.REASONS`."""

    name: str
    reason: str
