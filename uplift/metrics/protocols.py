"""The metrics of poses and of shapes by name: what kind of figure each is, its unit and its meaning in one line."""

from __future__ import annotations

from typing import NamedTuple

__all__ = [
    "ACTION_MEAN", "BEST_BASELINE", "CLIP", "JOINTS_14", "LONGEST_SIDE", "MISSING", "PROTOCOLS", "SHAPE_METRICS",
    "figure_text", "is_error", "metric_better", "metric_kind", "metric_label", "metric_meaning", "metric_order", "metric_unit",
]  # fmt: skip


class Metric(NamedTuple):
    """What kind of figure a metric is, which direction is better, and its meaning in one line."""

    kind: str
    """``error`` (a length that papers average over actions), ``length``, ``share``, ``deg`` or ``per frame``."""
    better: str
    """``lower`` or ``higher``."""
    meaning: str


_ELEVATION = Metric("deg", "lower", "median error of the camera's tilt")
PROTOCOLS = {
    "mpjpe": Metric("error", "lower", "as the model gives it, metric scale"),
    "mpjpe_gt_scale": Metric("error", "lower", "at the truth's xy scale of each frame, no alignment"),
    "n_mpjpe": Metric("error", "lower", "at the least-squares scale of each frame"),
    "n_mpjpe_norm": Metric("error", "lower", "at the scale norm(truth) / norm(prediction)"),
    "p_mpjpe": Metric("error", "lower", "after similarity Procrustes, proper rotations only"),
    "p_mpjpe_reflect": Metric("error", "lower", "after Procrustes with reflections allowed"),
    "mpjpe_gt_scale_best_of_flip": Metric("error", "lower", "mpjpe_gt_scale, the better of z and -z"),
    "n_mpjpe_best_of_flip": Metric("error", "lower", "n_mpjpe, the better of z and -z"),
    "p_mpjpe_best_of_flip": Metric("error", "lower", "p_mpjpe, the better of z and -z"),
    "pck@150": Metric("share", "higher", "joints within 150 mm"),
    "auc": Metric("share", "higher", "mean PCK over 0..150 mm"),
    "pck14@150": Metric("share", "higher", "pck@150 over the 14 joints of MPI-INF-3DHP's script"),
    "auc14": Metric("share", "higher", "auc over these 14 joints"),
    "pck_z@150": Metric("share", "higher", "joints within 150 mm in depth alone"),
    "mpjve": Metric("per frame", "lower", "error of the step from frame to frame"),
    "stress": Metric("length", "lower", "difference of all pairwise joint distances"),
    "facing": Metric("share", "higher", "frames no farther from the truth than their depth flip"),
    "facing_sign": Metric("share", "higher", "frames with the right handedness (needs no truth)"),
    "wrong_signs": Metric("share", "lower", "wrong depth signs, of bones that leave the image plane"),
    "elevation_deg": _ELEVATION,
    "roll_deg": Metric("deg", "lower", "median error of the camera's roll"),
    "bone_cv": Metric("share", "lower", "variation of each bone's length within a subject"),
    "symmetry": Metric("share", "lower", "left/right difference of bone lengths"),
    "coverage": Metric("share", "higher", "joints that the prediction has"),
}
"""Of poses, in the order they are listed."""
SHAPE_METRICS = {
    "silhouette_iou_unseen": Metric("share", "higher", "silhouettes in 8 new views about gravity against the truth's"),
    "f_score": Metric("share", "higher", "surface points within 2 % of the longest side, both ways (F@2%)"),
    "chamfer": Metric("length", "lower", "mean distance between the surfaces, both ways"),
    "volume_iou": Metric("share", "higher", "occupied volume shared with the truth, of the volume that either has"),
    "volume_iou_aligned": Metric("share", "higher", "volume_iou after the best small turn, scale and shift"),
    "silhouette_iou_seen": Metric("share", "higher", "silhouette in the input view against the input mask"),
    "normal_consistency": Metric("share", "higher", "absolute cosine of the normals of nearest surface points"),
    "handedness": Metric(
        "share", "higher", "shapes nearer to the truth than to its mirror image in depth; chance is 0.5"
    ),
    "views_within_20": Metric("share", "higher", "views within 20 degrees, after the common turn that makes most so"),
    "train_views_within_20": Metric(
        "share", "higher", "the same share of the training masks, as a fit found their views"
    ),
    "azimuth_deg": Metric("deg", "lower", "median error of the view about gravity, after this turn"),
    "rotation_deg": Metric("deg", "lower", "median error of the view without gravity, after this turn"),
    "elevation_deg": _ELEVATION,
}
"""Of lifted shapes, in the order they are listed."""
_METRICS = PROTOCOLS | SHAPE_METRICS
# The metrics of shapes stand in the place of the one that poses have too, their last.
_ORDER = [one for name in PROTOCOLS for one in (SHAPE_METRICS if name in SHAPE_METRICS else [name])]

ACTION_MEAN = "_action_mean"
"""Ending of a frame error's mean of action means."""
MISSING = "_missing"
"""Ending of the error of joints that were missing in 2D and that the prediction filled in."""
CLIP = "_clip"
"""Ending of the error of an angle of the camera that is pooled over each clip."""
_SUFFIXES = {ACTION_MEAN: ", mean of action means", MISSING: ", joints missing in 2D", CLIP: ", pooled over each clip"}
BEST_BASELINE = "best_floor_"
"""Beginning of the name of the best baseline's figure."""

JOINTS_14 = (
    "head_top", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle",
)  # fmt: skip
"""What MPI-INF-3DHP's own script counts: not the pelvis (the root), nor spine and head."""

LONGEST_SIDE = "longest side"
"""The unit of length of shapes: the longest side of the true shape."""


_LABELS = {
    "mpjpe": "joint error",
    "mpjpe_gt_scale": "joint error, at the true scale",
    "n_mpjpe": "joint error, at the best scale",
    "n_mpjpe_norm": "joint error, at the true size",
    "p_mpjpe": "joint error, aligned",
    "p_mpjpe_reflect": "joint error, aligned or mirrored",
    "mpjpe_gt_scale_best_of_flip": "joint error, at the true scale, the better depth sign",
    "n_mpjpe_best_of_flip": "joint error, at the best scale, the better depth sign",
    "p_mpjpe_best_of_flip": "joint error, aligned, the better depth sign",
    "mpjve": "error of the motion",
    "stress": "error of distances between joints",
    "facing": "right way round in depth",
    "facing_sign": "right handedness",
    "wrong_signs": "bones with the wrong depth sign",
    "elevation_deg": "error of the camera's tilt",
    "roll_deg": "error of the camera's roll",
    "bone_cv": "variation of bone lengths",
    "symmetry": "difference of left and right bones",
    "coverage": "joints predicted",
    "silhouette_iou_unseen": "overlap of silhouettes, new views (IoU)",
    "f_score": "surface within 2 % (F-score)",
    "chamfer": "distance of the surfaces (chamfer)",
    "volume_iou": "overlap of the volumes (IoU)",
    "volume_iou_aligned": "overlap of the volumes, aligned (IoU)",
    "silhouette_iou_seen": "overlap of silhouettes, seen view (IoU)",
    "normal_consistency": "agreement of surface directions",
    "handedness": "right way round in depth",
    "views_within_20": "views found, within 20 degrees",
    "azimuth_deg": "error of the view about gravity",
    "rotation_deg": "error of the view, no gravity",
}
"""What people who do not know the names call them; elsewhere the meaning is short enough."""


def metric_label(name: str) -> str:
    """Return a plain name of a figure, such as "joint error, aligned" for ``p_mpjpe``."""
    base = _base(name)
    best = "the best baseline's: " if name.startswith(BEST_BASELINE) else ""
    ends = "".join(text for end, text in _SUFFIXES.items() if name.endswith(end))
    return best + _LABELS.get(base, _METRICS[base].meaning) + ends


def metric_better(name: str) -> str:
    """Return ``lower`` or ``higher``: which figures are better."""
    return _METRICS[_base(name)].better


def metric_kind(name: str) -> str:
    """Return error, length, share, deg or per frame."""
    return _METRICS[_base(name)].kind


def metric_meaning(name: str) -> str:
    """Return the one-line meaning of a figure."""
    best = "the best baseline's: " if name.startswith(BEST_BASELINE) else ""
    return best + _METRICS[_base(name)].meaning + "".join(text for end, text in _SUFFIXES.items() if name.endswith(end))


def metric_unit(name: str, unit: str = LONGEST_SIDE) -> str:
    """Return the unit of a figure, given the truth's unit of length."""
    return {"share": "", "deg": "deg", "per frame": f"{unit}/frame"}.get(metric_kind(name), unit)


def figure_text(name: str, value: float, unit: str = LONGEST_SIDE) -> str:
    """Return a figure as tables show it: shares and lengths in longest sides to three decimals, all else to one."""
    fine = metric_unit(name, unit) in ("", LONGEST_SIDE)
    return f"{value:.3f}" if fine else f"{value:.1f}"


def metric_order(name: str) -> tuple[int, str]:
    """Return the sort key that keeps the metrics of poses, or those of shapes, in order, each before its variants."""
    base = _base(name)
    return _ORDER.index(base), "" if name == base else name


def is_error(name: str) -> bool:
    """Return whether ``name`` is a frame error, one that papers average over actions."""
    return name in PROTOCOLS and PROTOCOLS[name].kind == "error"


def _base(name: str) -> str:
    name = name.removeprefix(BEST_BASELINE)
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix)
    return name
