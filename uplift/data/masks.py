"""`MaskData`: 2D masks, and what is known beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from uplift.data.samples import SHARED, TRUTH, Samples
from uplift.errors import UserError
from uplift.geometry.mesh import Mesh

__all__ = ["FILL", "Found", "MaskData", "Placed", "Skipped"]

FILL = 0.85
"""Half of the longer side of a mask's box, of the half side of its crop."""


@dataclass
class Placed(Samples):
    """Shapes and where each item has one: `scale` * (`view` @ point) + (`offset`, 0) is the item's camera frame.

    That frame is in units of the item's crop: x right and y down from -1 to 1 over the crop, z away from
    the camera; depth is relative, 0 at the shape's own origin. A point projects to
    (x, y) / (1 + (z / distance)), and to (x, y) where `distance` is infinite.
    """

    meshes: Sequence[Mesh] = field(metadata=SHARED)
    shape: Int[np.ndarray, " items"]
    """Which mesh, by its place in `meshes`; several items may show one."""
    view: Float[np.ndarray, "items 3 3"]
    """Rotation from the shape's own frame to the camera's."""
    scale: Float[np.ndarray, " items"]
    offset: Float[np.ndarray, "items 2"]
    distance: Float[np.ndarray, " items"]
    """Of the camera, in units of the crop."""

    @classmethod
    def concat(cls, parts: Sequence[Any], **changed: Any) -> Placed:
        """Return the items of all parts, one after the other, with the meshes of all."""
        first = np.cumsum([0, *(len(part.meshes) for part in parts[:-1])])
        shape = np.concatenate([part.shape + start for part, start in zip(parts, first, strict=True)])
        return super().concat(parts, meshes=[mesh for part in parts for mesh in part.meshes], shape=shape, **changed)


@dataclass
class MaskData(Samples):
    """Masks cut out, centred and scaled: the longer side of each one's box is `FILL` of its crop, the box's middle its centre.

    `truth` is never an input of training from masks alone; `labelled` says where it may be.
    """

    masks: UInt8[np.ndarray, "items side side"]
    """How much of each pixel the object covers, 0..255; row 0 is the top."""
    names: list[str]
    """Where each came from: a file, ``file:instance``, a mesh."""
    centre_px: Shaped[np.ndarray, "items 2"]
    """The crop's centre in the image the mask came from: x right, y down."""
    scale_px: Shaped[np.ndarray, " items"]
    """Pixels of that image in one unit, half the crop's side."""
    category: Shaped[np.ndarray, " items"] | None = None
    """Text: species, class."""
    images: Shaped[np.ndarray, " items"] | None = None
    """Text: the photo's file, where there is one, else empty."""
    truth: Placed | None = field(default=None, metadata=TRUTH)
    labelled: Bool[np.ndarray, " items"] | None = field(default=None, metadata=TRUTH)
    """Items whose truth training may learn from; None: no item's."""
    notes: tuple[str, ...] = ()
    """What was assumed, changed or skipped, one sentence each."""
    source: str = ""
    extra: dict[str, Shaped[np.ndarray, "items ..."]] = field(default_factory=dict)
    """Whatever a reader knows besides."""

    def __post_init__(self) -> None:
        if not isinstance(self.masks, np.ndarray):
            raise UserError(f"masks are {type(self.masks).__name__}, expected an array, uint8 (items, side, side).")
        if self.masks.ndim != 3 or self.masks.shape[1] != self.masks.shape[2] or self.masks.dtype != np.uint8:
            found = f"{self.masks.dtype} of shape {self.masks.shape}"
            raise UserError(f"masks are {found}, expected uint8 (items, side, side).")
        wrong = self.misfit()
        if wrong:
            raise UserError(f"{wrong}, one row for each mask.")

    @property
    def side(self) -> int:
        """Pixels along a crop."""
        return self.masks.shape[1]


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
