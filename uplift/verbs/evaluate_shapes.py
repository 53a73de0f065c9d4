"""Evaluate a run that lifts masks, beside the floors where training shapes are known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from uplift.errors import UserError
from uplift.evaluation.shape_evaluator import evaluate_shapes
from uplift.evaluation.shape_floors import score_with_floors
from uplift.evaluation.shape_report import ShapeEvaluation
from uplift.masks.container import MaskData
from uplift.masks.labelled import known_shapes
from uplift.masks.load import load_mask_split, load_masks
from uplift.readers.files import absolute
from uplift.run import RunFolder
from uplift.shapes.prediction import ShapePrediction

if TYPE_CHECKING:
    from uplift.shapes.model import ShapeModel

__all__ = ["MOST", "ScoredShapes", "evaluate_run_of_shapes", "score_shapes"]

MOST = 100
"""Test items that are scored where nothing else is said: each takes most of a second, floors and all."""


@dataclass(frozen=True)
class ScoredShapes:
    """The items that were scored, what the lifter made of them, and how good that is."""

    test: MaskData
    prediction: ShapePrediction
    evaluation: ShapeEvaluation


def score_shapes(
    model: ShapeModel, test: MaskData, train: MaskData | None, title: str = "", most: int = MOST
) -> ScoredShapes:
    """Return every metric of ``model`` on at most ``most`` masks, and the floors' where ``train`` has true shapes.

    Raises:
        UserError: test masks without true shapes.
    """
    if test.truth is None:
        raise UserError(
            f"{test.source or 'the test masks'}: no true shapes to compare with, only masks. `uplift data render` makes "
            "masks with truth."
        )
    notes = []
    if len(test) > most:
        rows = np.sort(np.random.default_rng(0).choice(len(test), most, replace=False))
        notes.append(
            f"{most:,} of {len(test):,} test masks were scored, chosen at random, always the same (items={most})"
        )
        test = test.select(rows)
    prediction = model.predict(test.without_truth(), title=title)
    known = None if train is None else known_shapes(train)
    if known is None:
        notes.append("no floors: they are made of true training shapes, and none are known")
        found = evaluate_shapes(prediction, test.truth, test.masks, test.source, test.category)  # type: ignore[arg-type]
    else:
        found = score_with_floors(prediction, known, test, test.source)
    return ScoredShapes(test, prediction, replace(found, notes=[*found.notes, *notes]))


def evaluate_run_of_shapes(
    folder: RunFolder, model: ShapeModel, test: str | None = None, most: int = MOST
) -> ShapeEvaluation:
    """Return the metrics of a run on ``test``, or on its own test masks.

    Raises:
        UserError: no such masks, or no truth to compare with.
    """
    settings = folder.settings()
    if test is not None:
        chosen = replace(settings.data, test=absolute(test), train=None, simulate=0, format=None, category=None)
        masks = load_mask_split(replace(settings, data=replace(chosen, images=None, most=None)), "test")
        train, why = _training_masks(folder)
    else:
        loaded = load_masks(settings)
        if loaded.test is None:
            raise UserError(f"{folder.path} has no test masks of its own: give data.test=FILE.")
        masks, train, why = loaded.test, loaded.train, ""
    found = score_shapes(model, masks, train, most=most).evaluation
    return replace(found, notes=[*found.notes, why]) if why else found


def _training_masks(folder: RunFolder) -> tuple[MaskData | None, str]:
    """Return the masks that the floors are made of, or why there are none."""
    settings = folder.settings()
    settings.data.test = None
    try:
        return load_mask_split(settings, "train"), ""
    except UserError as error:
        return None, f"the training masks could not be read: {str(error).splitlines()[0]}"
