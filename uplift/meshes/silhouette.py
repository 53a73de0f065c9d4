"""Silhouettes of meshes: masks as a camera would see them, with where each shape then is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from uplift.masks.container import FILL, Placed
from uplift.meshes.mesh import Mesh

__all__ = ["cover", "draw_mask", "frame_mesh", "project", "render_masks"]

_FINER = 4
"""Samples along a pixel's side: 16 a pixel."""


def draw_mask(
    points: Float[np.ndarray, "vertices 2"], faces: Int[np.ndarray, "faces 3"], side: int
) -> UInt8[np.ndarray, "side side"]:
    """Return how much of each pixel the triangles cover, 0..255, of 16 samples a pixel.

    Points are in pixels of the mask: x right, y down, pixel i reaches from i to i + 1. Any winding;
    what is outside the mask is cut off.
    """
    covered = cover(np.asarray(points, float) * _FINER, faces, side * _FINER)
    counts = covered.reshape(side, _FINER, side, _FINER).sum((1, 3))
    return (counts * 255 / _FINER**2 + 0.5).astype(np.uint8)


def cover(
    points: Float[np.ndarray, "vertices 2"], faces: Int[np.ndarray, "faces 3"], side: int
) -> Bool[np.ndarray, "side side"]:
    """Return the pixels whose centre a triangle covers; points as `draw_mask` has them."""
    starts, ends, rows = _spans(np.asarray(points, float)[faces], side)
    # A sample is covered where more spans of its row have begun than have ended.
    width = side + 1
    change = np.bincount(rows * width + starts, minlength=side * width)
    change = change - np.bincount(rows * width + ends, minlength=side * width)
    return np.cumsum(change.reshape(side, width), 1)[:, :-1] > 0


def _spans(corners: np.ndarray, fine: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return first sample, last + 1 and row of each triangle's spans; samples lie at whole numbers + 1/2."""
    y = corners[..., 1]
    first = np.clip(np.ceil(y.min(1) - 0.5), 0, fine).astype(np.int64)
    count = np.clip(np.ceil(y.max(1) - 0.5), 0, fine).astype(np.int64) - first
    of = np.repeat(np.arange(len(corners)), np.maximum(count, 0))
    rows = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count) + first[of]
    middle = rows + 0.5
    low, high = np.full(len(of), np.inf), np.full(len(of), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start, end = corners[:, a], corners[:, b]
        rise = end[:, 1] - start[:, 1]
        slope = (end[:, 0] - start[:, 0]) / np.where(rise == 0, 1, rise)
        crosses = (start[of, 1] <= middle) != (end[of, 1] <= middle)
        x = start[of, 0] + (middle - start[of, 1]) * slope[of]
        np.minimum(low, x, out=low, where=crosses)
        np.maximum(high, x, out=high, where=crosses)
    begin = np.clip(np.ceil(np.minimum(low, fine) - 0.5), 0, fine).astype(np.int64)
    end = np.clip(np.ceil(np.maximum(high, 0) - 0.5), 0, fine).astype(np.int64)
    return begin, np.maximum(begin, end), rows


def project(
    points: Float[np.ndarray, "vertices 3"], distance: int | float | np.floating
) -> Float[np.ndarray, "vertices 2"]:
    """Return where points of the camera frame (`Placed`: units of the crop, depth 0 at the shape's origin) are seen."""
    return points[:, :2] / (1 + points[:, 2:] / distance)


def frame_mesh(
    points: Float[np.ndarray, "vertices 3"], distance: int | float | np.floating
) -> tuple[float, Float[np.ndarray, " 2"]]:
    """Return the scale and offset that centre a shape's box in its crop, its longer half side `FILL`.

    ``points`` are turned to the camera and in the shape's own units, as ``distance`` is. The camera aims at
    the middle of the box it sees, not at the shape's origin: the shape is moved sideways (``offset``) until
    the box's middle is on the optical axis, so `Placed`'s formula is exact, and no image is shifted.
    """
    weight = 1 / (1 + points[:, 2] / distance)
    flat = points[:, :2] * weight[:, None]
    moved = np.zeros(2)
    axes = np.arange(2)
    for _ in range(20):
        seen = flat + moved * weight[:, None]
        high, low = seen.argmax(0), seen.argmin(0)
        miss = seen[high, axes] + seen[low, axes]
        moved = moved - miss / (weight[high] + weight[low])
        if np.abs(miss).max() < 1e-12:
            break
    seen = flat + moved * weight[:, None]
    scale = FILL / max(float((seen.max(0) - seen.min(0)).max()) / 2, 1e-12)
    return scale, scale * moved


def render_masks(
    meshes: Sequence[Mesh],
    shape: Int[np.ndarray, " items"],
    view: Float[np.ndarray, "items 3 3"],
    distance: Float[np.ndarray, " items"],
    side: int,
) -> tuple[UInt8[np.ndarray, "items side side"], Placed]:
    """Return anti-aliased masks, cropped as `MaskData` has them, and where each shape is (`Placed`).

    ``view`` takes a shape's own frame to the camera's; the camera is ``distance`` from the shape's origin,
    in the shape's own units (infinite: parallel rays), and aims at the middle of what it sees (`frame_mesh`).
    """
    items = len(shape)
    masks = np.empty((items, side, side), np.uint8)
    scale, offset = np.empty(items), np.empty((items, 2))
    used: dict[int, np.ndarray] = {}
    for item, number in enumerate(shape.tolist()):
        mesh = meshes[number]
        if number not in used:
            used[number] = np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices)) > 0
        turned = mesh.vertices @ np.asarray(view[item], float).T
        scale[item], offset[item] = frame_mesh(turned[used[number]], distance[item])
        placed = scale[item] * turned
        placed[:, :2] += offset[item]
        seen = project(placed, scale[item] * distance[item])
        masks[item] = draw_mask((seen + 1) * (side / 2), mesh.faces, side)
    kept = (array.astype(np.float32) for array in (view, scale, offset, scale * distance))
    turned_to, scales, offsets, distances = kept
    return masks, Placed(meshes, shape, turned_to, scales, offsets, distances)
