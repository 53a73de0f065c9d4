"""The protocols by name: what kind of figure each is, and its meaning in one line."""

from __future__ import annotations

__all__ = [
    "ACTION_MEAN",
    "JOINTS_14",
    "MISSING",
    "PROTOCOLS",
    "is_error",
    "protocol_kind",
    "protocol_meaning",
    "protocol_order",
    "protocol_unit",
]

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
