"""Several cameras of one scene: where they are, by the poses that each of them shows, and robust triangulation.

Plain geometry of numpy arrays: views first, then frames, then joints. A camera maps a point X of the world to its own
frame by R X + t (x right, y down, z away) and sees it at f (x/z, y/z) pixels from its optical axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from uplift.geometry.lens import place_roots
from uplift.geometry.rigid import nearest_rotation

__all__ = [
    "CUT", "ROUND_MEDIAN", "Cameras", "Points", "Seen", "cameras_from_poses", "intersection", "noise_of", "pull_of_keypoints", "triangulate",
    "trust_of", "weighted_median",
]  # fmt: skip

Points = Float[np.ndarray, "frames joints 3"]
Noise = Float[np.ndarray, "views #frames #joints"]

CUT = 3.0
"""Error, in standard deviations, at which an observation counts a quarter."""
ROUND_MEDIAN = 1.1774
"""The median distance from the middle of a round normal distribution, in standard deviations."""
_NEAREST = 0.1
"""Points at or behind a camera are held this far before it."""
_AS_MANY = 20
"""Keypoints of a joint that count as much as all others of its view."""
_FINEST_PX = 0.25
"""Keypoints are never taken as more exact than this."""


@dataclass(frozen=True)
class Seen:
    """Keypoints of the same moments in several cameras."""

    pixels: Float[np.ndarray, "views frames joints 2"]
    """From the optical axis, distortion undone; 0 where missing."""
    weight: Float[np.ndarray, "views frames joints"]
    """0..1, 0 = missing."""

    def at(self, frames: np.ndarray) -> Seen:
        """Return some of the frames."""
        return Seen(self.pixels[:, frames], self.weight[:, frames])


@dataclass(frozen=True)
class Cameras:
    """Where several cameras are, and their focal lengths."""

    rotation: Float[np.ndarray, "views 3 3"]
    """From the world to each camera."""
    translation: Float[np.ndarray, "views 3"]
    focal_px: Float[np.ndarray, " views"]

    def from_first(self) -> Cameras:
        """Return the same cameras where the world is the frame of the first of them."""
        rotation = self.rotation @ self.rotation[0].T
        return Cameras(rotation, self.translation - rotation @ self.translation[0], self.focal_px)

    def scaled(self, factor: float) -> Cameras:
        """Return the same cameras where lengths of the world are ``factor`` times as large."""
        return Cameras(self.rotation, self.translation * factor, self.focal_px)

    def to_cameras(self, points: Points) -> Float[np.ndarray, "views frames joints 3"]:
        """Return points of the world in the frame of each camera."""
        return np.einsum("vab,fjb->vfja", self.rotation, points) + self.translation[:, None, None]

    def errors(self, points: Points, seen: Seen) -> Float[np.ndarray, "views frames joints 2"]:
        """Return where the points are seen less where the keypoints are, pixels."""
        there = self.to_cameras(points)
        return there[..., :2] / np.maximum(there[..., 2:], _NEAREST) * self.focal_px[:, None, None, None] - seen.pixels

    def slopes(self, there: Float[np.ndarray, "views frames joints 3"]) -> Float[np.ndarray, "views frames joints 2 3"]:
        """Return how the pixels change with points ``there`` in each camera's frame."""
        z = np.maximum(there[..., 2], _NEAREST)
        slope = np.zeros((*there.shape[:-1], 2, 3))
        slope[..., 0, 0] = slope[..., 1, 1] = 1
        slope[..., 2] = -there[..., :2] / z[..., None]
        return slope * (self.focal_px[:, None, None] / z)[..., None, None]


# Robust estimates.


def weighted_median(values: np.ndarray, weight: np.ndarray) -> float:
    """Return the weighted median of all values; 0 without any weight."""
    values, weight = values.ravel(), weight.ravel()
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    if not len(total) or total[-1] <= 0:
        return 0.0
    return float(values[order[min(int(np.searchsorted(total, total[-1] / 2)), len(order) - 1)]])


def noise_of(
    errors: Float[np.ndarray, "views frames joints 2"], weight: Float[np.ndarray, "views frames joints"]
) -> Float[np.ndarray, "views 1 joints"]:
    """Return the standard deviation of the keypoints of each view and joint, pixels, robust to those that are wrong.

    It makes up for what a detector's confidences mean: only their ratios within one view and joint count. Where few
    keypoints of a joint are known, it is drawn to that of the view; and half-way to that of all, as points follow a view
    that is trusted most, which then seems to be exact.
    """
    far = np.linalg.norm(errors, axis=-1)
    every = max(weighted_median(far, weight), _FINEST_PX)
    noise = np.empty((len(far), 1, far.shape[2]))
    for view, (away, trust) in enumerate(zip(far, weight, strict=True)):
        usual = weighted_median(away, trust)
        own = np.array([weighted_median(*one) for one in zip(away.T, trust.T, strict=True)])
        count = (trust > 0).sum(0)
        noise[view, 0] = np.sqrt((count * own**2 + _AS_MANY * usual**2) / (count + _AS_MANY))
    return np.maximum(np.sqrt(np.maximum(noise, every / 4) * every) / ROUND_MEDIAN, _FINEST_PX)


def trust_of(
    errors: Float[np.ndarray, "views frames joints 2"], weight: Float[np.ndarray, "views frames joints"], noise: Noise
) -> Float[np.ndarray, "views frames joints"]:
    """Return the weights of keypoints in least squares, 1/px^2: those far off count little (Geman and McClure 1985)."""
    return weight / (1 + (errors**2).sum(-1) / (CUT * noise) ** 2) ** 2 / noise**2


# Where the cameras are, from the poses that each of them alone was lifted to.

_ROUNDS = 10
_UNSEEN = 0.1
"""Weight of a joint that the lifter filled in, beside 1 of one that was seen."""


def cameras_from_poses(
    poses: Float[np.ndarray, "views frames joints 3"], seen: Seen, focal_px: Float[np.ndarray, " views"]
) -> Cameras:
    """Return the cameras in the frame of the first, from lifted poses of bodies of the same size.

    The rotation between two cameras is the one that brings all poses of one onto those of the other (Procrustes,
    re-weighted: a pose that was lifted wrong counts little). Cameras are joined along the tree of the pairs that
    agree best, then turned to the mean of all. Places follow from where each camera sees the root.

    Args:
        poses: root-relative, each in its camera's frame, in one unit.
        seen: the keypoints; a frame that a camera does not see has weight 0 there.
        focal_px: of each camera.
    """
    rays = seen.pixels / focal_px[:, None, None, None]
    place = np.stack([place_roots(*one) for one in zip(poses, rays, seen.weight, strict=True)])
    placed = np.isfinite(place).all(-1, keepdims=True) & (seen.weight > 0).any(-1, keepdims=True)
    weight = np.where(placed, np.maximum(seen.weight, _UNSEEN), 0)
    order, rotation = _along_tree(poses, weight)
    rotation = _to_mean(poses, weight, rotation)
    translation, root = np.zeros((len(poses), 3)), np.full(place.shape, np.nan)
    root[0] = place[0]
    for view in order[1:]:
        known = np.isfinite(root)
        found = np.where(known, root, 0).sum(0) / np.where(known.any(0), known.sum(0), np.nan)
        translation[view] = np.nanmedian(place[view] - found @ rotation[view].T, axis=0)
        root[view] = (place[view] - translation[view]) @ rotation[view]
    return Cameras(rotation, translation, focal_px)


def _along_tree(poses: np.ndarray, weight: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Return the order in which views are joined to the first, and the rotations from its frame to theirs."""
    views = range(len(poses))
    pairs = {(a, b): _between(poses[a], poses[b], weight[a] * weight[b]) for a, b in combinations(views, 2)}
    rotation, order = np.tile(np.eye(3), (len(poses), 1, 1)), [0]
    while len(order) < len(poses):
        edges = [(a, b) for a in order for b in views if b not in order]
        a, b = max(edges, key=lambda edge: pairs[min(edge), max(edge)][1])
        turn = pairs[min(a, b), max(a, b)][0]
        rotation[b] = (turn if a < b else turn.T) @ rotation[a]
        order.append(b)
    return order, rotation


def _to_mean(poses: np.ndarray, weight: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return the rotations turned so that every view agrees best with the mean of all (generalised Procrustes)."""
    several = (weight > 0).sum(0) > 1
    for _ in range(_ROUNDS):
        mean = (poses @ rotation[:, None] * weight[..., None]).sum(0) / np.maximum(weight.sum(0), 1e-9)[..., None]
        rotation = np.stack([_between(mean, *one)[0] for one in zip(poses, weight * several, strict=True)])
        rotation = rotation @ rotation[0].T
    return rotation


def _between(one: np.ndarray, other: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rotation that takes the poses ``one`` to ``other``, and how much of them agrees."""
    trust, rotation = weight, np.eye(3)
    for _ in range(_ROUNDS):
        rotation, _ = nearest_rotation(np.einsum("fj,fja,fjb->ab", trust, other, one))
        away = ((other - one @ rotation.T) ** 2).sum(-1)
        trust = weight / (1 + away / max(weighted_median(away, weight), 1e-12)) ** 2
    return rotation, float(trust.sum())


# Triangulation that leaves out keypoints that are wrong.

_STEPS = 5


def triangulate(cameras: Cameras, seen: Seen) -> Points:
    """Return the points of the world that the keypoints are best seen from; NaN where fewer than two cameras see one.

    Of the points by all cameras and by any two, the one that most keypoints agree with is taken, so that one camera
    that is wrong does not spoil it; from there by robust least squares.
    """
    first = intersection(cameras, seen, seen.weight)
    known = np.isfinite(first).all(-1)
    noise = noise_of(cameras.errors(np.nan_to_num(first), seen), seen.weight * known)
    views = range(len(seen.weight))
    best, least = first, np.full(known.shape, np.inf)
    for chosen in [tuple(views), *(combinations(views, 2) if len(views) > 2 else [])]:
        of_chosen = np.isin(views, chosen)[:, None, None]
        point = intersection(cameras, seen, seen.weight * of_chosen)
        far = (cameras.errors(np.nan_to_num(point), seen) ** 2).sum(-1) / (CUT * noise) ** 2
        cost = np.where(np.isfinite(point).all(-1), (seen.weight * far / (1 + far)).sum(0), np.inf)
        best, least = np.where((cost < least)[..., None], point, best), np.minimum(cost, least)
    points, known = np.nan_to_num(best), np.isfinite(best[..., 0])
    for _ in range(_STEPS):
        gradient, matrix = pull_of_keypoints(cameras, seen, points, noise)
        size = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None]
        points = points - np.linalg.solve(matrix + (1e-6 * size + 1e-12) * np.eye(3), gradient[..., None])[..., 0]
    return np.where(known[..., None], points, np.nan)


def intersection(cameras: Cameras, seen: Seen, weight: np.ndarray) -> np.ndarray:
    """Return the points nearest to the rays of all keypoints; NaN where fewer than two count, or rays are parallel."""
    ray = np.concatenate([seen.pixels / cameras.focal_px[:, None, None, None], np.ones((*weight.shape, 1))], -1)
    ray = np.einsum("vfja,vab->vfjb", ray / np.linalg.norm(ray, axis=-1, keepdims=True), cameras.rotation)
    centre = -np.einsum("vab,va->vb", cameras.rotation, cameras.translation)
    across = (np.eye(3) - ray[..., :, None] * ray[..., None, :]) * weight[..., None, None]
    matrix, right = across.sum(0), np.einsum("vfjab,vb->fja", across, centre)
    known = ((weight > 0).sum(0) > 1) & (np.linalg.det(matrix) > 1e-9 * weight.sum(0) ** 3)
    point = np.full((*weight.shape[1:], 3), np.nan)
    point[known] = np.linalg.solve(matrix[known], right[known][..., None])[..., 0]
    return point


def pull_of_keypoints(
    cameras: Cameras, seen: Seen, points: Points, noise: Noise
) -> tuple[Points, Float[np.ndarray, "frames joints 3 3"]]:
    """Return gradient and curvature (Gauss and Newton's) of half the robust squared errors with respect to the points."""
    errors = cameras.errors(points, seen)
    trust = trust_of(errors, seen.weight, noise)
    slope = cameras.slopes(cameras.to_cameras(points)) @ cameras.rotation[:, None, None]
    gradient = np.einsum("vfj,vfja,vfjab->fjb", trust, errors, slope)
    return gradient, np.einsum("vfjab,vfjac->fjbc", slope * trust[..., None, None], slope)
