"""What confidences are worth: on one scale for every detector, from how far keypoints of each confidence jump in time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from uplift.config.settings import LifterSettings
from uplift.data.clean import MIN_VISIBLE, fill_root
from uplift.data.poses import PoseData
from uplift.skeleton import Skeleton

__all__ = ["Calibration", "calibrated"]

_HALF_ERROR = 0.05
"""Expected error, in mean 2D radii, of a keypoint of confidence 0.5."""
_PRIOR_ERROR = 0.01
"""Of the median keypoint of a typical detector, in mean 2D radii; errors are taken to go as 1 / rank - 1."""
_PRIOR_VALUES = 50
"""As many values of the highest rank are added, so that a single frame does not make its weakest joint doubtful."""
_PRIOR_WEIGHT = 5
"""Of the typical detector in each bin, in observations."""
_MOST_ERROR = 0.5
_HIDDEN = 0.15
"""Expected error, in mean 2D radii, above which a keypoint is worse than none."""
_MOST_REST = 0.05
"""Share of what a jump explains that may be left: quick motion, out and back within two frames, leaves more."""
_EDGES = np.concatenate([0.25 * 2.0 ** np.arange(-6, 0), np.linspace(0.25, 0.95, 8)])
"""Between bins of ranks: fine at the low end, where gross errors are."""
_LEAST_IN_BIN = 60
_MOST_FRAMES = 2000
"""From which errors are estimated, spread evenly over the data."""
_ITERATIONS = 60
_MEAN_OVER_RMS = np.sqrt(np.pi) / 2
"""Of the length of a Gaussian error in the plane."""


def calibrated(
    data: PoseData, skeleton: Skeleton, settings: LifterSettings, calibration: Calibration | None = None
) -> PoseData:
    """Return cleaned ``data`` with confidences on a scale of its own errors, unless ``settings`` take those of the file.

    1 is exact, 0.5 off by 5 % of the body (`_HALF_ERROR`). Only the order of the confidences counts, so every strictly
    increasing rescaling of them gives the same. Keypoints with an expected error of more than `_HIDDEN`, and those that
    jump by more and back, are missing where enough others are seen: a lifter fills them in better. ``calibration`` is
    that of other frames, of which these are more.
    """
    if settings.confidence == "given":
        return data
    seen = data.confidence > 0
    found = _Accelerations.of(data, seen)
    confidence = (calibration or _calibration(data, seen, found))(data.confidence, seen)
    sure = (confidence >= _HALF_ERROR / (_HALF_ERROR + _HIDDEN)) & ~found.jumps()
    hidden = seen & ~sure & (sure.sum(1, keepdims=True) >= MIN_VISIBLE)
    if not hidden.any():
        return replace(data, confidence=confidence)
    confidence[hidden] = 0
    keypoints, filled = fill_root(data.keypoints.copy(), confidence, skeleton)
    return replace(data, keypoints=keypoints, confidence=confidence, root_filled=filled)


@dataclass(frozen=True)
class Calibration:
    """What each rank of the confidences of some frames is worth."""

    values: Float[np.ndarray, " keypoints"]
    """The confidences of all seen keypoints, sorted."""
    ranks: Float[np.ndarray, " bins"]
    errors: Float[np.ndarray, " bins"]
    """Expected error at each of the ranks, in mean 2D radii; none where confidences say nothing."""

    @classmethod
    def of(cls, data: PoseData) -> Calibration:
        """Return that of cleaned ``data``."""
        seen = data.confidence > 0
        return _calibration(data, seen, _Accelerations.of(data, seen))

    def __call__(
        self, confidence: Float[np.ndarray, "frames joints"], seen: Bool[np.ndarray, "frames joints"]
    ) -> Float[np.ndarray, "frames joints"]:
        """Return confidences by the expected error of their rank."""
        if not len(self.errors):
            return seen.astype(np.float32)
        error = np.interp(_rank(confidence, self.values), self.ranks, self.errors)
        return np.where(seen, _HALF_ERROR / (_HALF_ERROR + error), 0).astype(np.float32)


def _rank(confidence: Float[np.ndarray, "*shape"], values: Float[np.ndarray, " keypoints"]) -> np.ndarray:
    return (np.searchsorted(values, confidence, side="right") + _PRIOR_VALUES) / (len(values) + _PRIOR_VALUES)


def _calibration(data: PoseData, seen: Bool[np.ndarray, "frames joints"], found: _Accelerations) -> Calibration:
    """Return what confidences are worth, from how far keypoints jump in time.

    The errors are the maximum of the likelihood of all second differences in time, if keypoints have Gaussian errors of a
    variance by rank, and joints Gaussian accelerations of a variance by joint: variance components of exponential variables
    (|second difference|^2), by the multiplicative updates of Fevotte, Bertin and Durrieu 2009. They do not
    increase with confidence. Motion that looks like errors is told from them by the correlation of neighbouring second
    differences, negative for independent errors. Without clips, and where motion hides the errors, ranks are worth what they
    are in a typical detector. Equal confidences, and those of a few frames, say nothing: keypoints then are exact (1) or
    missing (0).
    """
    values = np.sort(data.confidence[seen])
    centres, bin_of = _bins(_rank(data.confidence, values), seen)
    if len(centres) == 1:
        return Calibration(values, np.zeros(0), np.zeros(0))
    prior = np.minimum(_PRIOR_ERROR * (1 / centres - 1), _MOST_ERROR) / _MEAN_OVER_RMS
    variance = _variances(_Observed.of(found, bin_of), seen.shape[1], np.maximum(prior, 1e-6) ** 2)
    counts = np.bincount(bin_of[seen], minlength=len(centres))
    error = _MEAN_OVER_RMS * np.sqrt(_not_increasing(variance, counts))
    return Calibration(values, centres, np.minimum(error, _MOST_ERROR))


def _bins(
    rank: Float[np.ndarray, "frames joints"], seen: Bool[np.ndarray, "frames joints"]
) -> tuple[Float[np.ndarray, " bins"], Int[np.ndarray, "frames joints"]]:
    """Return the mean rank in each bin, and each keypoint's bin; bins of few are joined to the next."""
    ranks = rank[seen]
    edges, below = [], 0
    for edge in _EDGES:
        upto = int((ranks <= edge).sum())
        if upto - below >= _LEAST_IN_BIN and len(ranks) - upto >= _LEAST_IN_BIN:
            edges.append(edge)
            below = upto
    bin_of = np.searchsorted(edges, rank, side="left")
    total = np.bincount(bin_of[seen], ranks, len(edges) + 1)
    return total / np.maximum(np.bincount(bin_of[seen], minlength=len(edges) + 1), 1), bin_of


@dataclass(frozen=True)
class _Accelerations:
    """Second differences of all joints over three frames, relative to the body's, in mean 2D radii."""

    value: Float[np.ndarray, "frames joints 2"]
    """At the middle frame; 0 where not known."""
    known: Bool[np.ndarray, "frames joints"]

    @classmethod
    def of(cls, data: PoseData, seen: Bool[np.ndarray, "frames joints"]) -> _Accelerations:
        """Return those of ``data``, of joints that are seen in all three frames."""
        value, known = np.zeros(data.keypoints.shape), np.zeros(seen.shape, bool)
        follows = data.follows()
        at = np.flatnonzero(follows[1:-1] & follows[2:]) + 1
        if len(at):
            points = data.keypoints
            whole = seen[at - 1] & seen[at] & seen[at + 1]
            scale = _radius(points[at], seen[at])[:, None]
            known[at] = whole & (scale > 0)
            second = points[at - 1] - 2 * points[at] + points[at + 1]
            value[at] = _relative(second, whole) / np.maximum(scale, 1e-9)[..., None]
        return cls(value, known)

    def jumps(self) -> Bool[np.ndarray, "frames joints"]:
        """Return the keypoints that jump out and back by more than what would be filled in, whatever their confidence.

        A jump of one frame makes three second differences of 1, -2 and 1 times its length; what else they hold has to
        be little.
        """
        before, at, after = self.value[:-2], self.value[1:-1], self.value[2:]
        jump = np.square((before - 2 * at + after) / 6).sum(-1)
        rest = np.square(before).sum(-1) + np.square(at).sum(-1) + np.square(after).sum(-1) - 6 * jump
        three = self.known[:-2] & self.known[1:-1] & self.known[2:]
        found = np.zeros(self.known.shape, bool)
        found[1:-1] = three & (jump > _HIDDEN**2) & (rest < _MOST_REST * 6 * jump)
        return found


@dataclass(frozen=True)
class _Observed:
    """What variances are estimated from: accelerations of some thousand frames at most."""

    square: Float[np.ndarray, " all"]
    joint: Int[np.ndarray, " all"]
    bins: Int[np.ndarray, "3 all"]
    """Of the frame before, the middle one and the one after."""
    product: Float[np.ndarray, " all"]
    """With the acceleration one frame later; NaN where there is none."""

    @classmethod
    def of(cls, found: _Accelerations, bin_of: Int[np.ndarray, "frames joints"]) -> _Observed:
        """Return those of frames spread evenly over the data."""
        at = np.flatnonzero(found.known.any(1))
        at = at[:: max(1, len(at) // _MOST_FRAMES)]
        known, value, next_one = found.known[at], found.value[at], np.minimum(at + 1, len(bin_of) - 1)
        later = known & found.known[next_one] & (next_one > at)[:, None]
        product = np.where(later, (value * found.value[next_one]).sum(-1), np.nan)
        bins = np.stack([bin_of[at - 1][known], bin_of[at][known], bin_of[next_one][known]])
        return cls(np.square(value).sum(-1)[known], np.nonzero(known)[1], bins, product[known])


def _variances(found: _Observed, joints: int, prior: Float[np.ndarray, " bins"]) -> Float[np.ndarray, " bins"]:
    """Return the variance (of both coordinates together) of errors in each bin, in squared mean radii."""
    if not len(found.square):
        return prior
    bins = len(prior)
    before, middle, after = found.bins

    def sums(value: np.ndarray) -> np.ndarray:
        at_ends = np.bincount(before, value, bins) + np.bincount(after, value, bins)
        return at_ends + 4 * np.bincount(middle, value, bins)

    error = np.full(bins, np.median(found.square) / 12 + 1e-9)
    motion = np.full(joints, np.median(found.square) / 2 + 1e-9)
    for _ in range(_ITERATIONS):
        expected = error[before] + 4 * error[middle] + error[after] + motion[found.joint]
        ratio, inverse = found.square / expected**2, 1 / expected
        up, down = sums(ratio) + _PRIOR_WEIGHT * prior / error**2, sums(inverse) + _PRIOR_WEIGHT / error
        more, less = (np.bincount(found.joint, value, joints) for value in (ratio, inverse))
        error = np.maximum(error * np.sqrt(up / down), 1e-12)
        motion = np.maximum(motion * np.sqrt(more / np.maximum(less, 1e-12)), 1e-12)
    return np.maximum(error - _motion_among(error, motion, found), 0)


def _motion_among(error: np.ndarray, motion: np.ndarray, found: _Observed) -> float:
    """Return how much of each error's variance is motion, below 0 where motion's have errors: squares cannot tell a common part.

    The product of neighbouring second differences is negative on average for independent errors. What it has more is
    a share of each joint's motion, and the same for all joints if motion was taken for errors.
    """
    both = np.isfinite(found.product)
    if not both.any():
        return 0.0
    before, now, after = error[found.bins[:, both]]
    moved = motion[found.joint[both]]
    weight = 1 / ((before + 4 * now + after + moved) * (now + 4 * after + moved))
    more = found.product[both] + 2 * (now + after)
    mean_moved, mean_more = np.average(moved, weights=weight), np.average(more, weights=weight)
    spread = (weight * np.square(moved - mean_moved)).sum()
    share = (weight * (moved - mean_moved) * more).sum() / max(spread, 1e-30)
    common = (mean_more - np.clip(share, 0, 1) * mean_moved) / 4
    return max(float(common), -motion.min() / 6)


def _relative(value: Float[np.ndarray, "frames joints 2"], seen: Bool[np.ndarray, "frames joints"]) -> np.ndarray:
    """Return the values less the median over the seen joints, 0 for others: without what moves the body or the camera."""
    return np.where(seen[..., None], value - _median(value, seen)[:, None], 0)


def _radius(points: Float[np.ndarray, "frames joints 2"], seen: Bool[np.ndarray, "frames joints"]) -> np.ndarray:
    """Return the median distance of seen joints to their middle, close to the mean and untouched by outliers."""
    away = np.linalg.norm(_relative(points, seen), axis=-1)
    return _median(away[..., None], seen)[:, 0]


def _median(value: Float[np.ndarray, "frames joints axes"], seen: Bool[np.ndarray, "frames joints"]) -> np.ndarray:
    """Return (frames axes) medians over the seen joints; a large number without any."""
    ordered = np.sort(np.where(seen[..., None], value, 1e30), axis=1)
    count = seen.sum(1)
    rows = np.arange(len(value))
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, value.shape[1] - 1)
    return (ordered[rows, low] + ordered[rows, high]) / 2


def _not_increasing(value: Float[np.ndarray, " bins"], weight: Int[np.ndarray, " bins"]) -> Float[np.ndarray, " bins"]:
    """Return the nearest values that do not increase: neighbours in the wrong order are averaged (Ayer et al. 1955)."""
    blocks: list[list[float]] = []
    for one, many in zip(value, np.maximum(weight, 1), strict=True):
        blocks.append([one, many, 1])
        while len(blocks) > 1 and blocks[-2][0] < blocks[-1][0]:
            last, before = blocks.pop(), blocks[-1]
            total = last[1] + before[1]
            blocks[-1] = [(last[0] * last[1] + before[0] * before[1]) / total, total, last[2] + before[2]]
    return np.concatenate([np.full(int(many), one) for one, _, many in blocks])
