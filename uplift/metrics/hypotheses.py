"""What several hypotheses are worth: the best of them, their expected error, and whether their weights are calibrated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.metrics.pose_metrics import frame_mean, joint_errors
from uplift.metrics.scores import GivenPoses, Matched
from uplift.skeleton import Skeleton

if TYPE_CHECKING:
    from uplift.models.prediction import Prediction

__all__ = ["evaluate_hypotheses"]

_CHUNK = 8192
_BINS = 10
_SUM = 1e-3
"""By how much the weights of a frame may miss 1 in sum."""


def evaluate_hypotheses(
    prediction: GivenPoses | Prediction, matched: Matched, kept: np.ndarray, skeleton: Skeleton
) -> dict[str, Any] | None:
    """Return what the hypotheses of a prediction are worth, under `p_mpjpe`; None for a prediction without any.

    ``count`` of a frame, ``best_of`` (mean over frames of the smallest error), ``likeliest`` (the error of the first),
    ``expected`` (the errors weighted), and the calibration of the weights: for hypotheses of like weight the mean
    weight that was ``said``, the share ``found`` to be the best of their frame, and their number; ``weight_error`` is
    the mean difference of the two over all hypotheses (the expected calibration error of Guo et al., ICML 2017).

    Raises:
        UserError: hypotheses or weights of another shape, or weights that are no probabilities.
    """
    if prediction.hypotheses is None and prediction.weights is None:
        return None
    poses, weights = _checked(prediction, kept, skeleton)
    errors = _errors(poses, matched)
    some = np.isfinite(errors).any(1)
    errors, weights = errors[some], weights[some]
    best = np.where(np.isfinite(errors), errors, np.inf)
    certain = np.where(weights > 0, errors, 0)  # a hypothesis of weight 0 may be anything
    return {
        "count": errors.shape[1],
        "best_of": float(best.min(1).mean()),
        "likeliest": float(np.nanmean(errors[:, 0])),
        "expected": float(np.nanmean((weights * certain).sum(1))),
        **_calibration(weights, best),
    }


def _checked(
    prediction: GivenPoses | Prediction, kept: np.ndarray, skeleton: Skeleton
) -> tuple[np.ndarray, np.ndarray]:
    """Return the hypotheses of the ``kept`` frames in the skeleton's order of joints, and their weights."""
    where, names = prediction.source or "the prediction", [str(name) for name in prediction.joint_names]
    if prediction.hypotheses is None or prediction.weights is None:
        there, gone = ("hypotheses", "weights") if prediction.weights is None else ("weights", "hypotheses")
        raise UserError(f"{where}: '{there}' without '{gone}', expected both.")
    poses, weights = np.asarray(prediction.hypotheses), np.asarray(prediction.weights)
    frames, count = len(prediction.pose), poses.shape[1] if poses.ndim == 4 else 0
    for name, array, expected in (
        ("hypotheses", poses, (frames, count, len(names), 3)),
        ("weights", weights, (frames, count)),
    ):
        if array.shape != expected or not count or array.dtype.kind not in "fiu":
            axes = "(frames hypotheses joints 3)" if name == "hypotheses" else "(frames hypotheses)"
            found = f"'{name}' has shape {array.shape} of {array.dtype}"
            raise UserError(f"{where}: {found}, expected numbers {axes} of {frames:,} frames and {len(names)} joints.")
    wrong = kept & ~((weights >= 0).all(1) & (np.abs(weights.sum(1, dtype=np.float64) - 1) <= _SUM))
    if wrong.any():
        row = int(np.argmax(wrong))
        shown = ", ".join(f"{weight:.3g}" for weight in weights[row])
        raise UserError(f"{where}: 'weights' of row {row} are {shown}, expected probabilities that are 1 in sum.")
    order = [names.index(joint) for joint in skeleton.joints]
    return poses[kept][:, :, order], weights[kept].astype(np.float64)


def _errors(poses: np.ndarray, matched: Matched) -> Float[np.ndarray, "frames hypotheses"]:
    """Return the `p_mpjpe` of every hypothesis over the joints that count for the answer, NaN for one that lacks any."""
    root, found = matched.skeleton.root_index, np.full(poses.shape[:2], np.nan)
    for start in range(0, len(poses), _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, len(poses)))
        _, truth, weight = matched.rows(rows)
        for which in range(poses.shape[1]):
            pose = poses[rows, which].astype(np.float64)
            complete = np.isfinite(np.where(weight[..., None] > 0, pose, 0)).all((1, 2))
            error = frame_mean(joint_errors("p_mpjpe", pose, truth, root, weight), weight)
            found[rows, which] = np.where(complete, error, np.nan)
    return found


def _calibration(weights: np.ndarray, errors: np.ndarray) -> dict[str, Any]:
    """Return the calibration of the weights in bins of a tenth; of equally good hypotheses the likelier is the best."""
    right = np.zeros(weights.shape)
    right[np.arange(len(errors)), errors.argmin(1)] = 1
    bins, table, total = np.clip((weights * _BINS).astype(int), 0, _BINS - 1), {}, 0.0
    for place in range(_BINS):
        rows = bins == place
        if rows.any():
            said, found = float(weights[rows].mean()), float(right[rows].mean())
            low, high = place / _BINS, (place + 1) / _BINS
            table[f"{low:g}-{high:g}"] = {"said": said, "found": found, "hypotheses": int(rows.sum())}
            total += abs(said - found) * rows.sum()
    return {"calibration": table, "weight_error": float(total / weights.size)}
