"""A real camera's lens: focal length, optical axis and distortion, in pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Lens"]

_ITERATIONS = 12


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
            factor, shift = self._distortion(rays)
            rays = rays * factor + shift
        return rays * np.asarray(self.focal_px, rays.dtype) + np.asarray(self.centre_px, rays.dtype)

    def rays(self, keypoints: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape 2"]:
        """Return x/z and y/z of what is seen at ``keypoints`` (pixels), the distortion undone."""
        seen = (keypoints - np.asarray(self.centre_px, keypoints.dtype)) / np.asarray(self.focal_px, keypoints.dtype)
        if not self.bends:
            return seen
        rays = seen
        for _ in range(_ITERATIONS):  # a fixed point: real lenses shrink the error tenfold each time
            factor, shift = self._distortion(rays)
            rays = (seen - shift) / np.maximum(factor, 0.2)
        return rays

    def _distortion(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        square = (rays * rays).sum(-1, keepdims=True)
        k1, k2, k3 = self.radial
        bend = np.asarray(self.tangential, rays.dtype)
        factor = 1 + square * (k1 + square * (k2 + square * k3)) + (rays * bend).sum(-1, keepdims=True)
        return factor, bend * square
