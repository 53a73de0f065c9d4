"""What a fit leaves to read: evaluation, report.md, page.html, and the lines at its end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uplift.cli.evaluate import MOST, save_evaluation, score_shapes
from uplift.config.files import as_bytes, replacing, without_folders
from uplift.config.progress import say
from uplift.config.run import RunFolder, lifter_label
from uplift.config.settings import Settings
from uplift.data.tensors import intrinsics_of, undistorted
from uplift.export.html import Section, Term
from uplift.export.page import write_html
from uplift.export.shape_page import write_shape_page
from uplift.metrics.baselines import flat_depth
from uplift.metrics.evaluate import TRUTH_SIGN, evaluate_model
from uplift.metrics.evaluate import evaluate as score
from uplift.metrics.protocols import (
    BEST_BASELINE,
    figure_text,
    metric_better,
    metric_label,
    metric_meaning,
    metric_order,
    metric_unit,
)
from uplift.metrics.report import AnyEvaluation, Evaluation
from uplift.metrics.scores import GivenPoses
from uplift.metrics.view_errors import WITHIN_DEG, view_errors_deg
from uplift.training.callbacks import read_metrics

if TYPE_CHECKING:
    from uplift.data.load import Loaded
    from uplift.data.load_masks import LoadedMasks
    from uplift.data.masks import MaskData
    from uplift.data.poses import PoseData
    from uplift.models.model import Model, ShapeModel
    from uplift.training.shape_recipe import ShapeRecipe
    from uplift.training.stages import Recipe

__all__ = ["Findings", "Training", "pose_findings", "report", "shape_findings"]


@dataclass(frozen=True)
class _Words:
    """Layout and texts of the report of one kind of run."""

    title: str
    metric: str  # how report.md writes a metric's name
    number: str  # how report.md writes a number
    widths: tuple[int, int]  # of the first two columns in the terminal
    baselines: str  # what baselines are, for report.md
    no_truth: str
    predict: str  # the arguments of the suggested ``uplift predict run=...``
    stages: tuple[str, ...] = ()  # what the stages of the curves are, for a page


@dataclass(frozen=True)
class Findings:
    """What a report says about a fit of either kind."""

    words: _Words
    given: list[str]
    """What the fit learned from, a sentence each: the answer to "did it see 3D?"."""
    write_page: Callable[..., None]
    """Takes the path, and the sections, curves and notes of a page."""
    shown: list[str] = field(default_factory=list)
    """What the terminal shows of ``given``."""
    evaluation: AnyEvaluation | None = None
    about: str = ""
    """What was evaluated, in a line."""
    names: Sequence[str] = ()
    """The metrics that are shown."""
    baselines: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    doubts: Sequence[str] = ()
    """What a user should look into."""

    def rows(self) -> list[list[object]]:
        """Return the figures of the run beside those of the baselines, a header first; nothing without an evaluation."""
        if self.evaluation is None:
            return []
        overalls = [self.evaluation.overall, *self.baselines.values()]
        header: list[object] = [self.evaluation.title, "this run", *self.baselines]
        return [header, *([name, *(overall.get(name, "") for overall in overalls)] for name in self.names)]

    def section(self) -> list[Section]:
        """Return the figures as a table of a page: plain names beside those of the field, with units."""
        if self.evaluation is None:
            return []
        (_, *header), *rows = self.rows()
        unit = self.evaluation.unit
        table = [
            [
                _term(str(name), unit),
                *(figure_text(str(name), cell, unit) if isinstance(cell, float) else cell for cell in cells),
            ]
            for name, *cells in rows
        ]
        return [(self.words.title, table, ["Measure", *(_BASELINES.get(str(name), str(name)) for name in header)])]


_BASELINES = {"hull": "visual hull", "mean_shape": "mean shape", "nearest": "nearest shape"}
"""What pages call the baselines whose names are not words."""


def _term(name: str, unit: str) -> Term:
    units = {"": "0 to 1", "deg": "degrees"}
    how = f"{units.get(metric_unit(name, unit), metric_unit(name, unit))}, {metric_better(name)} is better"
    label = metric_label(name)
    return Term(label[:1].upper() + label[1:], f"{name} · {how}", metric_meaning(name))


@dataclass(frozen=True)
class Training:
    """How long each stage of a fit trained."""

    spent: Mapping[str, float]
    """Seconds."""
    steps: Mapping[str, int]
    idle_priors: Mapping[str, int]
    """Steps of the priors that had no gradient in any of them."""

    def lines(self) -> list[str]:
        """Return a line for each stage."""
        return [
            f"{stage}: {seconds:.0f} s of training"
            + (
                f", {self.steps[stage]:,} steps, {self.steps[stage] / max(seconds, 1e-9):.3g} a second"
                if stage in self.steps
                else ""
            )
            for stage, seconds in self.spent.items()
        ]


def report(run: RunFolder, found: Findings, settings: Settings, loaded: Any, training: Training) -> None:
    """Write report.md and page.html, the evaluation where there is a truth, and print what comes next."""
    if found.evaluation is not None:
        save_evaluation(found.evaluation, run)
    run.add_facts(steps=dict(training.steps), seconds=dict(training.spent), idle_priors=dict(training.idle_priors))
    rows, doubtful = found.rows(), run.warnings()
    notes = [*doubtful, *loaded.notes, *found.given, *training.lines()]
    lines = [*_head_lines(run, settings, notes), *_figure_lines(found, rows)]
    with replacing(run.path / "report.md") as file:
        file.write(as_bytes("".join(f"{without_folders(line)}\n" for line in lines)))
    curves: dict[str, list[tuple[float, float]]] = {}
    for stage, step, name, value in read_metrics(run.path / "metrics.csv"):
        curves.setdefault(f"{stage}: {name}", []).append((float(step), float(value)))
    found.write_page(
        run.path / "page.html",
        sections=found.section(),
        curves=curves,
        notes=[*doubtful, *found.given, *found.words.stages],
    )
    say("\n".join(_end_lines(run, found, rows, training)))


def _head_lines(run: RunFolder, settings: Settings, notes: Sequence[str]) -> list[str]:
    facts = run.facts()
    return [
        *(
            f"# {settings.task or 'own data'}",
            "",
            settings.description.strip(),
            "",
            "```",
            facts.get("command", ""),
            "```",
            "",
        ),
        *(f"- {note}" for note in notes),
        *(f"- seed {settings.seed}, {facts.get('cores')} cores, torch {facts.get('versions', {}).get('torch')}", ""),
    ]


def _figure_lines(found: Findings, rows: list[list[object]]) -> list[str]:
    if found.evaluation is None:
        return []
    words, (header, *figures) = found.words, rows
    table = [header, *([words.metric.format(name), *cells] for name, *cells in figures)]
    table = [f"| {' | '.join(_cell(cell, words.number) for cell in cells)} |" for cells in table]
    lines = [f"## {words.title}", "", table[0], "|" + "---|" * len(header), *table[1:]]
    lines += ["", words.baselines] if found.baselines else []
    return [*lines, "", "```", found.evaluation.table(), "```", ""]


def _cell(cell: object, number: str) -> str:
    return format(cell, number) if isinstance(cell, float) else str(cell)


def _end_lines(run: RunFolder, found: Findings, rows: list[list[object]], training: Training) -> list[str]:
    """Return what a fit prints at its end: figures, what it wrote, what comes next."""
    lines = [f"\ntrained for {sum(training.spent.values()):.0f} s", *run.warnings(), *found.shown]
    if rows:
        lines += [f"\n{found.about}\n"]
        wide, narrow = found.words.widths
        for name, value, *others in rows:
            cells = f"{name!s:<{wide}}{_cell(value, '.3f'):>{narrow}}"
            lines.append((cells + "".join(f"{_cell(cell, '.3f'):>12}" for cell in others)).rstrip())
        lines += [f"\n{doubt}" for doubt in found.doubts]
    else:
        lines.append(found.words.no_truth)
    last = run.path.parent / "last"
    shown = last if last.is_symlink() and last.resolve() == run.path.resolve() else run.path
    trust = run.trust_to_lift()
    return [
        *lines,
        f"\nwrote {run.path}/: lifter.pt, report.md, page.html" + (", evaluation.json" if rows else ""),
        f"look: open {run.path / 'page.html'} in a browser",
        f"next: uplift evaluate run={shown}{trust}",
        f"      uplift predict run={shown} {found.words.predict}{trust}",
    ]


def _started(settings: Settings) -> list[str]:
    if not settings.init:
        return []
    return [f"Started from the weights of {lifter_label(settings.init)}; see there for what it learned from."]


def _prior_lines(settings: Settings, labelled: bool) -> list[str]:
    """Return which priors judged; that of labels only where there are any."""
    specs = {
        n: s for n, s in settings.priors.items() if float(s.get("weight", 1)) > 0 and (labelled or n != "labelled")
    }
    weights = ", ".join(f"{name} {float(spec.get('weight', 1)):g}" for name, spec in specs.items())
    foreign = {name: spec["use"] for name, spec in specs.items() if ":" in str(spec.get("use", name))}
    note = "Prior {} is user-defined ({}): ask its author what it reads."
    return [f"Priors (weight): {weights}.", *(note.format(*item) for item in foreign.items())]


# A fit of keypoints: errors beside those of flat depth.

_POSES = _Words(
    title="Errors",
    metric="`{}`",
    number=".4g",
    widths=(18, 10),
    baselines="Flat depth is the observed 2D with every depth 0: what any lifter must beat.",
    no_truth="No test poses: nothing to evaluate. `uplift evaluate run=... data.test=FILE` does, on frames with truth.",
    predict="input=KEYPOINTS output=poses.html",
    stages=(
        "Stages: the teacher learns from the priors, which judge lifted poses and how they look when turned; each student "
        "learns from the poses of the stage before it.",
    ),
)
_HEADLINES = ("mpjpe", "p_mpjpe", "n_mpjpe", "mpjpe_gt_scale", "facing", "facing_sign", "elevation_deg")


def pose_findings(model: Model, settings: Settings, loaded: Loaded, recipe: Recipe | None = None) -> Findings:
    """Return what a fit of keypoints reports."""
    test = loaded.test
    data = test if test is not None else loaded.train.without_truth()

    def write_page(path: Path, **parts: Any) -> None:
        title = f"{settings.task or 'own data'}: {model.skeleton.name}"
        write_html(model.predict(data.select(_some_rows(data)), title=title), path, **parts)

    given = _given_to_poses(settings, loaded)
    if test is None or test.pose is None:
        return Findings(_POSES, given, write_page)
    found = evaluate_model(model, test, test.source)
    flat = GivenPoses(flat_depth(test.keypoints, model.skeleton.root_index), model.skeleton.joints)
    return Findings(
        _POSES,
        given,
        write_page,
        evaluation=found,
        about=f"{found.data}: {found.frames:,} frames, unit {found.unit}",
        names=[name for name in _HEADLINES if name in found.overall],
        baselines={"flat depth": score(flat, test, model.skeleton).overall},
        doubts=_doubts(found),
    )


def _given_to_poses(settings: Settings, loaded: Loaded) -> list[str]:
    first = "Learned from 2D keypoints alone: no pose, root depth or camera tilt of the data was looked at."
    labels = [data.labelled for data in (loaded.train, loaded.more) if data is not None and data.labelled is not None]
    if labels:
        count, total = sum(int(which.sum()) for which in labels), len(loaded.train) + len(loaded.more or ())
        first = (
            f"Learned from the true poses, root positions and camera tilts of {count:,} labelled frames of {total:,}; "
            "of the others from 2D keypoints alone."
        )
    lines = [*_started(settings), first]
    if settings.data.simulate:
        origin = "bodies and motions from published anthropometry and ranges of motion"
        lines.append(f"The keypoints are simulated: {origin}.")
    if intrinsics_of(undistorted(loaded.train, settings.lifter), settings.lifter) is not None:
        lines.append("The camera's focal length and image centre, from the file, were used.")
    train = loaded.train
    if settings.student.share and settings.student.refine.iterations and len(np.unique(train.clips())) < len(train):
        lines.append("Which frames make a clip was used: one body and a smooth motion in each.")
    return [*lines, *_prior_lines(settings, labelled=bool(labels))]


def _some_rows(data: PoseData, most: int = 1500) -> np.ndarray:
    """Return rows of complete clips, spread over the file, for the page."""
    clips = data.clips()
    names, first = np.unique(clips, return_index=True)
    names = names[np.argsort(first)]
    counts = np.bincount(clips)[names]
    step = max(1, int(np.ceil(len(names) * counts.mean() / most)))
    return np.flatnonzero(np.isin(clips, names[::step]))[:most]


def _doubts(evaluation: Evaluation) -> list[str]:
    """Return whether the truth itself contradicts the skeleton's directions, or poses are mirrored in depth."""
    notes = [note for note in evaluation.notes if note.startswith(TRUTH_SIGN)]
    if notes and float(notes[0].split()[-1]) < 0.5:
        return [f"{notes[0]}: left and right, or front and back, are exchanged in the skeleton's `facing`."]
    facing = evaluation.overall.get("facing")
    if facing is None or facing > 0.75:
        return []
    return [
        f"facing {facing:.2f} is near chance: nothing distinguished poses from their mirror images in depth. Look at `facing` in the "
        "skeleton, and at `gravity`: false for what is seen from every side. Or train longer."
    ]


# A fit of masks: metrics beside those of baselines that learned from true shapes.

_SHAPES = _Words(
    title="Metrics",
    metric="{}",
    number=".3f",
    widths=(24, 12),
    baselines="The baselines learned from true training shapes, which this run never saw.",
    no_truth="No true test shapes: nothing to evaluate. "
    "`uplift evaluate run=... data.test=FILE` does, on masks with truth.",
    predict="input=MASKS output=shapes.html",
)
_SCORES = {
    "overlap in new views": "silhouette_iou_unseen",
    "surface within 2 %": "f_score",
    "surface distance": "chamfer",
}


def shape_findings(
    model: ShapeModel, settings: Settings, loaded: LoadedMasks, recipe: ShapeRecipe | None = None
) -> Findings:
    """Return what a fit of masks reports."""
    title = f"{settings.task or 'own data'}: shapes from masks"
    given = _given_to_shapes(settings, loaded)
    if loaded.test is None or loaded.test.truth is None:
        data = (loaded.test or loaded.train).without_truth()
        count = min(MOST, len(data))
        shown = model.predict(data.select(np.arange(count) * len(data) // count), title)
        return Findings(_SHAPES, given, partial(write_shape_page, shown), given[:1])
    test, prediction, found = score_shapes(model, loaded.test, loaded.train, title)
    if recipe is not None and (share := _views_found(recipe, loaded.train)) is not None:
        overall = {**found.overall, "train_views_within_20": share}
        found = replace(found, overall=dict(sorted(overall.items(), key=lambda one: metric_order(one[0]))))
    scores = {name: found.per_item[key] for name, key in _SCORES.items() if key in found.per_item}
    return Findings(
        _SHAPES,
        given,
        partial(write_shape_page, prediction, truth=test.truth, scores=scores),
        given[:1],
        evaluation=found,
        about=f"{found.data}: {found.items:,} shapes",
        names=[name for name in found.overall if not name.startswith(BEST_BASELINE)],
        baselines=found.baselines,
    )


def _views_found(recipe: ShapeRecipe, train: MaskData) -> float | None:
    """Return the share of the unlabelled training masks whose view was found, where their truth is known."""
    if train.truth is None or recipe.training_views is None or not np.isfinite(train.truth.view).all():
        return None
    rows = np.ones(len(train), bool) if train.labelled is None else ~train.labelled
    if len(recipe.training_views) != len(train) or not rows.any():
        return None
    errors = view_errors_deg(recipe.training_views[rows], np.asarray(train.truth.view[rows], np.float64))
    return None if errors is None else float((errors <= WITHIN_DEG).mean())


def _given_to_shapes(settings: Settings, loaded: LoadedMasks) -> list[str]:
    data, shape = settings.data, settings.shape
    first = "Learned from masks alone: no shape, view or category of the data was looked at."
    labelled = loaded.train.labelled
    if labelled is not None and labelled.any():
        first = (
            f"Learned from the true shapes and views of {int(labelled.sum()):,} labelled masks of {len(labelled):,}; "
            "of the others from masks alone. No category was looked at."
        )
    lines = [*_started(settings), first]
    if data.category or data.select.categories or data.hold_out.categories:
        lines.append("Which masks are used was chosen by their categories.")
    if data.simulate:
        lines.append(f"The masks are of simulated shapes of simple parts ({data.family}).")
    mean, sd = shape.elevation_deg
    assumed = ["shapes stand upright" if shape.gravity else "shapes are seen from every side"]
    assumed += [f"cameras look down by {mean:g} degrees, give or take {sd:g}"] * shape.gravity
    assumed += ["shapes are their own mirror image, left and right"] * shape.symmetric
    lines.append(f"Assumed (shape.*): {'; '.join(assumed)}.")
    return [*lines, *(_prior_lines(settings, labelled=True) if settings.priors else [])]
