"""The metrics of lifted shapes by name: what kind of figure each is, which way is better, its meaning in one line."""

from __future__ import annotations

__all__ = [
    "BEST_FLOOR",
    "SHAPE_METRICS",
    "better_is_higher",
    "metric_kind",
    "metric_meaning",
    "metric_order",
    "metric_unit",
]

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
    return SHAPE_METRICS[_base(name)][0]


def better_is_higher(name: str) -> bool:
    """Return whether more is better."""
    return SHAPE_METRICS[_base(name)][1] == "higher"


def metric_meaning(name: str) -> str:
    """Return the one-line meaning of a figure."""
    return ("the best floor's: " if name.startswith(BEST_FLOOR) else "") + SHAPE_METRICS[_base(name)][2]


def metric_order(name: str) -> tuple[int, str]:
    """Return the sort key that keeps the metrics in the order of `SHAPE_METRICS`, each before its floor's."""
    return list(SHAPE_METRICS).index(_base(name)), "" if name in SHAPE_METRICS else name


def metric_unit(name: str) -> str:
    """Return the unit of a figure; lengths are shares of the truth's longest side."""
    return {"share": "", "deg": "deg", "length": "longest side"}[metric_kind(name)]


def _base(name: str) -> str:
    return name.removeprefix(BEST_FLOOR)
