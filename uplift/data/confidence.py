"""What confidences are worth: on one scale for every detector, from how far keypoints of each confidence jump in time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from uplift.config.settings import LifterSettings
from uplift.data.clean import MIN_VISIBLE, fill_root
from uplift.data.poses import PoseData
from uplift.skeleton import Skeleton

__all__ = ["HALF_ERROR", "calibrated", "calibrated_confidence", "confidence_of"]

HALF_ERROR = 0.05
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
_EDGES = np.concatenate([0.25 * 2.0 ** np.arange(-6, 0), np.linspace(0.25, 0.95, 8)])
"""Between bins of ranks: fine at the low end, where gross errors are."""
_LEAST_IN_BIN = 60
_MOST_FRAMES = 2000
"""From which errors are estimated, spread evenly over the data."""
_ITERATIONS = 60
_MEAN_OVER_RMS = np.sqrt(np.pi) / 2
"""Of the length of a Gaussian error in the plane."""


def calibrated(data: PoseData, skeleton: Skeleton, settings: LifterSettings) -> PoseData:
    """Return cleaned ``data`` with `calibrated_confidence`, unless ``settings`` take that of the file.

    Keypoints with an expected error of more than `_HIDDEN` are missing, where enough others are seen: a lifter fills
    them in better.
    """
    if settings.confidence == "given":
        return data
    confidence = calibrated_confidence(data)
    sure = confidence >= confidence_of(np.float32(_HIDDEN))
    hidden = (confidence > 0) & ~sure & (sure.sum(1, keepdims=True) >= MIN_VISIBLE)
    if not hidden.any():
        return replace(data, confidence=confidence)
    confidence[hidden] = 0
    keypoints, filled = fill_root(data.keypoints.copy(), confidence, skeleton)
    return replace(data, keypoints=keypoints, confidence=confidence, root_filled=filled)


def confidence_of(error: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Return the calibrated confidence of keypoints with an expected ``error``, mean 2D radii: 1 is exact."""
    return HALF_ERROR / (HALF_ERROR + error)


def calibrated_confidence(data: PoseData) -> Float[np.ndarray, "frames joints"]:
    """Return the confidences of cleaned ``data`` on a scale of its own errors: 1 is exact, 0.5 off by 5 % of the body.

    Only the order of the confidences counts, so every strictly increasing rescaling of them gives the same. The
    expected error of each rank is the maximum of the likelihood of all second differences in time, if keypoints have
    Gaussian errors of a variance by rank, and joints Gaussian accelerations of a variance by joint: variance components of
    exponential variables (|second difference|^2), by the multiplicative updates of Fevotte, Bertin and Durrieu
    2009. Errors do not decrease with confidence. Motion that looks like errors is told from them by
    the correlation of neighbouring second differences, negative for independent errors. Without clips, and where
    motion hides the errors, ranks are worth what they are in a typical detector. Equal confidences, and those of a
    few frames, say nothing: keypoints then are exact (1) or missing (0).
    """
    confidence, seen = data.confidence, data.confidence > 0
    values = np.sort(confidence[seen])
    rank = (np.searchsorted(values, confidence, side="right") + _PRIOR_VALUES) / (len(values) + _PRIOR_VALUES)
    centres, bin_of = _bins(rank, seen)
    if len(centres) == 1:
        return seen.astype(np.float32)
    prior = np.minimum(_PRIOR_ERROR * (1 / centres - 1), _MOST_ERROR) / _MEAN_OVER_RMS
    variance = _variances(data, bin_of, seen, np.maximum(prior, 1e-6) ** 2)
    counts = np.bincount(bin_of[seen], minlength=len(centres))
    error = _MEAN_OVER_RMS * np.sqrt(_not_increasing(variance, counts))
    sure = confidence_of(np.interp(rank, centres, np.minimum(error, _MOST_ERROR)))
    return np.where(seen, sure, 0).astype(np.float32)


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
class _Seconds:
    """Second differences of joints over three frames, relative to the body's, in mean 2D radii."""

    square: Float[np.ndarray, " all"]
    joint: Int[np.ndarray, " all"]
    bins: Int[np.ndarray, "3 all"]
    """Of the frame before, the middle one and the one after."""
    product: Float[np.ndarray, " all"]
    """With the second difference one frame later; NaN where there is none."""


def _variances(data: PoseData, bin_of: np.ndarray, seen: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return the variance (of both coordinates together) of errors in each bin, in squared mean radii."""
    found = _seconds(data, bin_of, seen)
    if not len(found.square):
        return prior
    joints, bins = data.confidence.shape[1], len(prior)
    before, middle, after = found.bins

    def sums(value: np.ndarray) -> np.ndarray:
        return sum(w * np.bincount(at, value, bins) for w, at in ((1, before), (4, middle), (1, after)))

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


def _motion_among(error: np.ndarray, motion: np.ndarray, found: _Seconds) -> float:
    """Return how much of each variance is motion of the stillest joint, which second differences alone cannot tell.

    The product of neighbouring second differences is negative on average for independent errors. What it has more is
    motion: a share of each joint's, and the same for all joints if motion was taken for errors.
    """
    both = np.isfinite(found.product)
    _, middle, after = found.bins[:, both]
    moved = motion[found.joint[both]]
    weight = 1 / (6 * error[middle] + moved) ** 2
    more = found.product[both] + 2 * (error[middle] + error[after])
    sums = [[(weight * one * other).sum() for other in (4, moved)] for one in (4, moved)]
    right = [(weight * one * more).sum() for one in (4, moved)]
    return max(0.0, float(np.linalg.lstsq(np.array(sums), np.array(right), rcond=None)[0][0]))


def _seconds(data: PoseData, bin_of: np.ndarray, seen: np.ndarray) -> _Seconds:
    """Return second differences in time, of some thousand frames at most."""
    follows = np.append(data.follows(), np.zeros(3, bool))
    at = np.flatnonzero(follows[1:-2] & follows[2:-1]) + 1
    at = at[:: max(1, len(at) // _MOST_FRAMES)]
    rows = at[:, None] + np.arange(-1, 3)
    rows[~follows[at + 2], 3] = rows[~follows[at + 2], 2]
    points, shown = data.keypoints[rows].astype(np.float64), seen[rows]
    whole = shown[:, :3].all(1)
    first = _relative(points[:, 0] - 2 * points[:, 1] + points[:, 2], whole)
    later = whole & shown[:, 3] & follows[at + 2, None]
    second = _relative(points[:, 1] - 2 * points[:, 2] + points[:, 3], later)
    scale = _radius(points[:, 1], shown[:, 1])[:, None, None]
    usable = whole & (scale[..., 0] > 0)
    product = np.where(later & usable, (first * second).sum(-1) / np.maximum(scale[..., 0], 1e-9) ** 2, np.nan)
    return _Seconds(
        square=np.square(first / np.maximum(scale, 1e-9)).sum(-1)[usable],
        joint=np.nonzero(usable)[1],
        bins=bin_of[rows[:, :3]].transpose(1, 0, 2)[:, usable],
        product=product[usable],
    )


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
