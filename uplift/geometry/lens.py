"""Real cameras: a lens with focal length, optical axis and distortion in pixels, and the root translation of a body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Lens", "place_roots"]

_ITERATIONS = 12
_BLOCK = 1 << 15  # points whose intermediate values stay in the processor's cache


@dataclass(frozen=True)
class Lens:
    """Pinhole camera with Brown's distortion, in the form that Human3.6M's cameras are published in.

    With x, y the undistorted ray and r2 = x² + y², the distorted ray is (x, y) times
    1 + k1 r2 + k2 r2² + k3 r2³ + a x + b y, plus (a, b) r2; `radial` is (k1, k2, k3) and `tangential`
    (a, b). OpenCV has 2 a x and 2 b y there, and (b, a) for its p1, p2: so does a lens that is `opencv`.
    """

    focal_px: tuple[float, float]
    """Along x and y."""
    centre_px: tuple[float, float]
    """The pixel of the optical axis."""
    radial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)
    image_size: tuple[int, int] | None = None
    opencv: bool = False

    @classmethod
    def ideal(cls, focal_px: float, image_size: tuple[int, int]) -> Lens:
        """Return a lens without distortion whose optical axis is the middle of the image."""
        return cls((focal_px, focal_px), (image_size[0] / 2, image_size[1] / 2), image_size=image_size)

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
        c, d = (2 * a, 2 * b) if self.opencv else (a, b)
        return 1 + square * (k1 + square * (k2 + square * k3)) + c * x + d * y, (a * square, b * square)


def place_roots(
    pose: Float[np.ndarray, "frames joints 3"],
    rays: Float[np.ndarray, "frames joints 2"],
    confidence: Float[np.ndarray, "frames joints"],
) -> Float[np.ndarray, "frames 3"]:
    """Return the root's place for which each pose projects onto its keypoints best, in the pose's unit.

    ``rays`` are keypoints as x/z and y/z of the camera frame. For a pose of known size the two
    equations of each joint, x + X = ray (z + Z), are linear in the place (X, Y, Z); they are solved
    by least squares, weighted by confidence. NaN where fewer than three joints are seen.
    """
    known = np.isfinite(pose).all(-1) & np.isfinite(rays).all(-1) & (confidence > 0)
    weight = np.where(known, confidence, 0).astype(np.float64)
    ray, pose = np.where(known[..., None], rays, 0.0), np.where(known[..., None], pose, 0.0)
    # The normal equations of [1 0 -rx; 0 1 -ry] (X Y Z) = ray z - xy.
    right = ray * pose[..., 2:] - pose[..., :2]
    total = weight.sum(1)
    across = -(weight[..., None] * ray).sum(1)
    square = (weight * (ray**2).sum(-1)).sum(1)
    matrix = np.zeros((len(pose), 3, 3))
    matrix[:, 0, 0] = matrix[:, 1, 1] = total
    matrix[:, 0, 2] = matrix[:, 2, 0] = across[:, 0]
    matrix[:, 1, 2] = matrix[:, 2, 1] = across[:, 1]
    matrix[:, 2, 2] = square
    flat = (weight[..., None] * right).sum(1)
    vector = np.concatenate([flat, -(weight * (ray * right).sum(-1)).sum(1)[:, None]], 1)
    place = np.full((len(pose), 3), np.nan)
    spread = square - (across**2).sum(1) / np.maximum(total, 1e-12)  # 0 where all are seen in one point
    solvable = (known.sum(1) >= 3) & (spread > 1e-12 * np.maximum(total, 1e-12))
    place[solvable] = np.linalg.solve(matrix[solvable], vector[solvable][..., None])[..., 0]
    return place
