"""Bundle adjustment: cameras and points for which the keypoints are where the points are seen (Triggs et al. 2000)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from uplift.geometry.multiview import (
    ROUND_MEDIAN,
    Cameras,
    Points,
    Seen,
    intersection,
    noise_of,
    trust_of,
    weighted_median,
)
from uplift.geometry.rigid import rotation_by

__all__ = ["adjust_cameras"]

_MOST_STEPS = 40
_ENOUGH = 1e-5
"""Share of the cost: a step that gains less is the last."""


def adjust_cameras(cameras: Cameras, seen: Seen, focal_sd: Float[np.ndarray, " views"]) -> Cameras:
    """Return the cameras that the keypoints of all frames agree with best; the first stays where it is.

    Levenberg and Marquardt's steps on robust weights, the points eliminated by their Schur complement. First with a
    cost that grows with the error itself, under which far wrong cameras still find home, then with one that leaves
    wrong keypoints out. The scale of the world is not told by keypoints, and stays about as it is.

    Args:
        cameras: where they are about.
        seen: the keypoints; points that fewer than two cameras see do not count.
        focal_sd: standard deviation of the logarithm of each focal length about its value; 0 holds it.
    """
    # The points in the middle of all rays, not those that two views agree on: the cost would leave them there.
    points = intersection(cameras, seen, seen.weight)
    known = np.isfinite(points).all(-1)
    problem = _Problem(replace(seen, weight=seen.weight * known), cameras.focal_px, focal_sd)
    points = np.nan_to_num(points)
    for soft in (True, False):
        cameras, points = problem.solved(cameras, points, soft=soft)
    return cameras


@dataclass(frozen=True)
class _Problem:
    """What is known: keypoints, and focal lengths as far as they are."""

    seen: Seen
    focal_px: Float[np.ndarray, " views"]
    focal_sd: Float[np.ndarray, " views"]

    def solved(self, cameras: Cameras, points: Points, *, soft: bool) -> tuple[Cameras, Points]:
        """Return cameras and points after steps that no longer gain."""
        damping = 1e-3
        noise = self._noise(cameras, points, soft)
        for _ in range(_MOST_STEPS):
            trust = self._trust(cameras, points, noise, soft)
            before = self._cost(cameras, points, trust)
            moved, places = self._step(cameras, points, trust, damping)
            after = self._cost(moved, places, trust)
            if after < before:
                cameras, points, damping = moved, places, max(damping / 5, 1e-9)
                noise = self._noise(cameras, points, soft)
            else:
                damping *= 10
            if damping > 1e6 or before * (1 - _ENOUGH) < after < before:
                break
        return cameras, points

    def _noise(self, cameras: Cameras, points: Points, soft: bool) -> np.ndarray:
        errors, weight = cameras.errors(points, self.seen), self.seen.weight
        if not soft:
            return noise_of(errors, weight)
        # One for all: a view that is off as a whole must not make up for it by more noise of its own.
        usual = weighted_median(np.linalg.norm(errors, axis=-1), weight) / ROUND_MEDIAN
        return np.full((1, 1, 1), max(usual, 1e-6))

    def _trust(self, cameras: Cameras, points: Points, noise: np.ndarray, soft: bool) -> np.ndarray:
        errors, weight = cameras.errors(points, self.seen), self.seen.weight
        if not soft:
            return trust_of(errors, weight, noise)
        return weight / noise**2 / np.sqrt(1 + (errors**2).sum(-1) / noise**2)

    def _cost(self, cameras: Cameras, points: Points, trust: np.ndarray) -> float:
        off = np.log(cameras.focal_px / self.focal_px)[self.focal_sd > 0] / self.focal_sd[self.focal_sd > 0]
        return float((trust * (cameras.errors(points, self.seen) ** 2).sum(-1)).sum() + (off**2).sum())

    def _step(self, cameras: Cameras, points: Points, trust: np.ndarray, damping: float) -> tuple[Cameras, Points]:
        """Return cameras and points after one damped step."""
        views, errors = len(trust), cameras.errors(points, self.seen)
        by_camera, by_point = self._slopes(cameras, points, errors)
        weighted = by_camera * trust[..., None, None]
        own = np.einsum("vfjac,vfjad->vcd", weighted, by_camera)
        right = np.einsum("vfjac,vfja->vc", weighted, errors)
        own[:, 6, 6] += 1 / np.maximum(self.focal_sd, 1e-9) ** 2
        right[:, 6] += np.log(cameras.focal_px / self.focal_px) / np.maximum(self.focal_sd, 1e-9) ** 2
        cross = np.einsum("vfjac,vfjad->vcfjd", weighted, by_point)
        of_points = np.einsum("vfj,vfja,vfjab->fjb", trust, errors, by_point)
        inverse = _damped_inverse(np.einsum("vfj,vfjab,vfjac->fjbc", trust, by_point, by_point), damping)
        carried = np.einsum("vcfjd,fjde->vcfje", cross, inverse).reshape(views * 7, -1)
        flat = cross.reshape(views * 7, -1)
        whole = np.zeros((views, 7, views, 7))
        whole[range(views), :, range(views)] = own * (1 + damping * np.eye(7))
        whole = whole.reshape(views * 7, views * 7) - carried @ flat.T
        free = np.flatnonzero(self._free())
        step = np.zeros(views * 7)
        right = right.ravel() - carried @ of_points.ravel()
        step[free] = -np.linalg.lstsq(whole[np.ix_(free, free)], right[free], rcond=None)[0]
        of_points = of_points + (flat.T @ step).reshape(points.shape)
        return _moved(cameras, step.reshape(views, 7)), points - np.einsum("fjab,fjb->fja", inverse, of_points)

    def _slopes(self, cameras: Cameras, points: Points, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how the pixels change with each camera (a turn, a shift, the log of the focal length) and with the points."""
        there = cameras.to_cameras(points)
        slope = cameras.slopes(there)
        by_turn = np.cross((there - cameras.translation[:, None, None])[..., None, :], slope)  # d(RX) = w x RX
        by_focal = (errors + self.seen.pixels)[..., None]
        return np.concatenate([by_turn, slope, by_focal], -1), slope @ cameras.rotation[:, None, None]

    def _free(self) -> np.ndarray:
        free = np.ones((len(self.focal_px), 7), bool)
        free[0, :6], free[:, 6] = False, self.focal_sd > 0
        return free


def _damped_inverse(matrix: np.ndarray, damping: float) -> np.ndarray:
    size = np.trace(matrix, axis1=-2, axis2=-1).max(initial=0)
    return np.linalg.inv(matrix * (1 + damping * np.eye(3)) + 1e-12 * (1 + size) * np.eye(3))


def _moved(cameras: Cameras, step: Float[np.ndarray, "views 7"]) -> Cameras:
    """Return the cameras turned, shifted and zoomed."""
    return Cameras(
        rotation_by(step[:, :3]) @ cameras.rotation,
        cameras.translation + step[:, 3:6],
        cameras.focal_px * np.exp(step[:, 6]),
    )
