"""Floors that a lifter of masks must beat: all three learn from true training shapes, which it never sees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from uplift.errors import UserError
from uplift.evaluation.shape_evaluator import RESOLUTION as TRUE_RESOLUTION
from uplift.evaluation.shape_evaluator import evaluate_all, filled_truths
from uplift.evaluation.shape_floor_hull import best_thickness, hull_occupancy
from uplift.evaluation.shape_floor_mean import mean_occupancy, mean_shape
from uplift.evaluation.shape_floor_nearest import nearest_masks
from uplift.evaluation.shape_metrics import BEST_FLOOR, metric_order
from uplift.evaluation.shape_report import ShapeEvaluation
from uplift.evaluation.shape_training import TrainingTruth, training_truth
from uplift.masks.container import MaskData, Placed
from uplift.shapes.prediction import ShapePrediction

__all__ = ["RESOLUTION", "SAMPLE", "floors", "score_with_floors"]

RESOLUTION = 48
"""Voxels along the floors' grids, an even number."""
SAMPLE = 500
"""Training items that thickness and mean shape are taken from."""
_BEST_OF = ("volume_iou", "silhouette_iou_unseen")


def floors(
    train: MaskData, test: MaskData, *, resolution: int = RESOLUTION, sample: int = SAMPLE, seed: int = 0
) -> dict[str, ShapePrediction]:
    """Return the shapes that `hull`, `mean_shape` and `nearest` give for the masks of ``test``.

    They learn from the true shapes of ``train``; of ``test`` they see the masks alone. Hull and mean
    shape stand in the camera's own frame, the nearest item's shape where it stood in its camera.

    Raises:
        UserError: the training set has no true shapes, or no items.
    """
    if train.truth is None or not len(train):
        raise UserError(
            f"{train.source or 'the training masks'}: no true shapes, and every floor (hull, mean_shape, nearest) is made "
            "of them. Give masks that were rendered from meshes."
        )
    known = training_truth(train, train.truth, sample, resolution, seed)
    return {
        "hull": _hull(known, test),
        "mean_shape": _mean_shape(known, test),
        "nearest": _nearest(train, train.truth, test, resolution),
    }


def score_with_floors(
    prediction: ShapePrediction,
    train: MaskData,
    test: MaskData,
    name: str,
    found: Mapping[str, ShapePrediction] | None = None,
    resolution: int = TRUE_RESOLUTION,
) -> ShapeEvaluation:
    """Return `evaluate_shapes` with every floor's figures, and the best floor's in ``overall``.

    ``found`` are floors already made by `floors`, where several predictions of the same masks are scored;
    ``resolution`` is that of the truth's grid.

    Raises:
        UserError: training or test masks without true shapes, other numbers of items.
    """
    if test.truth is None:
        raise UserError(f"{name}: no true shapes to compare with, only masks.")
    found = floors(train, test) if found is None else found
    scored = evaluate_all({"": prediction, **found}, test.truth, test.masks, name, test.category, resolution)
    own = scored.pop("")
    beside = {title: result.overall for title, result in scored.items()}
    overall = dict(own.overall)
    for metric in _BEST_OF:
        overall[BEST_FLOOR + metric] = max(values[metric] for values in beside.values())
    notes = [f"floor {title}: {note}" for title, floor in found.items() for note in floor.notes]
    return replace(
        own,
        overall={metric: overall[metric] for metric in sorted(overall, key=metric_order)},
        floors=beside,
        notes=[*own.notes, *notes],
    )


def _hull(train: TrainingTruth, test: MaskData) -> ShapePrediction:
    thickness = best_thickness(train)
    occupancy = [hull_occupancy(mask, train.distance, thickness, train.resolution) for mask in test.masks]
    note = f"each mask extruded by {thickness:.2f} of its longer side, the best on the truth of {len(train.half)} training items"
    return _in_camera("hull", _stacked(occupancy, train.resolution), train.distance, test, note)


def _mean_shape(train: TrainingTruth, test: MaskData) -> ShapePrediction:
    mean = mean_shape(train)
    occupancy = [mean_occupancy(mean, mask, train.distance) for mask in test.masks]
    where = "inside each mask" if mean.in_mask else "whole"
    note = f"mean of {len(train.half)} true training shapes above {mean.level:.2f}, {where}, the best on them"
    return _in_camera("mean_shape", _stacked(occupancy, train.resolution), train.distance, test, note)


def _stacked(occupancy: list[np.ndarray], resolution: int) -> np.ndarray:
    """Return grids as one array of half precision: floors of a thousand masks stay below a gigabyte."""
    return np.array(occupancy, np.float16).reshape(-1, resolution, resolution, resolution)


def _in_camera(title: str, occupancy: np.ndarray, distance: float, test: MaskData, note: str) -> ShapePrediction:
    """Return shapes whose own frame is the camera's, the cube of the crop."""
    items = len(test)
    view, zero = np.repeat(np.eye(3)[None], items, 0), np.zeros((items, 2))
    return _prediction(title, test, note, occupancy, view, np.ones(items), zero, np.full(items, distance))


def _nearest(train: MaskData, truth: Placed, test: MaskData, resolution: int) -> ShapePrediction:
    rows, mirrored = nearest_masks(test.masks, train.masks)
    sign = np.where(mirrored, -1.0, 1.0)
    flip = np.ones((len(rows), 3))
    flip[:, 0] = sign
    occupancy = np.zeros((len(rows), resolution, resolution, resolution), np.float16)
    for row, filled in filled_truths(truth, np.unique(rows), resolution):
        for item in np.flatnonzero(rows == row):
            occupancy[item] = filled[:, :, ::-1] if mirrored[item] else filled
    # Mirrored left to right in the image and in its own frame: a rotation again.
    view = flip[:, :, None] * truth.view[rows] * flip[:, None, :]
    offset = truth.offset[rows] * flip[:, :2]
    note = f"the true shape of the training item with the most similar mask of {len(train):,}, mirror images included"
    return _prediction("nearest", test, note, occupancy, view, truth.scale[rows], offset, truth.distance[rows])


def _prediction(title: str, test: MaskData, note: str, occupancy, view, scale, offset, distance) -> ShapePrediction:
    return ShapePrediction(
        occupancy, view, scale, offset, distance, test.masks, list(test.names), test.centre_px, test.scale_px,
        title=title, images=test.images, notes=(note,),
    )  # fmt: skip
