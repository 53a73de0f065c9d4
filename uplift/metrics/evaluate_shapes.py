"""All metrics of lifted shapes against the truth: overall, per category and per item."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Bool, Float

from uplift.config.progress import progress
from uplift.data.masks import Placed
from uplift.errors import UserError
from uplift.metrics.protocols import metric_kind, metric_order
from uplift.metrics.report import ShapeEvaluation
from uplift.metrics.shape_metrics import (
    OWN_MIRROR,
    TrueItem,
    predicted,
    score_item,
    seen_overlap,
)
from uplift.metrics.view_errors import (
    WITHIN_DEG,
    azimuth_errors_deg,
    elevation_errors_deg,
    is_upright,
    rotation_errors_deg,
    view_errors_deg,
)
from uplift.models.prediction import ShapePrediction

__all__ = ["RESOLUTION", "evaluate_all", "evaluate_shapes", "filled_truths", "silhouettes_seen"]

RESOLUTION = 64
"""Voxels along the grid that the truth is filled on."""


def evaluate_shapes(
    prediction: ShapePrediction,
    truth: Placed,
    masks: np.ndarray,
    name: str,
    category: np.ndarray | None = None,
    resolution: int = RESOLUTION,
) -> ShapeEvaluation:
    """Return every metric of lifted shapes, a mean over items (see docs/shape-metrics.md); rows match.

    Depth is relative: each shape is first moved along z until the centroid of its occupied volume is as
    far away as the truth's. Sizes, x and y follow from the mask and are compared as they are.
    ``masks`` are the input masks (items side side, 0 to 255), ``name`` names the truth in the report.

    Raises UserError: different numbers of items, none, or a true mesh that is not in its own unit.
    """
    return evaluate_all({"": prediction}, truth, masks, name, category, resolution)[""]


def evaluate_all(
    predictions: Mapping[str, ShapePrediction],
    truth: Placed,
    masks: np.ndarray,
    name: str,
    category: np.ndarray | None = None,
    resolution: int = RESOLUTION,
) -> dict[str, ShapeEvaluation]:
    """Return `evaluate_shapes` of several predictions of the same items; work on the truth is done once.

    That of no title is scored by the surface that files have, all others, such as baselines, by that of their grids.
    """
    for title, prediction in predictions.items():
        _check(title or "the prediction", prediction, truth, masks)
    found: dict[str, list[dict[str, float]]] = {title: [{}] * len(truth) for title in predictions}
    for row, filled in progress(filled_truths(truth, np.arange(len(truth)), resolution), "scoring shapes", len(truth)):
        item = TrueItem(truth, row, filled)
        for title, prediction in predictions.items():
            found[title][row] = score_item(predicted(prediction, row, as_written=not title), item, masks[row])
    groups = [truth.meshes[shape].category for shape in truth.shape.tolist()] if category is None else category
    groups = np.asarray(groups).astype(str)
    return {title: _gathered(found[title], one, truth, name, groups) for title, one in predictions.items()}


def silhouettes_seen(prediction: ShapePrediction, masks: np.ndarray) -> Float[np.ndarray, " items"]:
    """Return the metric silhouette_iou_seen of each item, which needs no truth; ``masks`` are the input masks."""
    found = (predicted(prediction, row) for row in range(len(prediction)))
    return np.array([seen_overlap(one, mask) for one, mask in zip(found, masks, strict=True)])


def _check(title: str, prediction: ShapePrediction, truth: Placed, masks: np.ndarray) -> None:
    if not len(truth) == len(prediction) == len(masks):
        raise UserError(
            f"{title} has {len(prediction)} shapes, the truth {len(truth)}, and there are {len(masks)} masks: "
            "expected one of each an item, in the same order."
        )
    if not len(truth):
        raise UserError(f"{title}: no shapes to compare.")
    for part in ("view", "scale", "offset"):
        wrong = ~np.isfinite(np.asarray(getattr(prediction, part), np.float64)).reshape(len(truth), -1).all(1)
        if part == "scale":
            wrong |= np.asarray(prediction.scale) <= 0
        if wrong.any():
            raise UserError(
                f"{title}: '{part}' of {int(wrong.sum())} shapes is invalid, the first "
                f"{prediction.names[int(wrong.argmax())]}: expected finite numbers, and a scale above 0."
            )


def filled_truths(
    truth: Placed, rows: np.ndarray, resolution: int
) -> Iterator[tuple[int, Bool[np.ndarray, "depth height width"]]]:
    """Yield each of ``rows`` with its true shape's filled grid, shape by shape: each mesh is filled once."""
    from uplift.geometry.voxels import fill

    last, filled = -1, np.zeros((0, 0, 0), bool)
    for row in rows[np.argsort(truth.shape[rows], kind="stable")].tolist():
        shape = int(truth.shape[row])
        if shape != last:
            mesh = truth.meshes[shape]
            if len(mesh.vertices) and np.abs(mesh.vertices).max() > 1:
                raise UserError(
                    f"true mesh {mesh.name or shape} reaches {np.abs(mesh.vertices).max():.3g}, expected at most 1: "
                    "its own unit (Mesh.in_unit)."
                )
            last, filled = shape, np.asarray(fill(mesh, resolution))
        yield row, filled


def _gathered(
    found: list[dict[str, float]], prediction: ShapePrediction, truth: Placed, name: str, groups: np.ndarray
) -> ShapeEvaluation:
    per_item = {metric: np.array([values[metric] for values in found]) for metric in found[0]}
    per_item |= _view_scores(np.asarray(prediction.view, np.float64), np.asarray(truth.view, np.float64))
    shown = [group for group in np.unique(groups).tolist() if group]
    return ShapeEvaluation(
        data=name,
        overall=_means(per_item, np.ones(len(found), bool)),
        per_category={group: _means(per_item, groups == group) for group in shown},
        items=len(found),
        per_item=per_item,
        names=list(prediction.names),
        category_items={group: int((groups == group).sum()) for group in shown},
        notes=_notes(per_item, prediction),
    )


def _view_scores(views: np.ndarray, truth: np.ndarray) -> dict[str, np.ndarray]:
    """Return the metrics of the views (items 3 3), each (items,); none of shapes that are given in the camera's frame."""
    errors = view_errors_deg(views, truth)
    if errors is None:
        return {}
    upright = {"azimuth_deg": azimuth_errors_deg, "elevation_deg": elevation_errors_deg}
    used = upright if is_upright(truth) else {"rotation_deg": rotation_errors_deg}
    found = {"views_within_20": (errors <= WITHIN_DEG).astype(np.float64)}
    for metric, of in used.items():
        value = of(views, truth)
        assert value is not None  # as the errors are
        found[metric] = value
    return found


def _means(per_item: dict[str, np.ndarray], rows: np.ndarray) -> dict[str, float]:
    """Return the mean of each metric over ``rows`` (the median of degrees), where it applies to any."""
    means = {}
    for metric in sorted(per_item, key=metric_order):
        values = per_item[metric][rows]
        values = values[np.isfinite(values)]
        if len(values):
            means[metric] = float(np.median(values) if metric_kind(metric) == "deg" else values.mean())
    return means


def _notes(per_item: dict[str, np.ndarray], prediction: ShapePrediction) -> list[str]:
    notes = ["depth is relative: each shape was moved along z until its centroid was as far away as the truth's"]
    empty = sum(not (grid > prediction.level).any() for grid in prediction.occupancy)
    if empty:
        what = f"are empty, nothing above {prediction.level:g}: they score 0, and a chamfer of 1"
        notes.append(f"{empty} of {len(prediction)} predicted shapes {what}")
    own = int(np.isnan(per_item["handedness"]).sum())
    if own:
        what = f"are their own mirror image in depth (IoU above {OWN_MIRROR:g}): they have no handedness"
        notes.append(f"{own} of {len(prediction)} true shapes {what}")
    return notes
