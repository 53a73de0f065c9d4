"""Masks of meshes as a camera would see them, with where each shape then is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int, UInt8

from uplift.masks.container import FILL, Placed
from uplift.meshes.mesh import Mesh
from uplift.meshes.silhouette import draw_mask, project

__all__ = ["frame_mesh", "render_masks"]


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
