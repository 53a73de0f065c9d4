"""A lifted shape whose front, left and top differ, with its exact mask."""

from __future__ import annotations

import numpy as np
from skimage.draw import polygon

from uplift.export.meshes import in_camera
from uplift.geometry.surface import surface_of
from uplift.models.prediction import ShapePrediction

__all__ = ["AZIMUTH", "OFFSET", "SCALE", "SCALE_PX", "TILT", "marked", "mask_of", "shapes", "view"]

TILT, AZIMUTH = np.radians(25), np.radians(40)
SCALE, OFFSET, SCALE_PX = 0.8, (0.1, -0.2), 150.0
_R = 32


def marked() -> np.ndarray:
    """Return a cube with a long horn at the front, a medium one on the left and a short one on top."""
    line = (2 * np.arange(_R) + 1) / _R - 1
    z, y, x = np.meshgrid(line, line, line, indexing="ij")
    grid = (np.abs(x) < 0.25) & (np.abs(y) < 0.25) & (np.abs(z) < 0.25)
    grid |= (np.abs(x) < 0.12) & (np.abs(y) < 0.12) & (z < 0) & (z > -0.9)
    grid |= (np.abs(z) < 0.12) & (np.abs(y) < 0.12) & (x > 0) & (x < 0.7)
    grid |= (np.abs(z) < 0.12) & (np.abs(x) < 0.12) & (y < 0) & (y > -0.5)
    return grid.astype(np.float32)


def view(tilt: float = TILT, azimuth: float = AZIMUTH) -> np.ndarray:
    """Return the rotation from the object's frame to that of a camera at an azimuth that looks down."""
    down = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    turn = np.array([[np.cos(azimuth), 0, np.sin(azimuth)], [0, 1, 0], [-np.sin(azimuth), 0, np.cos(azimuth)]])
    return down @ turn


def mask_of(grid: np.ndarray, distance: float = np.inf, side: int = 64) -> np.ndarray:
    """Return the mask of a grid's surface as seen by the sample's camera from ``distance``."""
    mesh = surface_of(grid).mesh
    assert mesh is not None
    points = in_camera(mesh.vertices, view(), SCALE, np.zeros(2))
    flat = (points[:, :2] + OFFSET) / (1 + points[:, 2:] / distance)
    pixels = ((flat + 1) / 2 * 4 * side) - 0.5
    fine = np.zeros((4 * side, 4 * side), np.float32)
    for face in mesh.faces:
        fine[polygon(pixels[face, 1], pixels[face, 0], fine.shape)] = 255
    return np.rint(fine.reshape(side, 4, side, 4).mean((1, 3))).astype(np.uint8)


def shapes(count: int = 1, names: list[str] | None = None, distance: float = np.inf) -> ShapePrediction:
    """Return ``count`` copies of the shape."""
    grid = marked()
    return ShapePrediction(
        np.stack([grid] * count), np.stack([view()] * count), np.full(count, SCALE), np.tile(OFFSET, (count, 1)),
        np.full(count, distance), np.stack([mask_of(grid, distance)] * count),
        names or [f"item {number}" for number in range(count)], np.full((count, 2), 320.0), np.full(count, SCALE_PX),
    )  # fmt: skip
