"""Whether a prediction's own uncertainty is true: how often the error lies inside the interval it gives."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from uplift.evaluation.alignment import least_squares_scale
from uplift.evaluation.protocols import MISSING
from uplift.evaluation.scores import Matched

__all__ = ["NOMINAL", "calibrate", "coverage_of", "rank_correlation"]

NOMINAL = (0.25, 0.5, 0.75, 0.9, 0.95)
"""The shares of errors that the intervals should hold."""

_CHUNK = 8192
_MOST_RANKED = 1_000_000


def calibrate(matched: Matched, spread: Float[np.ndarray, "frames joints"]) -> dict[str, Any] | None:
    """Return the calibration curve of ``spread``, the scale b of a Laplace distribution of each depth.

    ``spread`` is in the unit of the matched pose, row by row and joint by joint; of a joint that was
    missing in 2D it is the scale of its whole error, for nothing says where it is in the image. Both are brought to
    the truth's scale as for `n_mpjpe`; a metric pose stays as it is. ``visible`` and ``missing`` (the
    joints that were missing in 2D) hold, for each nominal share q, the share of depth errors within
    -b ln(1 - q), the root left out. ``spread_error`` is the mean difference of the two,
    ``rank_correlation`` that of spread and error (Spearman); both again for the missing joints. What
    cannot be measured is absent; None where that is everything.
    """
    found: dict[str, Any] = {}
    for group, ending, weight in (("visible", "", matched.weight), ("missing", MISSING, matched.unseen)):
        error, scale = _errors(matched, spread, weight, whole=group == "missing")
        if len(error):
            found[group] = coverage_of(error, scale)
            found[f"spread_error{ending}"] = float(np.mean([abs(float(q) - s) for q, s in found[group].items()]))
            correlation = rank_correlation(error, scale)
            if correlation is not None:
                found[f"rank_correlation{ending}"] = correlation
    return found or None


def coverage_of(error: Float[np.ndarray, " joints"], scale: Float[np.ndarray, " joints"]) -> dict[str, float]:
    """Return for each of `NOMINAL` the share of absolute errors inside the interval of a Laplace scale."""
    return {f"{q:g}": float((error <= -scale * np.log1p(-q)).mean()) for q in NOMINAL}


def rank_correlation(one: Float[np.ndarray, " joints"], other: Float[np.ndarray, " joints"]) -> float | None:
    """Return Spearman's correlation over at most a million evenly picked pairs; None where one is constant."""
    step = -(-len(one) // _MOST_RANKED)
    ranks = np.stack([_ranks(values[::step]) for values in (one, other)])
    if (np.ptp(ranks, axis=1) == 0).any():
        return None
    return float(np.corrcoef(ranks)[0, 1])


def _ranks(values: np.ndarray) -> np.ndarray:
    """Return the place of each value in their order, equals in the middle of theirs."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[place]


def _errors(
    matched: Matched, spread: np.ndarray, weight: Float[np.ndarray, "frames joints"], *, whole: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth errors of the joints that ``weight`` counts, or their ``whole`` ones, and their spreads, in the truth's unit."""
    errors, scales = [np.empty(0, np.float32)], [np.empty(0, np.float32)]
    for start in range(0, len(matched.pose), _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, len(matched.pose)))
        pose, truth, seen = matched.rows(rows)
        factor = np.ones(len(rows)) if matched.metric else least_squares_scale(pose, truth, seen)
        mine = spread[rows].astype(np.float64) * np.abs(factor)[:, None]
        counts = _counts(weight[rows], mine, matched.skeleton.root_index)
        off = pose * factor[:, None, None] - truth
        size = np.linalg.norm(off, axis=-1) if whole else np.abs(off[..., 2])
        errors.append(size[counts].astype(np.float32))
        scales.append(mine[counts].astype(np.float32))
    return np.concatenate(errors), np.concatenate(scales)


def _counts(weight: np.ndarray, spread: np.ndarray, root: int) -> Bool[np.ndarray, "frames joints"]:
    counts = (weight > 0) & np.isfinite(spread)
    counts[:, root] = False  # its depth is 0 by definition
    return counts
