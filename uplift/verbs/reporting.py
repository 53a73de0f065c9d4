"""What a fit leaves to read: evaluation, report.md, page.html, and the lines at its end."""

from __future__ import annotations

import numpy as np

from uplift.config import Settings
from uplift.data.container import PoseData
from uplift.data.load import Loaded
from uplift.evaluation import Evaluation, GivenPoses, flat_depth
from uplift.evaluation import evaluate as score
from uplift.evaluation.evaluator import TRUTH_SIGN
from uplift.model import Model
from uplift.run import RunFolder
from uplift.saving import replacing
from uplift.seeing import as_seen, intrinsics_of
from uplift.verbs.evaluate import evaluate_model, save_evaluation
from uplift.verbs.report_parts import closing_lines, curves_of, head_lines, prior_lines
from uplift.writers.html import write_html

__all__ = ["given_lines", "report"]

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
    given = given_lines(settings, loaded)
    text = _markdown(run, settings, loaded, spent, given, evaluation, flat)
    with replacing(run.path / "report.md") as file:
        file.write(text.encode())
    title = f"{settings.task or 'own data'}: {model.skeleton.name}"
    sections = [("Errors", _rows(evaluation, flat))] if evaluation and flat else []
    write_html(
        model.predict(data.select(_some_rows(data)), title=title),
        run.path / "page.html",
        sections=sections,
        curves=curves_of(run),
        notes=given,
    )
    _print_end(run, evaluation, flat, spent)


def given_lines(settings: Settings, loaded: Loaded) -> list[str]:
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
    return [*lines, *prior_lines(settings)]


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
    lines = head_lines(run, settings, [*loaded.notes, *given], spent)
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
    print("\n".join(closing_lines(run, evaluation is not None, "input=KEYPOINTS output=poses.html")))
