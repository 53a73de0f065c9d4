"""The verbs tasks, skeletons and compare: tasks with their data, shipped skeletons, runs side by side."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

from uplift.cli.kinds import KINDS
from uplift.config.files import shipped_names
from uplift.config.loading import load_settings
from uplift.config.run import RunFolder, data_id
from uplift.data.load import find_data, set_of
from uplift.errors import UserError
from uplift.skeleton import load_skeleton

__all__ = ["compare", "list_skeletons", "list_tasks", "spread"]


def list_tasks() -> str:
    """Return a line for each shipped task: name, whether its data is present, what it is."""
    lines = []
    for name in (name for name in shipped_names("tasks") if name != "default"):
        settings = load_settings(name)
        if settings.data.simulate:
            state = "no data needed"
        elif not settings.data.train:
            state = "data.train=..."
        else:
            try:
                if set_of(settings, "train") is None:
                    find_data(settings, "train")
                state = "data present"
            except UserError:
                state = "data missing"
        lines.append(f"{name:<18} {state:<15} {settings.description.strip().splitlines()[0]}")
    return "\n".join([*lines, "", "uplift fit task=NAME; your own task file: uplift fit task=FILE.yaml"])


def list_skeletons() -> str:
    """Return a line for each shipped skeleton."""
    lines = []
    for name in shipped_names("skeletons"):
        skeleton = load_skeleton(name)
        views = "gravity" if skeleton.gravity else "no gravity"
        lines.append(f"{name:<18} {len(skeleton.joints):>3} joints  {views:<10}  {skeleton.description}")
    lines += ["", "uplift skeleton check NAME|FILE draws one; uplift skeleton new FILE starts your own"]
    return "\n".join(lines)


# The verb compare: runs side by side, and the spread over seeds.


def compare(runs: Sequence[str | Path]) -> str:
    """Return a table with a row for each protocol and a column for each run.

    Raises:
        UserError: fewer than two runs, one that was never evaluated, or runs that lift different things.
    """
    if len(runs) < 2:
        raise UserError("compare needs two runs or more: uplift compare runs/a/last runs/b/last")
    folders = [RunFolder.open(run) for run in runs]
    evaluations = []
    for folder in folders:
        evaluation = folder.evaluation()
        if evaluation is None:
            words = f"run={folder.path} data.test=FILE{folder.trust_to_lift()}"
            raise UserError(f"{folder.path} was not evaluated: uplift evaluate {words}")
        evaluations.append(evaluation)
    shown, wide = _protocols(folders)
    marks = [f"[{number}]" for number in range(1, len(folders) + 1)]
    lines = [
        f"{mark} {'/'.join(folder.path.parts[-2:])}  seed {folder.facts().get('seed')}"
        for mark, folder in zip(marks, folders, strict=True)
    ]
    tested = [evaluation["data"] for evaluation in evaluations]
    # Files of one name may be several; those of earlier versions have the whole path for a name.
    if len({evaluation.get("data_id") or data_id(str(evaluation["data"])) for evaluation in evaluations}) > 1:
        different = "; ".join(f"{mark} {data}" for mark, data in zip(marks, tested, strict=True))
        lines.append(f"Not the same test data: {different}")
    else:
        lines.append(f"test data: {tested[0]}")
    lines += ["", f"{'protocol':<{wide}}" + "".join(f"{mark:>10}" for mark in marks)]
    for name in shown:
        values = [e["overall"].get(name) for e in evaluations]
        if any(value is not None for value in values):
            lines.append(f"{name:<{wide}}" + "".join(f"{v:10.3f}" if v is not None else f"{'-':>10}" for v in values))
    return "\n".join(lines)


def spread(runs: Sequence[RunFolder]) -> str:
    """Return mean and standard deviation over the runs' seeds, a row for each protocol."""
    evaluations = [e for e in (run.evaluation() for run in runs) if e is not None]
    if not evaluations:
        return "No run was evaluated: no mean to give."
    seeds = ", ".join(str(run.facts().get("seed")) for run in runs)
    shown, wide = _protocols(runs)
    lines = [f"seeds {seeds}: mean and standard deviation", f"{'protocol':<{wide}}{'mean':>10}{'sd':>9}"]
    for name in shown:
        values = [e["overall"][name] for e in evaluations if name in e["overall"]]
        if len(values) == len(evaluations):
            sd = statistics.stdev(values) if len(values) > 1 else 0.0
            lines.append(f"{name:<{wide}}{statistics.fmean(values):10.3f}{sd:9.3f}")
    return "\n".join(lines)


def _protocols(runs: Sequence[RunFolder]) -> tuple[Sequence[str], int]:
    """Return the metrics that are shown of such runs, and the width of their names; refuse runs of both kinds."""
    kinds = [KINDS[run.settings().lifts] for run in runs]
    for run, kind in zip(runs, kinds, strict=True):
        if kind is not kinds[0]:
            both = f"{runs[0].path} lifts {kinds[0].lifts} and {run.path} lifts {kind.lifts}"
            raise UserError(f"{both}: they have no metric in common. Compare runs of one kind.")
    return kinds[0].compared, max(18, max(map(len, kinds[0].compared)) + 2)
