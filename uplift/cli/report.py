"""What a fit leaves to read: evaluation, report.md, page.html, and the lines at its end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from uplift.cli.evaluate import MOST, evaluate_model, save_evaluation, score_shapes
from uplift.config.files import replacing
from uplift.config.run import RunFolder
from uplift.config.settings import Settings
from uplift.data.load import Loaded
from uplift.data.load_masks import LoadedMasks
from uplift.data.poses import PoseData
from uplift.data.tensors import as_seen, intrinsics_of
from uplift.export.page import write_html
from uplift.export.shape_page import write_shape_page
from uplift.metrics.evaluate import TRUTH_SIGN, flat_depth
from uplift.metrics.evaluate import evaluate as score
from uplift.metrics.protocols import BEST_FLOOR
from uplift.metrics.report import Evaluation, ShapeEvaluation
from uplift.metrics.scores import GivenPoses
from uplift.models.model import Model
from uplift.training.callbacks import read_metrics

if TYPE_CHECKING:
    from uplift.models.model import ShapeModel

__all__ = ["report", "report_shapes"]

# What the reports of all fits share, whatever is lifted: the head, the curves, the priors, the last lines.


def _prior_lines(settings: Settings) -> list[str]:
    """Return which priors had a say, and which of them are the user's own."""
    specs = {n: s for n, s in settings.priors.items() if float(s.get("weight", 1)) > 0}
    lines = ["Priors (weight): " + ", ".join(f"{n} {float(s.get('weight', 1)):g}" for n, s in specs.items()) + "."]
    for name, spec in specs.items():
        if ":" in str(spec.get("use", name)):
            lines.append(f"Prior {name} is the user's own ({spec['use']}): what it reads is for its author to say.")
    return lines


def _curves_of(run: RunFolder) -> dict[str, list[tuple[float, float]]]:
    """Return each curve of metrics.csv: stage and name -> (step, value) points."""
    curves: dict[str, list[tuple[float, float]]] = {}
    for stage, step, name, value in read_metrics(run.path / "metrics.csv"):
        curves.setdefault(f"{stage}: {name}", []).append((float(step), float(value)))
    return curves


def _head_lines(run: RunFolder, settings: Settings, notes: Sequence[str], spent: dict[str, float]) -> list[str]:
    """Return the first lines of report.md."""
    facts = run.facts()
    lines = [f"# {settings.task or 'own data'}", "", settings.description.strip(), ""]
    lines += ["```", facts["command"], "```", ""]
    lines += [f"- {note}" for note in notes]
    lines += [f"- {stage}: {seconds:.0f} s of training" for stage, seconds in spent.items()]
    return [*lines, f"- seed {settings.seed}, {facts['cores']} cores, torch {facts['versions']['torch']}", ""]


def _closing_lines(run: RunFolder, evaluated: bool, predicting: str) -> list[str]:
    """Return what a fit wrote and what comes next; ``predicting`` are the words of `predict` behind run=."""
    last = run.path.parent / "last"
    shown = last if last.is_symlink() and last.resolve() == run.path.resolve() else run.path
    return [
        f"\nwrote {run.path}/: lifter.pt, report.md, page.html" + (", evaluation.json" if evaluated else ""),
        f"look: open {run.path / 'page.html'} in a browser",
        f"next: uplift evaluate run={shown}",
        f"      uplift predict run={shown} {predicting}",
    ]


# What a fit leaves to read: evaluation, report.md, page.html, and the lines at its end.

_HEADLINES = ("mpjpe", "p_mpjpe", "n_mpjpe", "mpjpe_gt_scale", "facing", "facing_sign", "elevation_deg")


def report(run: RunFolder, model: Model, settings: Settings, loaded: Loaded, spent: dict[str, float]) -> None:
    """Evaluate where there are test poses, write report.md and page.html, and print what comes next."""
    data = loaded.test if loaded.test is not None else loaded.train.without_truth()
    evaluation = flat = None
    if loaded.test is not None and loaded.test.pose is not None:
        evaluation = evaluate_model(model, loaded.test, loaded.test.source)
        save_evaluation(evaluation, run)
        floor = GivenPoses(flat_depth(data.keypoints, model.skeleton.root_index), model.skeleton.joints)
        flat = score(floor, loaded.test, model.skeleton)
    given = _given_lines(settings, loaded)
    text = _markdown(run, settings, loaded, spent, given, evaluation, flat)
    with replacing(run.path / "report.md") as file:
        file.write(text.encode())
    title = f"{settings.task or 'own data'}: {model.skeleton.name}"
    sections = [("Errors", _rows(evaluation, flat))] if evaluation and flat else []
    write_html(
        model.predict(data.select(_some_rows(data)), title=title),
        run.path / "page.html",
        sections=sections,
        curves=_curves_of(run),
        notes=given,
    )
    _print_end(run, evaluation, flat, spent)


def _given_lines(settings: Settings, loaded: Loaded) -> list[str]:
    """Return what the fit was given, a sentence each: the answer to "did it see 3D?"."""
    lines = ["Learned from 2D keypoints alone: no pose, root depth or camera tilt of the data was looked at."]
    labels = [data.labelled for data in (loaded.train, loaded.more) if data is not None and data.labelled is not None]
    if labels:
        count, total = sum(int(which.sum()) for which in labels), len(loaded.train) + len(loaded.more or ())
        lines = [
            f"Learned from the true poses, root positions and camera tilts of {count:,} labelled frames of {total:,}; "
            "of the others from 2D keypoints alone."
        ]
    if settings.init:
        lines = [f"Started from the weights of {settings.init}; see that run for what it learned from."]
    if settings.data.simulate:
        lines.append(
            "The keypoints are simulated: bodies and motions from published anthropometry and ranges of motion."
        )
    if intrinsics_of(as_seen(loaded.train, settings.lifter), settings.lifter) is not None:
        lines.append("The camera's focal length and image centre, from the file, were used.")
    train = loaded.train
    if settings.student.share and settings.student.refine.iterations and len(np.unique(train.clips())) < len(train):
        lines.append("Which frames make a clip was used: one body and a smooth motion in each.")
    return [*lines, *_prior_lines(settings)]


def _some_rows(data: PoseData, most: int = 1500) -> np.ndarray:
    """Return rows of whole clips, spread over the file, for the page."""
    clips = data.clips()
    names, first = np.unique(clips, return_index=True)
    names = names[np.argsort(first)]
    counts = np.bincount(clips)[names]
    step = max(1, int(np.ceil(len(names) * counts.mean() / most)))
    picked = names[::step]
    rows = np.flatnonzero(np.isin(clips, picked))
    return rows[:most]


def _rows(evaluation: Evaluation, flat: Evaluation) -> list[list[object]]:
    rows: list[list[object]] = [["protocol", "this run", "flat depth"]]
    for name in _HEADLINES:
        if name in evaluation.overall:
            floor = flat.overall.get(name)
            rows.append([name, evaluation.overall[name], floor if floor is not None else ""])
    return rows


def _markdown(run, settings, loaded, spent, given, evaluation, flat) -> str:
    lines = _head_lines(run, settings, [*loaded.notes, *given], spent)
    if evaluation is not None:
        lines += ["## Errors", "", "| protocol | this run | flat depth |", "|---|---|---|"]
        for name, value, floor in _rows(evaluation, flat)[1:]:
            shown = f"{floor:.4g}" if isinstance(floor, float) else ""
            lines.append(f"| `{name}` | {value:.4g} | {shown} |")
        lines += ["", "Flat depth is the observed 2D with every depth 0: what any lifter must beat.", ""]
        lines += ["```", evaluation.table(), "```", ""]
    return "\n".join(lines) + "\n"


def _doubts(evaluation: Evaluation) -> list[str]:
    """Return what a user should look into: directions that the truth itself contradicts, or poses mirrored in depth."""
    told = [note for note in evaluation.notes if note.startswith(TRUTH_SIGN)]
    if told and float(told[0].split()[-1]) < 0.5:
        return [f"{told[0]}: left and right, or front and back, are exchanged in the skeleton's `facing`."]
    facing = evaluation.overall.get("facing")
    if facing is None or facing > 0.75:
        return []
    return [
        f"facing {facing:.2f} is near chance: nothing told poses from their mirror images in depth. Look at `facing` in the "
        "skeleton, and at `gravity`: false for what is seen from every side. Or train longer."
    ]


def _print_end(run: RunFolder, evaluation: Evaluation | None, flat: Evaluation | None, spent: dict[str, float]) -> None:
    print(f"\ntrained for {sum(spent.values()):.0f} s")
    if evaluation is not None and flat is not None:
        print(f"\n{evaluation.data}: {evaluation.frames:,} frames, unit {evaluation.unit}\n")
        print(f"{'protocol':<18}{'this run':>10}{'flat depth':>12}")
        for name, value, floor in _rows(evaluation, flat)[1:]:
            shown = f"{floor:12.3f}" if isinstance(floor, float) else ""
            print(f"{name!s:<18}{value:10.3f}{shown}")
        for doubt in _doubts(evaluation):
            print(f"\n{doubt}")
    else:
        print(
            "No test poses: nothing to evaluate. `uplift evaluate run=... data.test=FILE` does, on frames with truth."
        )
    print("\n".join(_closing_lines(run, evaluation is not None, "input=KEYPOINTS output=poses.html")))


# What a fit of masks leaves to read: evaluation, report.md, page.html, and the lines at its end.

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
    given = _given_to_shapes(settings, loaded)
    with replacing(run.path / "report.md") as file:
        file.write(_shape_markdown(run, settings, [*loaded.notes, *given], spent, evaluation).encode())
    write_shape_page(
        prediction,
        run.path / "page.html",
        truth=truth,
        scores=scores,
        sections=[("Metrics", _shape_rows(evaluation))] if evaluation else [],
        curves=_curves_of(run),
        notes=given,
    )
    _print_shape_end(run, evaluation, spent, given[0])


def _given_to_shapes(settings: Settings, loaded: LoadedMasks) -> list[str]:
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
    return [*lines, *(_prior_lines(settings) if settings.priors else [])]


def _shape_rows(evaluation: ShapeEvaluation) -> list[list[object]]:
    """Return the metrics of the run with those of each floor; the first row is the header."""
    rows: list[list[object]] = [["metric", "this run", *evaluation.floors]]
    for name, value in evaluation.overall.items():
        if not name.startswith(BEST_FLOOR):
            rows.append([name, value, *(floor.get(name, "") for floor in evaluation.floors.values())])
    return rows


def _shape_markdown(
    run: RunFolder, settings: Settings, notes: list[str], spent: dict[str, float], evaluation: ShapeEvaluation | None
) -> str:
    lines = _head_lines(run, settings, notes, spent)
    if evaluation is not None:
        header, *rows = _shape_rows(evaluation)
        lines += ["## Metrics", "", f"| {' | '.join(map(str, header))} |", "|" + "---|" * len(header)]
        lines += ["| " + " | ".join(_shown(cell) for cell in row) + " |" for row in rows]
        if evaluation.floors:
            lines += ["", "The floors learned from true training shapes, which this run never saw."]
        lines += ["", "```", evaluation.table(), "```", ""]
    return "\n".join(lines) + "\n"


def _shown(cell: object) -> str:
    return f"{cell:.3f}" if isinstance(cell, float) else str(cell)


def _print_shape_end(run: RunFolder, evaluation: ShapeEvaluation | None, spent: dict[str, float], given: str) -> None:
    print(f"\ntrained for {sum(spent.values()):.0f} s\n{given}")
    if evaluation is not None:
        print(f"\n{evaluation.data}: {evaluation.items:,} shapes\n")
        for name, *cells in _shape_rows(evaluation):
            print(f"{name!s:<24}" + "".join(f"{_shown(cell):>12}" for cell in cells))
    else:
        print(
            "No true test shapes: nothing to evaluate. `uplift evaluate run=... data.test=FILE` does, on masks with truth."
        )
    print("\n".join(_closing_lines(run, evaluation is not None, "input=MASKS output=shapes.html")))
