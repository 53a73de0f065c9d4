"""One body from several known cameras: what they see, what each of them was lifted to, steady bones, smooth motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from uplift.geometry.lens import place_roots
from uplift.geometry.multiview import (
    CUT,
    Cameras,
    Points,
    Seen,
    noise_of,
    pull_of_keypoints,
    triangulate,
    weighted_median,
)

__all__ = ["fuse"]

_ROUNDS, _FIRST_ROUNDS, _MOST_STEPS = 10, 4, 40
_NEIGHBOURS = 10
"""How often the cost of a frame is averaged with those of its neighbours before views are left out by it."""
_LENGTH_SD = 0.03
"""Standard deviation of a bone's length over a clip, as a share of it: joints are not found where they are to the mm."""
_CHI3_MEDIAN = 2.366
"""The median of a sum of three squared standard normal values."""
_MEAN_OF_ROOT = float(np.sqrt(8 / (3 * np.pi)))
"""The mean length of a round normal vector, over the root of its mean square."""
_UNSEEN = 0.1
"""Weight of a joint that the lifter filled in, beside 1 of one that was seen."""
_SLOWEST = 0.1
"""Accelerations are not taken as smaller than this share of what is measured, noise and all."""


def fuse(
    cameras: Cameras,
    seen: Seen,
    lifted: Float[np.ndarray, "views frames joints 3"],
    bones: Int[np.ndarray, "bones 2"],
    triples: Int[np.ndarray, "triples 3"],
) -> tuple[Points, Float[np.ndarray, "frames joints"]]:
    """Return the joints in the world, and the error to expect of each, both in the world's unit.

    The robust minimum of: distances to the keypoints of all cameras, each in standard deviations of its camera and
    joint; bones near those that the views were lifted to, which decides where fewer than two cameras see a joint or
    their rays run together; lengths of bones that stay; small accelerations. What each term weighs is estimated from
    the clip itself. Gauss and Newton's steps on re-weighted terms, each solved by conjugate gradients.

    Args:
        cameras, seen: what is known; every frame is seen by a camera.
        lifted: root-relative poses in the world's axes and unit; ignored where a view has no keypoint.
        bones: parent and child.
        triples: frames of one body that follow one another.
    """
    problem = _Problem(cameras, seen, lifted, bones, triples)
    points = problem.solved(problem.best_start(), _ROUNDS)
    # Of one moment alone: a detector's errors last, and steady motion does not make up for them.
    terms = problem.terms(points)
    own = np.linalg.inv(replace(terms, triples=terms.triples[:0], steady=terms.steady[:0]).diagonal())
    return points, _MEAN_OF_ROOT * np.sqrt(np.trace(own, axis1=-2, axis2=-1))


@dataclass(frozen=True)
class _Terms:
    """A quadratic cost of the joints: of each alone, of each bone, and of each three frames in a row."""

    gradient: Points
    own: Float[np.ndarray, "frames joints 3 3"]
    stiff: Float[np.ndarray, "frames bones 3 3"]
    steady: Float[np.ndarray, "triples joints"]
    bones: Int[np.ndarray, "bones 2"]
    triples: Int[np.ndarray, "triples 3"]

    def diagonal(self) -> Float[np.ndarray, "frames joints 3 3"]:
        """Return the curvature of each joint with all others held."""
        total, held = self.own.copy(), np.zeros(self.own.shape[:2])
        total += np.einsum("bj,fbxy->fjxy", np.abs(_ends(self.bones, total.shape[1])), self.stiff)
        for place, share in enumerate((1, 4, 1)):
            np.add.at(held, self.triples[:, place], share * self.steady)
        return total + (held + 1e-12)[..., None, None] * np.eye(3)

    def times(self, x: Points) -> Points:
        """Return the curvature times a change of the joints."""
        y = np.einsum("fjab,fjb->fja", self.own, x)
        parent, child = self.bones.T
        along = np.einsum("fbij,fbj->fbi", self.stiff, x[:, child] - x[:, parent])
        return _spread_over(y, along, self.bones, self.steady[..., None] * _second(x, self.triples), self.triples)

    def step(self) -> Points:
        """Return the change of the joints that the cost falls most by, by preconditioned conjugate gradients."""
        inverse = np.linalg.inv(self.diagonal())
        x, rest = np.zeros_like(self.gradient), -self.gradient
        along = np.einsum("fjab,fjb->fja", inverse, rest)
        left = first = float((rest * along).sum())
        for _ in range(_MOST_STEPS):
            if left <= 1e-8 * first:
                break
            pushed = self.times(along)
            share = left / float((along * pushed).sum())
            x, rest = x + share * along, rest - share * pushed
            eased = np.einsum("fjab,fjb->fja", inverse, rest)
            before, left = left, float((rest * eased).sum())
            along = eased + left / before * along
        return -x


def _ends(bones: np.ndarray, joints: int) -> Float[np.ndarray, "bones joints"]:
    """Return 1 at the child of each bone, -1 at its parent."""
    ends = np.zeros((len(bones), joints))
    ends[range(len(bones)), bones[:, 1]] = 1
    ends[range(len(bones)), bones[:, 0]] = -1
    return ends


def _second(x: Points, triples: np.ndarray) -> np.ndarray:
    return x[triples[:, 0]] - 2 * x[triples[:, 1]] + x[triples[:, 2]]


def _spread_over(
    y: Points, of_bones: np.ndarray, bones: np.ndarray, of_triples: np.ndarray, triples: np.ndarray
) -> Points:
    """Return ``y`` with the pulls of bones added to their ends, and those of accelerations to their frames."""
    y = y + np.einsum("bj,fbx->fjx", _ends(bones, y.shape[1]), of_bones)
    for place, share in enumerate((1, -2, 1)):
        np.add.at(y, triples[:, place], share * of_triples)
    return y


class _Problem:
    """What is known of the bodies, and the cost about given places of their joints."""

    def __init__(
        self,
        cameras: Cameras,
        seen: Seen,
        lifted: np.ndarray,
        bones: np.ndarray,
        triples: np.ndarray,
        bone_sd: np.ndarray | None = None,
    ):
        self.cameras, self.seen, self.lifted, self.bones, self.triples = cameras, seen, lifted, bones, triples
        parent, child = bones.T
        self.there = seen.weight.max(-1) > 0
        """(views frames) whether a camera sees anything of the body."""
        self.along = lifted[:, :, child] - lifted[:, :, parent]
        trust = np.maximum(seen.weight, _UNSEEN)
        self.trust = np.sqrt(trust[:, :, child] * trust[:, :, parent]) * self.there[..., None]
        self.bone_sd = self._disagreement() if bone_sd is None else bone_sd
        self.known = (seen.weight > 0).sum(0) > 1
        self.acceleration: np.ndarray | None = None

    def _disagreement(self) -> Float[np.ndarray, " bones"]:
        """Return the standard deviation of the lifted bones along an axis, as far as the views differ."""
        pairs = list(combinations(range(len(self.along)), 2))
        far = np.stack([((self.along[a] - self.along[b]) ** 2).sum(-1) for a, b in pairs], -1)
        trust = np.stack([self.trust[a] * self.trust[b] for a, b in pairs], -1)
        usual = [weighted_median(far[:, bone], trust[:, bone]) for bone in range(len(self.bones))]
        size = np.sqrt((self.along**2).sum(-1)).mean()
        return np.sqrt(np.array(usual) / 2 / _CHI3_MEDIAN) + 1e-3 * size

    def start(self) -> Points:
        """Return the triangulated joints; the others as lifted, about those or where their own camera sees the root."""
        points, there = triangulate(self.cameras, self.seen), self.there[..., None, None]
        mean = (self.lifted * there).sum(0) / np.maximum(there.sum(0), 1)
        known = np.isfinite(points[..., 0])
        root = np.full((len(points), 3), np.nan)
        for frame in np.flatnonzero(known.any(1)):
            root[frame] = np.median((points - mean)[frame, known[frame]], axis=0)
        for view, rotation in enumerate(self.cameras.rotation):
            rows = np.flatnonzero(~np.isfinite(root).all(-1) & self.there[view])
            rays = self.seen.pixels[view, rows] / self.cameras.focal_px[view]
            place = place_roots(self.lifted[view, rows] @ rotation.T, rays, self.seen.weight[view, rows])
            root[rows] = (place - self.cameras.translation[view]) @ rotation
        return np.where(known[..., None], points, np.nan_to_num(root)[:, None] + mean)

    def best_start(self) -> Points:
        """Return, frame by frame, the best of the bodies by all views and by all but one: a view may have lost its body."""
        found = [self.solved(self.start(), _FIRST_ROUNDS)]
        noise = noise_of(self.cameras.errors(found[0], self.seen), self.seen.weight)
        for view in range(len(self.there)):
            weight = self.seen.weight.copy()
            weight[view] = 0
            others = _Problem(
                self.cameras, Seen(self.seen.pixels, weight), self.lifted, self.bones, self.triples, self.bone_sd
            )
            found.append(others.solved(others.start(), _FIRST_ROUNDS))
        cost = np.stack([self._cost(points, noise) for points in found])
        for _ in range(_NEIGHBOURS):  # a body is lost for more than a frame
            before, here, after = self.triples.T
            cost[:, here] = (cost[:, before] + cost[:, here] + cost[:, after]) / 3
        return np.stack(found)[cost.argmin(0), np.arange(cost.shape[1])]

    def _cost(self, points: Points, noise: np.ndarray) -> Float[np.ndarray, " frames"]:
        """Return how much each frame disagrees with what is seen, lifted, and as long as ever."""
        off = (self.cameras.errors(points, self.seen) ** 2).sum(-1) / (CUT * noise) ** 2
        along = points[:, self.bones[:, 1]] - points[:, self.bones[:, 0]]
        apart = ((self.along - along) ** 2).sum(-1) / (CUT * self.bone_sd) ** 2
        length = np.linalg.norm(along, axis=-1)
        usual = np.median(length, axis=0)
        longer = ((length - usual) / (CUT * _LENGTH_SD * usual + 1e-9)) ** 2
        cost = (self.seen.weight * off / (1 + off)).sum((0, 2)) + (longer / (1 + longer)).sum(1)
        return cost + (self.trust * apart / (1 + apart)).sum((0, 2))

    def solved(self, points: Points, rounds: int) -> Points:
        """Return the joints after steps that start at ``points``."""
        for _ in range(rounds):
            points = points - self.terms(points).step()
        return points

    def terms(self, points: Points) -> _Terms:
        """Return the cost about ``points``, to second order."""
        noise = noise_of(self.cameras.errors(points, self.seen), self.seen.weight)
        gradient, own = pull_of_keypoints(self.cameras, self.seen, points, noise)
        pull, stiff = self._of_bones(points)
        second, steady = _second(points, self.triples), self._steady(points, own)
        gradient = _spread_over(gradient, pull, self.bones, steady[..., None] * second, self.triples)
        return _Terms(gradient, own, stiff, steady, self.bones, self.triples)

    def _of_bones(self, points: Points) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient and curvature of bones as lifted, and of lengths that stay."""
        along = points[:, self.bones[:, 1]] - points[:, self.bones[:, 0]]
        far = ((self.along - along) ** 2).sum(-1) / self.bone_sd**2
        weight = self.trust / (1 + far / CUT**2) ** 2 / self.bone_sd**2
        weight = weight / np.maximum(self.there.sum(0), 1)[:, None]  # errors of views are alike: more do not weigh more
        total = weight.sum(0)
        length = np.linalg.norm(along, axis=-1)
        usual = np.median(length, axis=0)
        sd = _LENGTH_SD * usual + 1e-9
        off = length - usual
        held = 1 / sd**2 / (1 + (off / sd / CUT) ** 2) ** 2
        unit = along / np.maximum(length, 1e-9)[..., None]
        pull = total[..., None] * along - (weight[..., None] * self.along).sum(0) + (held * off)[..., None] * unit
        stiff = total[..., None, None] * np.eye(3) + held[..., None, None] * unit[..., :, None] * unit[..., None, :]
        return pull, stiff

    def _steady(self, points: Points, own: np.ndarray) -> Float[np.ndarray, "triples joints"]:
        """Return what a squared acceleration costs: little for joints that do accelerate, once noise is taken off."""
        size = (_second(points, self.triples) ** 2).sum(-1)
        if self.acceleration is None:
            variance = np.trace(np.linalg.inv(own + 1e-9 * np.eye(3)), axis1=-2, axis2=-1)[self.triples[:, 1]] / 3
            known = self.known[self.triples].all(1).astype(float)
            found = np.array([weighted_median(*one) for one in zip(size.T, known.T, strict=True)]) / _CHI3_MEDIAN
            noise = np.array([weighted_median(*one) for one in zip(variance.T, known.T, strict=True)])
            # Of three independent places a second difference has 1 + 4 + 1 times their variance.
            found[found == 0] = found.max(initial=0) or np.inf  # never seen by two cameras, or nothing moves at all
            self.acceleration = np.maximum(found - 6 * noise, _SLOWEST * found)
        return 1 / self.acceleration / (1 + size / self.acceleration / CUT**2) ** 2
