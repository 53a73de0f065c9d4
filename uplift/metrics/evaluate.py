"""All protocols of one prediction against one truth: overall, per action, per subject and per joint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError
from uplift.metrics.alignment import least_squares_scale
from uplift.metrics.gravity_errors import (
    by_trunk_angle,
    camera_errors,
    pooled_camera_errors,
    true_gravity,
    trunk_angle,
)
from uplift.metrics.hypotheses import evaluate_hypotheses
from uplift.metrics.pose_metrics import bone_cv, bone_lengths, facing_sign, has_handedness
from uplift.metrics.protocols import ACTION_MEAN, MISSING, is_error, metric_kind, metric_order
from uplift.metrics.report import Evaluation
from uplift.metrics.scores import GivenPoses, Matched, Scores, match_poses, score
from uplift.skeleton import Skeleton

if TYPE_CHECKING:
    from uplift.data.poses import PoseData
    from uplift.models.known_camera import KnownCamera
    from uplift.models.model import Model
    from uplift.models.prediction import Prediction

__all__ = ["NOMINAL", "TRUTH_SIGN", "coverage_of", "evaluate", "evaluate_model", "rank_correlation"]

TRUTH_SIGN = "facing_sign of the truth itself:"
"""Beginning of the note on how often the truth has the handedness of the skeleton."""


def evaluate(prediction: GivenPoses | Prediction, truth: PoseData, skeleton: Skeleton, data: str = "") -> Evaluation:
    """Return every protocol that the data allows, over the joints of ``skeleton``, matched by name.

    A joint counts where it was visible in 2D (confidence above 0) and is finite in both poses; the error
    of joints that the prediction filled in is reported beside it as ``*_missing``. Frames with fewer
    than three joints that count are left out. What a prediction says of itself is measured, too: the calibration
    of its uncertainty, its hypotheses and their weights. ``data`` names the truth in the report.

    Raises UserError: no truth, other joints, other frames, or nothing left to compare.
    """
    matched, kept, notes = match_poses(prediction, truth, skeleton)
    scores = score(matched)
    scores.frames |= {name: values[kept] for name, values in camera_errors(prediction, truth).items()}
    uncertainty = _uncertainty_of(prediction, skeleton)
    actions, subjects = (_groups(truth.identity, key, kept) for key in ("action", "subject"))
    per_action = _per_group(scores, *actions)
    overall = _overall(scores, per_action, subjects[1], matched.coverage)
    if "sequence" in truth.identity and not truth.stills:
        overall |= pooled_camera_errors(prediction, truth, truth.clips(), kept)
    trunk, why = _by_trunk_angle(scores, matched, truth, kept)
    return Evaluation(
        data=data or truth.source,
        overall={name: overall[name] for name in sorted(overall, key=metric_order)},
        per_action=per_action,
        per_joint=_per_joint(scores, skeleton),
        per_subject=_per_group(scores, *subjects),
        unit=truth.unit,
        frames=len(matched.pose),
        action_frames={name: int((actions[1] == place).sum()) for place, name in enumerate(actions[0])},
        notes=[*notes, *_truth_notes(matched, scores, subjects[1]), *why],
        calibration=None if uncertainty is None else _calibrate(matched, uncertainty[kept]),
        by_trunk_angle=trunk,
        signs=_signs(scores, skeleton),
        hypotheses=evaluate_hypotheses(prediction, matched, kept, skeleton),
    )


def evaluate_model(
    model: Model,
    truth: PoseData,
    name: str,
    *,
    refine: bool | str = True,
    hypotheses: int = 0,
    camera: KnownCamera | None = None,
) -> Evaluation:
    """Return every protocol of ``model`` on cleaned frames with poses, and what so many ``hypotheses`` are worth.

    ``camera`` is known in place of estimates.
    """
    if truth.pose is None:
        raise UserError(f"{name}: holds no 'pose' (frames, joints, 3) to compare with, only keypoints.")
    prediction = model.predict(truth, refine=refine, hypotheses=hypotheses, camera=camera)
    result = evaluate(prediction, truth, model.skeleton, name)
    if model.refines(truth, refine):
        how = "with those up to half a second later" if refine == "causal" else "together"
        result.notes.append(f"the frames of each clip were lifted {how} (refine=off: each on its own)")
    return result


def _uncertainty_of(prediction: GivenPoses | Prediction, skeleton: Skeleton) -> np.ndarray | None:
    """Return the prediction's uncertainty in the skeleton's order of joints; raises UserError for an invalid one."""
    if prediction.uncertainty is None:
        return None
    uncertainty, names = np.asarray(prediction.uncertainty), [str(name) for name in prediction.joint_names]
    where = prediction.source or "the prediction"
    expected = (len(prediction.pose), len(names))
    if uncertainty.shape != expected:
        raise UserError(f"{where}: 'uncertainty' has shape {uncertainty.shape}, expected {expected}: (frames joints).")
    if (uncertainty < 0).any():
        raise UserError(
            f"{where}: 'uncertainty' goes down to {np.nanmin(uncertainty):g}, expected an error of 0 or more."
        )
    return uncertainty[:, [names.index(joint) for joint in skeleton.joints]]


def _groups(identity: Mapping[str, Any], key: str, kept: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Return the names of the groups and each kept frame's group; no names and one group without the key."""
    if key not in identity:
        return [], np.zeros(int(kept.sum()), np.int64)
    names, code = np.unique(np.asarray(identity[key])[kept], return_inverse=True)
    return [str(name) for name in names], code


def _per_group(scores: Scores, names: list[str], code: np.ndarray) -> dict[str, dict[str, float]]:
    """Return the mean of every protocol in each group (the median of angles), where it has values."""
    groups: dict[str, dict[str, float]] = {name: {} for name in names}
    for protocol in sorted(scores.frames, key=metric_order):
        values = scores.frames[protocol]
        known = np.isfinite(values)
        count = np.bincount(code[known], minlength=len(names))
        if metric_kind(protocol) == "deg":
            figures = [np.median(values[known & (code == g)]) if count[g] else 0.0 for g in range(len(names))]
        else:
            figures = np.bincount(code[known], values[known], minlength=len(names)) / np.maximum(count, 1)
        for place, name in enumerate(names):
            if count[place]:
                groups[name][protocol] = float(figures[place])
    return groups


def _overall(
    scores: Scores, per_action: dict[str, dict[str, float]], subject: np.ndarray, coverage: float
) -> dict[str, float]:
    """Return the means over frames, the means of action means beside them, and what is not per frame."""
    overall = _per_group(scores, ["all"], np.zeros(len(subject), np.int64))["all"]
    for name in [name for name in overall if is_error(name)]:
        of_actions = [values[name] for values in per_action.values() if name in values]
        if of_actions:
            overall[name + ACTION_MEAN] = float(np.mean(of_actions))
    steady = bone_cv(scores.lengths, subject)
    if np.isfinite(steady):
        overall["bone_cv"] = steady
    if coverage < 1:
        overall["coverage"] = coverage
    if np.isfinite(scores.wrong).any():
        overall["wrong_signs"] = float(np.nanmean(scores.wrong, dtype=np.float64))
    return overall


def _signs(scores: Scores, skeleton: Skeleton) -> dict[str, dict[str, int | float]]:
    """Return for each bone the share of ``wrong`` depth signs, and the number of ``frames`` in which it counts."""
    count = np.isfinite(scores.wrong).sum(0)
    wrong = np.nansum(scores.wrong, axis=0, dtype=np.float64) / np.maximum(count, 1)
    bones = zip(skeleton.bones, wrong.tolist(), count.tolist(), strict=True)
    return {"-".join(bone): {"wrong": share, "frames": frames} for bone, share, frames in bones if frames}


def _by_trunk_angle(
    scores: Scores, matched: Matched, truth: PoseData, kept: np.ndarray
) -> tuple[dict[str, dict[str, int | float]], list[str]]:
    """Return the errors by the trunk's angle, and a note where they cannot be told apart by it but gravity matters."""
    skeleton, gravity = matched.skeleton, true_gravity(truth)
    if not skeleton.gravity:
        return {}, []
    if skeleton.upright is None:
        return {}, [f"no by_trunk_angle: skeleton '{skeleton.name}' gives no trunk, and no up in facing"]
    if gravity is None:
        return {}, ["no by_trunk_angle: the truth has no tilt_deg and no gravity"]
    angle = trunk_angle(matched.truth, gravity[kept], skeleton.upright)
    return by_trunk_angle(scores, angle), []


def _per_joint(scores: Scores, skeleton: Skeleton) -> dict[str, dict[str, float]]:
    names = sorted(scores.joints, key=metric_order)
    columns = {
        joint: {name: float(scores.joints[name][at]) for name in names} for at, joint in enumerate(skeleton.joints)
    }
    return {joint: {name: value for name, value in of.items() if np.isfinite(value)} for joint, of in columns.items()}


def _truth_notes(matched: Matched, scores: Scores, subject: np.ndarray) -> list[str]:
    """Return what the truth scores where that is not perfect, and why protocols are absent."""
    notes = []
    truth = np.where((matched.weight > 0)[..., None], matched.truth, np.nan)
    lengths = bone_lengths(truth, matched.skeleton)
    if has_handedness(matched.skeleton):
        signs = facing_sign(truth, matched.skeleton)
        if np.isfinite(signs).any():
            notes.append(f"{TRUTH_SIGN} {np.nanmean(signs):.3f}")
    else:
        notes.append(f"no facing_sign: skeleton '{matched.skeleton.name}' gives no handedness")
    steady = bone_cv(lengths, subject)
    if np.isfinite(steady):
        notes.append(f"bone_cv of the truth itself: {steady:.4f}")
    if matched.previous is None:
        notes.append("no mpjve: sequence, camera and frame do not tell which frame follows which")
    if not np.isfinite(scores.frames.get("mpjve", np.zeros(1))).any():
        notes.append("no mpjve: no two frames that are compared follow each other")
    return notes


# Calibration: how often the error lies inside the interval that the prediction's uncertainty gives.

NOMINAL = (0.25, 0.5, 0.75, 0.9, 0.95)
"""The shares of errors that the intervals should hold."""

_CHUNK = 8192
_MOST_RANKED = 1_000_000


def _calibrate(matched: Matched, uncertainty: Float[np.ndarray, "frames joints"]) -> dict[str, Any] | None:
    """Return the calibration of ``uncertainty``, the Laplace scale b of each depth, or of the 3D error of joints missing in 2D.

    Both are brought to the truth's scale as for `n_mpjpe`; a metric pose stays as it is. ``visible`` and ``missing``
    hold, for each nominal share q, the share of errors within -b ln(1 - q), the root left out; ``uncertainty_error`` is
    the mean difference of the two. What cannot be measured is absent; None where that is everything.
    """
    found: dict[str, Any] = {}
    for group, ending, weight in (("visible", "", matched.weight), ("missing", MISSING, matched.unseen)):
        error, scale = _errors(matched, uncertainty, weight, in_3d=group == "missing")
        if len(error):
            found[group] = coverage_of(error, scale)
            found[f"uncertainty_error{ending}"] = float(np.mean([abs(float(q) - s) for q, s in found[group].items()]))
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
    return None if (np.ptp(ranks, axis=1) == 0).any() else float(np.corrcoef(ranks)[0, 1])


def _ranks(values: np.ndarray) -> np.ndarray:
    """Return the ranks of values, equal ones their mean; scipy.stats takes half a second to import."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[place]


def _errors(
    matched: Matched, uncertainty: np.ndarray, weight: Float[np.ndarray, "frames joints"], *, in_3d: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth errors of the joints that ``weight`` counts, or their errors ``in_3d``, and their spreads, in the truth's unit."""
    errors, scales = [np.empty(0, np.float32)], [np.empty(0, np.float32)]
    for start in range(0, len(matched.pose), _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, len(matched.pose)))
        pose, truth, seen = matched.rows(rows)
        factor = np.ones(len(rows)) if matched.metric else least_squares_scale(pose, truth, seen)
        mine = uncertainty[rows].astype(np.float64) * np.abs(factor)[:, None]
        counts = (weight[rows] > 0) & np.isfinite(mine)
        counts[:, matched.skeleton.root_index] = False  # its depth is 0 by definition
        off = pose * factor[:, None, None] - truth
        size = np.linalg.norm(off, axis=-1) if in_3d else np.abs(off[..., 2])
        errors.append(size[counts].astype(np.float32))
        scales.append(mine[counts].astype(np.float32))
    return np.concatenate(errors), np.concatenate(scales)
