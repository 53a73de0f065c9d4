"""Keypoints of images that were turned or mirrored, or whose y grows upwards, as an upright image has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uplift.data.poses import PoseData

__all__ = ["turned"]

_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""A quarter turn clockwise, x right, y down."""


def turned(data: PoseData, *, flip_x: bool = False, flip_y: bool = False, rotate: int = 0) -> PoseData:
    """Return ``data`` with x or y counted from the other side of the image, and the image then turned clockwise.

    ``rotate`` is 0, 90, 180 or 270 degrees; a quarter turn swaps width and height. Masks and their boxes go along.
    Without an image size the turn is about the middle of the visible keypoints. What a lens bends is straightened
    first. Frames with poses stay as they are: these say which way is up. Notes say all that.
    """
    if not (flip_x or flip_y or rotate):
        return data
    asked = ", ".join(
        [f"flip_{axis}" for axis, on in (("x", flip_x), ("y", flip_y)) if on] + [f"rotate={rotate}"] * bool(rotate)
    )
    if data.pose is not None:
        note = f"{asked} is not done: the file has poses, in a camera frame whose y points down, and goes by these"
        return replace(data, notes=(*data.notes, note))
    data = data.straightened()
    matrix = np.linalg.matrix_power(_QUARTER, rotate // 90) @ np.diag(
        [-1.0 if flip_x else 1.0, -1.0 if flip_y else 1.0]
    )
    shift, size, how = _placed(data, matrix)
    seen = data.confidence > 0
    keypoints = np.where(seen[..., None], data.keypoints @ matrix.T + shift, data.keypoints).astype(np.float32)
    masks, box = data.masks, data.mask_box
    if masks is not None and box is not None:
        masks, box = _turned_masks(masks, flip_x, flip_y, rotate), _turned_boxes(box, matrix, shift)
    notes = (*data.notes, f"{asked}: {how}")
    return replace(data, keypoints=keypoints, image_size=size, masks=masks, mask_box=box, notes=notes)


def _placed(data: PoseData, matrix: np.ndarray) -> tuple[np.ndarray, tuple[int, int] | None, str]:
    """Return what is added after ``matrix``, the new size of the image, and what was done, in words."""
    if data.image_size is not None:
        across, down = np.abs(matrix @ data.image_size).round().astype(int).tolist()
        return (
            _corner(matrix, data.image_size),
            (across, down),
            f"{_formula('x', matrix[0], across)}, {_formula('y', matrix[1], down)}",
        )
    points = data.keypoints[(data.confidence > 0) & np.isfinite(data.keypoints).all(-1)].astype(np.float64)
    middle = np.median(points, 0) if len(points) else np.zeros(2)
    how = (
        f"about the middle of the keypoints ({middle[0]:.0f}, {middle[1]:.0f}), as the size of the image is not known: "
        "where they are in the image is not, either, and the camera's centre needs image_size=WIDTHxHEIGHT"
    )
    return middle - matrix @ middle, None, how


def _corner(matrix: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return what brings the turned image's upper left corner to 0, 0."""
    corners = np.array([[0, 0], [size[0], 0], [0, size[1]], size]) @ matrix.T
    return -corners.min(0)


def _formula(axis: str, row: np.ndarray, most: int) -> str:
    """Return, as text, what a coordinate becomes."""
    old, sign = ("x", row[0]) if row[0] else ("y", row[1])
    return f"{axis} is {f'{most} - {old}' if sign < 0 else old}"


def _turned_masks(masks: np.ndarray, flip_x: bool, flip_y: bool, rotate: int) -> np.ndarray:
    """Return the crops, mirrored and turned as the image is."""
    masks = masks[:, ::-1] if flip_y else masks
    masks = masks[:, :, ::-1] if flip_x else masks
    return np.ascontiguousarray(np.rot90(masks, -(rotate // 90), axes=(1, 2)))


def _turned_boxes(box: np.ndarray, matrix: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return x0, y0 and side of the crops in the turned image."""
    ends = [corner @ matrix.T + shift for corner in (box[:, :2], box[:, :2] + box[:, 2:])]
    return np.concatenate([np.minimum(*ends), box[:, 2:]], 1).astype(np.float32)
