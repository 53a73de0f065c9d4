"""A real camera's lens: focal length, optical axis and distortion, in pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Lens"]

_ITERATIONS = 12
_BLOCK = 1 << 15  # points whose intermediate values stay in the processor's cache


@dataclass(frozen=True)
class Lens:
    """Pinhole camera with Brown's distortion, in the form that Human3.6M's cameras are published in.

    With x, y the undistorted ray and r2 = x² + y², the distorted ray is (x, y) times
    1 + k1 r2 + k2 r2² + k3 r2³ + a x + b y, plus (a, b) r2; `radial` is (k1, k2, k3) and `tangential`
    (a, b). OpenCV has 2 a x and 2 b y there.
    """

    focal_px: tuple[float, float]
    """Along x and y."""
    centre_px: tuple[float, float]
    """The pixel of the optical axis."""
    radial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)
    image_size: tuple[int, int] | None = None

    @property
    def bends(self) -> bool:
        """Whether there is any distortion."""
        return any(self.radial) or any(self.tangential)

    def project(self, points: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 2"]:
        """Return the pixels of points in the camera frame (x right, y down, z away; any unit)."""
        rays = points[..., :2] / points[..., 2:]
        if self.bends:
            x, y = rays[..., 0], rays[..., 1]
            factor, shift = self._distortion(x, y)
            rays = np.stack([x * factor + shift[0], y * factor + shift[1]], -1)
        return rays * np.asarray(self.focal_px, rays.dtype) + np.asarray(self.centre_px, rays.dtype)

    def rays(self, keypoints: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape 2"]:
        """Return x/z and y/z of what is seen at ``keypoints`` (pixels), the distortion undone."""
        rays = np.empty_like(keypoints)
        flat, straight = keypoints.reshape(-1, 2), rays.reshape(-1, 2)
        focal, centre = np.asarray(self.focal_px, rays.dtype), np.asarray(self.centre_px, rays.dtype)
        for start in range(0, len(flat), _BLOCK):
            rows = slice(start, start + _BLOCK)
            x, y = (flat[rows, axis] - centre[axis] for axis in (0, 1))
            x /= focal[0]
            y /= focal[1]
            straight[rows, 0], straight[rows, 1] = self._straight(x, y) if self.bends else (x, y)
        return rays

    def _straight(self, seen_x: np.ndarray, seen_y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x and y of the rays that are seen at x and y: a fixed point of the distortion."""
        x, y = seen_x, seen_y
        enough = 4 * np.finfo(x.dtype).eps
        for _ in range(_ITERATIONS):  # real lenses shrink the error tenfold each time
            factor, shift = self._distortion(x, y)
            np.maximum(factor, 0.2, out=factor)
            last, x, y = (x, y), (seen_x - shift[0]) / factor, (seen_y - shift[1]) / factor
            if np.abs(x - last[0]).max() < enough and np.abs(y - last[1]).max() < enough:
                break
        return x, y

    def _distortion(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Return what rays are multiplied by, and what is added to x and y."""
        square = x * x + y * y
        k1, k2, k3 = self.radial
        a, b = self.tangential
        return 1 + square * (k1 + square * (k2 + square * k3)) + a * x + b * y, (a * square, b * square)
