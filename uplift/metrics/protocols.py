"""Protocols and metrics by name: what kind of figure each is, and its meaning in one line."""

from __future__ import annotations

__all__ = [
    "ACTION_MEAN",
    "BEST_FLOOR",
    "JOINTS_14",
    "MISSING",
    "PROTOCOLS",
    "SHAPE_METRICS",
    "better_is_higher",
    "is_error",
    "metric_kind",
    "metric_meaning",
    "metric_order",
    "metric_unit",
    "protocol_kind",
    "protocol_meaning",
    "protocol_order",
    "protocol_unit",
]

# The protocols by name: what kind of figure each is, and its meaning in one line.

PROTOCOLS = {
    "mpjpe": ("error", "as the model gives it, metric scale"),
    "mpjpe_gt_scale": ("error", "at the truth's xy scale of each frame, no alignment"),
    "n_mpjpe": ("error", "at the least-squares scale of each frame"),
    "n_mpjpe_norm": ("error", "at the scale norm(truth) / norm(prediction)"),
    "p_mpjpe": ("error", "after similarity Procrustes, proper rotations only"),
    "p_mpjpe_reflect": ("error", "after Procrustes with reflections allowed"),
    "mpjpe_gt_scale_best_of_flip": ("error", "mpjpe_gt_scale, the better of z and -z"),
    "n_mpjpe_best_of_flip": ("error", "n_mpjpe, the better of z and -z"),
    "p_mpjpe_best_of_flip": ("error", "p_mpjpe, the better of z and -z"),
    "pck@150": ("share", "joints within 150 mm"),
    "auc": ("share", "mean PCK over 0..150 mm"),
    "pck14@150": ("share", "pck@150 over the 14 joints of MPI-INF-3DHP's script"),
    "auc14": ("share", "auc over these 14 joints"),
    "pck_z@150": ("share", "joints within 150 mm in depth alone"),
    "mpjve": ("per frame", "error of the step from frame to frame"),
    "stress": ("length", "difference of all pairwise joint distances"),
    "facing": ("share", "frames no farther from the truth than their depth flip"),
    "facing_sign": ("share", "frames with the right handedness (needs no truth)"),
    "elevation_deg": ("deg", "median error of the camera's tilt"),
    "bone_cv": ("share", "variation of each bone's length within a subject"),
    "symmetry": ("share", "left/right difference of bone lengths"),
    "coverage": ("share", "joints that the prediction has"),
}
"""Name -> kind of figure and meaning in one line."""

ACTION_MEAN = "_action_mean"
"""Ending of a frame error's mean of action means."""
MISSING = "_missing"
"""Ending of the error of joints that were missing in 2D and that the prediction filled in."""

JOINTS_14 = (
    "head_top", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle",
)  # fmt: skip
"""What MPI-INF-3DHP's own script counts: not the pelvis (the root), nor spine and head."""

_SUFFIXES = {ACTION_MEAN: ", mean of action means", MISSING: ", joints missing in 2D"}


def protocol_kind(name: str) -> str:
    """Return error, share, length, deg or per frame."""
    return PROTOCOLS[_base(name)][0]


def is_error(name: str) -> bool:
    """Return whether ``name`` is a frame error, one that papers average over actions."""
    return PROTOCOLS.get(name, ("", ""))[0] == "error"


def protocol_order(name: str) -> tuple[int, str]:
    """Return the sort key that keeps the protocols in the order of `PROTOCOLS`, each with its variants."""
    return list(PROTOCOLS).index(_base(name)), name


def protocol_unit(name: str, unit: str) -> str:
    """Return the unit of a figure, given the truth's."""
    return {"share": "", "deg": "deg", "per frame": f"{unit}/frame"}.get(protocol_kind(name), unit)


def _base(name: str) -> str:
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix)
    return name


def protocol_meaning(name: str) -> str:
    """Return the one-line meaning of a figure."""
    ending = "".join(text for suffix, text in _SUFFIXES.items() if name.endswith(suffix))
    return PROTOCOLS[_base(name)][1] + ending


# The metrics of lifted shapes by name: what kind of figure each is, which way is better, its meaning in one line.

SHAPE_METRICS = {
    "volume_iou": ("share", "higher", "occupied volume shared with the truth, of the volume that either has"),
    "silhouette_iou_seen": ("share", "higher", "silhouette in the input view against the input mask"),
    "silhouette_iou_unseen": ("share", "higher", "silhouettes in 8 new views about gravity against the truth's"),
    "chamfer": ("length", "lower", "mean distance between the surfaces, both ways"),
    "f_score": ("share", "higher", "surface points within 2 % of the longest side, both ways (F@2%)"),
    "normal_consistency": ("share", "higher", "absolute cosine of the normals of nearest surface points"),
    "handedness": ("share", "higher", "shapes nearer to the truth than to its mirror image in depth; chance is 0.5"),
    "azimuth_deg": ("deg", "lower", "median error of the view about gravity, after the best constant turn"),
    "elevation_deg": ("deg", "lower", "median error of the camera's tilt"),
}
"""Name -> kind of figure, which way is better, meaning in one line."""

BEST_FLOOR = "best_floor_"
"""Beginning of the name of the best floor's figure."""


def metric_kind(name: str) -> str:
    """Return share, length or deg."""
    return SHAPE_METRICS[_shape_base(name)][0]


def better_is_higher(name: str) -> bool:
    """Return whether more is better."""
    return SHAPE_METRICS[_shape_base(name)][1] == "higher"


def metric_meaning(name: str) -> str:
    """Return the one-line meaning of a figure."""
    return ("the best floor's: " if name.startswith(BEST_FLOOR) else "") + SHAPE_METRICS[_shape_base(name)][2]


def metric_order(name: str) -> tuple[int, str]:
    """Return the sort key that keeps the metrics in the order of `SHAPE_METRICS`, each before its floor's."""
    return list(SHAPE_METRICS).index(_shape_base(name)), "" if name in SHAPE_METRICS else name


def metric_unit(name: str) -> str:
    """Return the unit of a figure; lengths are shares of the truth's longest side."""
    return {"share": "", "deg": "deg", "length": "longest side"}[metric_kind(name)]


def _shape_base(name: str) -> str:
    return name.removeprefix(BEST_FLOOR)
