"""Silhouettes of occupancy grids and meshes, in the input view and in new views about gravity, and their overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from uplift.evaluation.shape_standing import Standing
from uplift.meshes.silhouette import cover
from uplift.views import about_y

__all__ = ["NEW_AZIMUTHS_DEG", "SIDE", "Silhouette", "drawn", "of_mask", "overlap", "seen_iou", "silhouette", "turns"]

SIDE = 64
"""Pixels along the crop in the input view, and along the truth's bounding sphere in a new one."""
NEW_AZIMUTHS_DEG = tuple(range(40, 360, 40))
"""Turns about gravity from the input view: evenly spread, none nearer to it than 40 degrees, none opposite it."""


@dataclass(frozen=True)
class Silhouette:
    """Covered pixels of an endless image; the corner of four pixels is at its middle."""

    row: int
    """Of the first row of ``covered``."""
    column: int
    covered: Bool[np.ndarray, "height width"]


_NOTHING = Silhouette(0, 0, np.zeros((0, 0), bool))
_NEAREST = 0.05
"""Least distance from the camera, of its distance: what is nearer is drawn as if it were there."""
_FARTHEST = 2 * SIDE
"""Pixels from the middle beyond which nothing is drawn."""


def silhouette(shape: Standing, pixel: float) -> Silhouette:
    """Return the pixels whose centre's ray meets the shape's surface at its level; ``pixel`` is a pixel's side."""
    vertices, faces = shape.surface
    return drawn(shape.to_camera(vertices), faces, shape.distance, pixel)


def drawn(
    points: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], distance: float, pixel: float
) -> Silhouette:
    """Return the pixels whose centre's ray meets one of the triangles; ``points`` are in the camera frame."""
    if not len(faces):
        return _NOTHING
    image = points[:, :2] / np.maximum(1 + points[:, 2:] / distance, _NEAREST) / pixel
    low = np.clip(np.floor(image.min(0)), -_FARTHEST, _FARTHEST).astype(int)
    width, height = (np.clip(np.ceil(image.max(0)), -_FARTHEST, _FARTHEST).astype(int) - low).tolist()
    if not width or not height:
        return _NOTHING
    return Silhouette(int(low[1]), int(low[0]), cover(image - low, faces, max(width, height))[:height, :width])


def of_mask(mask: np.ndarray) -> Silhouette:
    """Return the pixels of a crop (side side, 0 to 255) of which more than half is covered, at `SIDE` pixels."""
    covered = torch.from_numpy(mask.astype(np.float32))[None, None]
    if mask.shape[0] != SIDE:
        covered = torch.nn.functional.interpolate(covered, (SIDE, SIDE), mode="area")
    return Silhouette(-SIDE // 2, -SIDE // 2, (covered[0, 0] > 127.5).numpy())


def overlap(first: Silhouette, second: Silhouette) -> float:
    """Return the pixels that both cover, of those that either covers; 0 where neither covers any."""
    low = max(first.row, second.row), max(first.column, second.column)
    high = [
        min(a + n, b + m)
        for a, n, b, m in zip(
            (first.row, first.column),
            first.covered.shape,
            (second.row, second.column),
            second.covered.shape,
            strict=True,
        )
    ]
    parts = [
        s.covered[
            max(low[0] - s.row, 0) : max(high[0] - s.row, 0), max(low[1] - s.column, 0) : max(high[1] - s.column, 0)
        ]
        for s in (first, second)
    ]
    shared = int((parts[0] & parts[1]).sum()) if parts[0].size and parts[1].size else 0
    either = int(first.covered.sum()) + int(second.covered.sum()) - shared
    return shared / either if either else 0.0


def seen_iou(shape: Standing, mask: np.ndarray) -> float:
    """Return the overlap of a shape's silhouette in its own camera with the input mask's."""
    return overlap(silhouette(shape, 2 / SIDE), of_mask(mask))


def turns(view: Float[np.ndarray, "3 3"]) -> list[np.ndarray]:
    """Return the rotations of the camera frame that turn a shape seen from ``view`` about its own y, gravity."""
    azimuth = torch.deg2rad(torch.tensor(NEW_AZIMUTHS_DEG, dtype=torch.float64))
    return [view @ turn @ view.T for turn in about_y(azimuth).numpy()]
