"""The verbs tasks, skeletons and compare: tasks with their data, shipped skeletons, runs side by side."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uplift.cli.kinds import KINDS
from uplift.cli.parsing import keyed
from uplift.config.files import absolute, shipped_names
from uplift.config.loading import load_settings
from uplift.config.run import RunFolder, data_id
from uplift.data.load import find_data, set_of
from uplift.errors import UserError, listed
from uplift.skeleton import load_skeleton

__all__ = ["compare", "compare_command", "list_skeletons", "list_tasks", "spread"]


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


def compare_command(words: Sequence[str]) -> None:
    """Print the table of `compare`."""
    keys = keyed("compare", words)
    print(compare(keys.plain, evaluation=keys.value("evaluation"), test=keys.get("data.test")))


def compare(runs: Sequence[str | Path], *, evaluation: str | Sequence[str] = (), test: str | Path | None = None) -> str:
    """Return a table with a row for each protocol and a column for each run.

    The newest evaluation of each run is shown: of all, of those on the file ``test``, or else the one that is called
    ``evaluation``, one name for all runs or one for each.

    Raises:
        UserError: fewer than two runs, one that was never evaluated (so), or runs that lift different things.
    """
    if len(runs) < 2:
        raise UserError("compare needs two runs or more: uplift compare runs/a/last runs/b/last")
    names = [evaluation] if isinstance(evaluation, str) else list(evaluation)
    if names and test is not None:
        raise UserError("compare: evaluation= and data.test= both say which evaluation. Give one of them.")
    if len(names) not in (0, 1, len(runs)):
        raise UserError(
            f"evaluation={','.join(names)}: {len(names)} names for {len(runs)} runs. Give one, or one each."
        )
    folders = [RunFolder.open(run) for run in runs]
    wanted = names * (len(runs) if len(names) == 1 else 1) or [None] * len(runs)
    evaluations = [_evaluation(folder, name, test) for folder, name in zip(folders, wanted, strict=True)]
    shown, wide = _protocols(folders)
    marks = [f"[{number}]" for number in range(1, len(folders) + 1)]
    lines = [
        f"{mark} {'/'.join(folder.path.parts[-2:])}  seed {folder.facts().get('seed')}"
        for mark, folder in zip(marks, folders, strict=True)
    ]
    tested = [evaluation["data"] for evaluation in evaluations]
    if len({_id_of(evaluation) for evaluation in evaluations}) > 1:  # files of one name may be several
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


def _evaluation(folder: RunFolder, name: str | None, test: str | Path | None) -> dict[str, Any]:
    """Return the evaluation of a run of that name, the newest on a test file, or the newest."""
    again = f"uplift evaluate run={folder.path}{folder.trust_to_lift()} data.test="
    if test is None:
        found = folder.evaluation(name)
        if found is None:
            raise UserError(f"{folder.path} was not evaluated: {again}FILE")
        return found
    by_age = sorted(folder.evaluations.glob("*.json"), key=lambda path: (path.stat().st_mtime_ns, path.name))
    every = [found for path in reversed(by_age) if (found := folder.evaluation(path.stem))]
    on = [found for found in every if _id_of(found) in (data_id(str(test)), data_id(absolute(str(test))))]
    if not on:
        known = listed(dict.fromkeys(found["data"] for found in every)) or "nothing"
        raise UserError(f"{folder.path} was not evaluated on {test} (but on {known}): {again}{test}")
    return on[0]


def _id_of(evaluation: dict[str, Any]) -> str:
    """Return what tells the test data of an evaluation; those of earlier versions have the whole path for a name."""
    return evaluation.get("data_id") or data_id(str(evaluation["data"]))


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
