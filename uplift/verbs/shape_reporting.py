"""What a fit of masks leaves to read: evaluation, report.md, page.html, and the lines at its end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from uplift.config import Settings
from uplift.evaluation.shape_metrics import BEST_FLOOR
from uplift.evaluation.shape_report import ShapeEvaluation
from uplift.masks.load import LoadedMasks
from uplift.run import RunFolder
from uplift.saving import replacing
from uplift.verbs.evaluate import save_evaluation
from uplift.verbs.evaluate_shapes import MOST, score_shapes
from uplift.verbs.report_parts import closing_lines, curves_of, head_lines, prior_lines
from uplift.writers.shape_page import write_shape_page

if TYPE_CHECKING:
    from uplift.shapes.model import ShapeModel

__all__ = ["given_to_shapes", "report_shapes"]

_SCORES = {"volume IoU": "volume_iou", "unseen silhouettes": "silhouette_iou_unseen", "chamfer": "chamfer"}


def report_shapes(
    run: RunFolder, model: ShapeModel, settings: Settings, loaded: LoadedMasks, spent: dict[str, float]
) -> None:
    """Evaluate where there are true test shapes, write report.md and page.html, and print what comes next."""
    title = f"{settings.task or 'own data'}: shapes from masks"
    evaluation, truth, scores = None, None, {}
    if loaded.test is not None and loaded.test.truth is not None:
        scored = score_shapes(model, loaded.test, loaded.train, title)
        evaluation, truth, prediction = scored.evaluation, scored.test.truth, scored.prediction
        save_evaluation(evaluation, run)
        scores = {name: evaluation.per_item[key] for name, key in _SCORES.items() if key in evaluation.per_item}
    else:
        data = (loaded.test or loaded.train).without_truth()
        prediction = model.predict(
            data.select(np.arange(min(MOST, len(data))) * len(data) // min(MOST, len(data))), title
        )
    given = given_to_shapes(settings, loaded)
    with replacing(run.path / "report.md") as file:
        file.write(_markdown(run, settings, [*loaded.notes, *given], spent, evaluation).encode())
    write_shape_page(
        prediction,
        run.path / "page.html",
        truth=truth,
        scores=scores,
        sections=[("Metrics", _rows(evaluation))] if evaluation else [],
        curves=curves_of(run),
        notes=given,
    )
    _print_end(run, evaluation, spent, given[0])


def given_to_shapes(settings: Settings, loaded: LoadedMasks) -> list[str]:
    """Return what the fit was given, a sentence each: the answer to "did it see 3D?"."""
    data, shape = settings.data, settings.shape
    lines = ["Learned from masks alone: no shape, view or category of the data was looked at."]
    labelled = loaded.train.labelled
    if labelled is not None and labelled.any():
        lines = [
            f"Learned from the true shapes and views of {int(labelled.sum()):,} labelled masks of {len(labelled):,}; "
            "of the others from masks alone. No category was looked at."
        ]
    if settings.init:
        lines = [f"Started from the weights of {settings.init}; see that run for what it learned from."]
    if data.category or data.select.categories or data.hold_out.categories:
        lines.append("Which masks are used was chosen by their categories.")
    if data.simulate:
        lines.append(f"The masks are of made-up shapes of simple parts ({data.family}).")
    mean, sd = shape.elevation_deg
    told = [f"cameras look down by {mean:g} degrees, give or take {sd:g}"] if shape.gravity else []
    told.insert(0, "shapes stand upright" if shape.gravity else "shapes are seen from every side")
    told += ["shapes are their own mirror image, left and right"] * shape.symmetric
    lines.append(f"Told beforehand (shape.*): {'; '.join(told)}.")
    return [*lines, *(prior_lines(settings) if settings.priors else [])]


def _rows(evaluation: ShapeEvaluation) -> list[list[object]]:
    """Return the metrics of the run with those of each floor; the first row is the header."""
    rows: list[list[object]] = [["metric", "this run", *evaluation.floors]]
    for name, value in evaluation.overall.items():
        if not name.startswith(BEST_FLOOR):
            rows.append([name, value, *(floor.get(name, "") for floor in evaluation.floors.values())])
    return rows


def _markdown(
    run: RunFolder, settings: Settings, notes: list[str], spent: dict[str, float], evaluation: ShapeEvaluation | None
) -> str:
    lines = head_lines(run, settings, notes, spent)
    if evaluation is not None:
        header, *rows = _rows(evaluation)
        lines += ["## Metrics", "", f"| {' | '.join(map(str, header))} |", "|" + "---|" * len(header)]
        lines += ["| " + " | ".join(_shown(cell) for cell in row) + " |" for row in rows]
        if evaluation.floors:
            lines += ["", "The floors learned from true training shapes, which this run never saw."]
        lines += ["", "```", evaluation.table(), "```", ""]
    return "\n".join(lines) + "\n"


def _shown(cell: object) -> str:
    return f"{cell:.3f}" if isinstance(cell, float) else str(cell)


def _print_end(run: RunFolder, evaluation: ShapeEvaluation | None, spent: dict[str, float], given: str) -> None:
    print(f"\ntrained for {sum(spent.values()):.0f} s\n{given}")
    if evaluation is not None:
        print(f"\n{evaluation.data}: {evaluation.items:,} shapes\n")
        for name, *cells in _rows(evaluation):
            print(f"{name!s:<24}" + "".join(f"{_shown(cell):>12}" for cell in cells))
    else:
        print(
            "No true test shapes: nothing to evaluate. `uplift evaluate run=... data.test=FILE` does, on masks with truth."
        )
    print("\n".join(closing_lines(run, evaluation is not None, "input=MASKS output=shapes.html")))
