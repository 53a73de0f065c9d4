"""Masks of the bodies beside their keypoints: crops of the same images, and the way from a keypoint into its crop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError

if TYPE_CHECKING:
    from uplift.data.container import PoseData
    from uplift.normalise import Intrinsics

__all__ = ["check_masks", "joined_masks", "mask_maps", "masked_frames", "masks_of"]

_SMALLEST = 8


def masks_of(where: str, arrays: dict[str, np.ndarray], frames: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return a file's `masks` as coverage 0..255 and `mask_box` as float32, NaN for frames without one; both None where absent.

    Raises:
        UserError: one without the other, another type or shape, a box of negative side.
    """
    masks, box = arrays.get("masks"), arrays.get("mask_box")
    if masks is None or box is None:
        check_masks(where, masks, box, frames)
        return None, None
    if masks.dtype == np.bool_:
        masks = masks.astype(np.uint8) * np.uint8(255)
    if box.dtype.kind in "iuf":
        box = box.astype(np.float32)
    check_masks(where, masks, box, frames)
    if masks.size and masks.max() == 1:  # written as 0 and 1
        masks = masks * np.uint8(255)
    without = ~np.isfinite(box).all(1) | (box[:, 2] == 0)
    if (box[~without, 2] < 0).any():
        raise UserError(f"{where}: 'mask_box' has negative sides, expected x0, y0, side in px of each crop.")
    box = np.where(without[:, None], np.float32(np.nan), box)
    return masks, box


def check_masks(where: str, masks: Any, box: Any, frames: int) -> None:
    """Raise UserError for masks and boxes that cannot be those of ``frames`` frames."""
    if (masks is None) != (box is None):
        there, gone = ("mask_box", "masks") if masks is None else ("masks", "mask_box")
        raise UserError(
            f"{where}: '{there}' without '{gone}': a mask needs both, the crops (frames, side, side) and where each is "
            "in the image, x0, y0, side in px (frames, 3)."
        )
    if masks is None:
        return
    if masks.ndim != 3 or len(masks) != frames or masks.shape[1] != masks.shape[2] or masks.dtype != np.uint8:
        raise UserError(
            f"{where}: 'masks' is {masks.dtype} of shape {masks.shape}, expected uint8 ({frames}, side, side): square "
            "crops, 0 outside the body and 255 inside; zeros for a frame without a mask."
        )
    if frames and masks.shape[1] < _SMALLEST:
        raise UserError(f"{where}: 'masks' are {masks.shape[1]} px a side, expected {_SMALLEST} at least.")
    if box.shape != (frames, 3) or box.dtype.kind != "f":
        raise UserError(
            f"{where}: 'mask_box' is {box.dtype} of shape {box.shape}, expected numbers ({frames}, 3): x0, y0, side of "
            "each crop, px in the image; NaN for a frame without a mask."
        )


def masked_frames(masks: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return (frames,) bool: the frame has a place for its mask, and something in it."""
    return np.isfinite(box).all(1) & (box[:, 2] > 0) & (masks > 127).any((1, 2))


def joined_masks(parts: Sequence[PoseData]) -> dict[str, np.ndarray | None]:
    """Return the masks and boxes of all parts, one after the other; empty masks for a part without any.

    Raises:
        UserError: crops of different sides.
    """
    sides = {part.masks.shape[1] for part in parts if part.masks is not None}
    if not sides:
        return {"masks": None, "mask_box": None}
    if len(sides) > 1:
        raise UserError(f"masks of {' and '.join(map(str, sorted(sides)))} px a side; files must agree to be joined.")
    (side,) = sides
    masks, boxes = [], []
    for part in parts:
        masks.append(np.zeros((len(part), side, side), np.uint8) if part.masks is None else part.masks)
        boxes.append(np.full((len(part), 3), np.nan, np.float32) if part.mask_box is None else part.mask_box)
    return {"masks": np.concatenate(masks), "mask_box": np.concatenate(boxes)}


def mask_maps(
    data: PoseData,
    root: int,
    scale_px: np.ndarray,
    rotation: np.ndarray | None = None,
    intrinsics: Intrinsics | None = None,
) -> Float[np.ndarray, "frames 3 3"]:
    """Return what takes normalised keypoints (x, y, 1) to their crop, (u w, v w, w): u, v from -1 to 1 over it.

    A plain scale and shift, but with a camera that was turned to look at the root (`uplift.normalise`):
    its picture is turned back. NaN for frames without a mask.
    """
    assert data.masks is not None and data.mask_box is not None
    box = np.where(masked_frames(data.masks, data.mask_box)[:, None], data.mask_box, np.nan).astype(np.float64)
    frames = len(box)
    crop = np.zeros((frames, 3, 3))  # from px of the image
    crop[:, 0, 0] = crop[:, 1, 1] = 2 / box[:, 2]
    crop[:, :2, 2] = -2 * box[:, :2] / box[:, 2:] - 1
    crop[:, 2, 2] = np.where(np.isnan(box[:, 2]), np.nan, 1)
    image = np.zeros((frames, 3, 3))  # from normalised keypoints
    if rotation is None or intrinsics is None:
        image[:, 0, 0] = image[:, 1, 1] = scale_px
        image[:, :2, 2] = data.keypoints[:, root]
        image[:, 2, 2] = 1
    else:
        image[:, 0, 0] = image[:, 1, 1] = scale_px / intrinsics.focal_px
        image[:, 2, 2] = 1
        back = rotation.astype(np.float64).transpose(0, 2, 1)
        x, y = intrinsics.centre_px
        image = np.array([[intrinsics.focal_px, 0, x], [0, intrinsics.focal_px, y], [0, 0, 1]]) @ back @ image
    return (crop @ image).astype(np.float32)
