"""What a sweep found: a row for each fit and for each setting, the best by the score of 2D alone, and errors apart from it."""

from __future__ import annotations

import csv
import io
import math
import os
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from uplift.cli.kinds import KINDS
from uplift.cli.listing import spread
from uplift.cli.sweep.cell import OWN_FRAMES
from uplift.cli.sweep.folder import Outcome, Sweep
from uplift.config.files import as_bytes, replacing
from uplift.config.grid import Cell
from uplift.metrics.report import Sheet

__all__ = ["best_of", "lines_of", "words_of", "write_tables"]

_SCORE = "score_2d"
_MOST_ROWS = 40
"""In the terminal; the files have all."""


@dataclass(frozen=True)
class _Group:
    """The finished fits of one setting of all but the seed."""

    values: dict[str, str]
    cells: list[Cell]
    outcomes: list[Outcome]

    def figures(self, name: str) -> list[float]:
        """Return a figure of the score for each fit that has it."""
        return [outcome.scores[name] for outcome in self.outcomes if name in outcome.scores]

    def mean(self) -> float:
        """Return the mean score; infinite without any."""
        return statistics.fmean(self.figures(_SCORE) or [math.inf])


def best_of(sweep: Sweep) -> tuple[Cell, str] | None:
    """Return the best fit by the score, and in words what it is the best of; None where fits cannot be compared.

    That is the fit with the lowest score among the seeds of the setting whose mean score is the lowest.
    """
    groups = [group for group in _groups(sweep) if math.isfinite(group.mean())]
    if not groups or any(axis.key in OWN_FRAMES for axis in sweep.axes):
        return None
    first, *rest = sorted(groups, key=_Group.mean)
    score = {
        cell.name: outcome.scores.get(_SCORE, math.inf)
        for cell, outcome in zip(first.cells, first.outcomes, strict=True)
    }
    cell = min(first.cells, key=lambda one: score[one.name])
    about = f"{_SCORE} {score[cell.name]:.4f}"
    if first.values:
        about = f"{words_of(first.values)}: mean {_SCORE} {first.mean():.4f}" + _lead(first, rest)
    return cell, about


def _lead(first: _Group, rest: Sequence[_Group]) -> str:
    """Return a remark where the second best is no farther off than seeds are from one another."""
    spread = max(
        (statistics.stdev(one.figures(_SCORE)) for one in (first, *rest[:1]) if len(one.outcomes) > 1), default=0.0
    )
    if not rest or not spread:
        return ""
    gap = rest[0].mean() - first.mean()
    return (
        f"; {words_of(rest[0].values)} is {gap:.4f} behind, less than seeds differ ({spread:.4f})"
        if gap < spread
        else ""
    )


def words_of(values: Mapping[str, str]) -> str:
    """Return the values of settings as ``key=value`` words."""
    return " ".join(f"{key}={value}" for key, value in values.items())


def _groups(sweep: Sweep) -> list[_Group]:
    """Return the finished fits by their settings but for the seed, in the order of the grid."""
    groups: dict[tuple[str, ...], _Group] = {}
    for cell, outcome in sweep.finished():
        values = {key: value for key, value in cell.values.items() if key != "seed"}
        group = groups.setdefault(tuple(values.values()), _Group(values, [], []))
        group.cells.append(cell)
        group.outcomes.append(outcome)
    return list(groups.values())


# Tables.


def lines_of(sweep: Sweep) -> list[str]:
    """Return what is printed at the end of a sweep."""
    failed, best = sweep.failed(), best_of(sweep)
    lines = [f"\nsweep: {len(sweep.finished()):,} of {len(sweep.cells):,} fits finished"]
    lines += [f"WARNING: {words_of(cell.values)} failed: {outcome.error}" for cell, outcome in failed]
    lines += [sheet.text() for sheet in _sheets(sweep)]
    lines += [f"\n{text}" for text in [_errors_of_seeds(sweep)] if text]
    if best is not None:
        cell, about = best
        lines += [
            "",
            f"best, by {_SCORE} alone: {about}",
            f"  uplift predict run={os.path.relpath(sweep.path / cell.name)} input=FILE output=poses.html",
        ]
    elif any(axis.key in OWN_FRAMES for axis in sweep.axes):
        varied = ", ".join(axis.key for axis in sweep.axes if axis.key in OWN_FRAMES)
        lines += ["", f"no best: scores of fits that differ in {varied} are not of the same keypoints."]
    return lines


def _sheets(sweep: Sweep) -> list[Sheet]:
    """Return the tables of scores and of errors that have rows."""
    groups = _groups(sweep)
    about = next((outcome.scored_on for group in groups for outcome in group.outcomes), "")
    sheets = []
    if any(group.figures(_SCORE) for group in groups):
        sheets.append(_score_sheet(sweep, groups, f"{_SCORE}, lower is better, on {about}"))
    elif about:
        sheets.append(Sheet(about, ["fits", "steps", "seconds"], [_cost(groups)]))
    errors = _errors(sweep)
    several = any(group.values for group in groups)
    return [*sheets, _error_sheet(groups, errors)] if errors and several else sheets


def _cost(groups: Sequence[_Group]) -> list[str]:
    outcomes = [outcome for group in groups for outcome in group.outcomes]
    steps, seconds = (
        statistics.fmean(values) for values in zip(*((one.steps, one.seconds) for one in outcomes), strict=True)
    )
    return [str(len(outcomes)), f"{steps:,.0f}", f"{seconds:,.1f}"]


def _score_sheet(sweep: Sweep, groups: Sequence[_Group], title: str) -> Sheet:
    """Return a row for each setting, the best first, with mean and spread over its seeds; for each fit where these are few."""
    keys = [axis.key for axis in sweep.axes if axis.key != "seed"]
    parts = list(
        dict.fromkeys(name for group in groups for one in group.outcomes for name in one.scores if name != _SCORE)
    )
    shown = sorted(groups, key=_Group.mean)
    if not keys:  # seeds alone: each of them, and all
        alone = [
            _Group({"seed": cell.values["seed"]}, [cell], [one])
            for cell, one in zip(groups[0].cells, groups[0].outcomes, strict=True)
        ]
        shown = [*sorted(alone, key=_Group.mean), _Group({"seed": "all"}, groups[0].cells, groups[0].outcomes)]
    rows = [
        [
            *group.values.values(),
            *_cost([group]),
            *(text for name in (_SCORE, *parts) for text in _mean_and_sd(group.figures(name), name)),
        ]
        for group in shown
    ]
    return Sheet(title, [*(keys or ["seed"]), "fits", "steps", "seconds", _SCORE, "sd", *parts], rows)


def _mean_and_sd(values: Sequence[float], name: str) -> list[str]:
    mean = f"{statistics.fmean(values):.4f}" if values else "-"
    sd = f"{statistics.stdev(values):.4f}" if len(values) > 1 else "-"
    return [mean, sd] if name == _SCORE else [mean]


# Errors against the truth: to read, not to choose by.


def _errors(sweep: Sweep) -> dict[str, dict[str, float]]:
    """Return the errors of each finished fit that was evaluated, by its name."""
    found = {}
    for cell, _ in sweep.finished():
        run = sweep.run_of(cell)
        evaluation = run.evaluation() if run else None
        if evaluation is not None:
            found[cell.name] = evaluation["overall"]
    return found


def _error_sheet(groups: Sequence[_Group], errors: Mapping[str, Mapping[str, float]], most: int | None = 3) -> Sheet:
    """Return a row for each setting with the mean and spread over its seeds of the main errors."""
    known = list(dict.fromkeys(name for kind in KINDS.values() for name in kind.compared))
    names = [name for name in known if all(name in one for one in errors.values())][:most]
    rows = []
    for group in groups:
        found = [errors[cell.name] for cell in group.cells if cell.name in errors]
        if found:
            rows.append(
                [
                    *(group.values.values() or ["all"]),
                    str(len(found)),
                    *(_spread([one[name] for one in found]) for name in names),
                ]
            )
    keys = list(groups[0].values) or ["seed"]
    return Sheet(_TITLE, [*keys, "fits", *names], rows)


def _errors_of_seeds(sweep: Sweep) -> str:
    """Return mean and spread of all errors where the fits differ in their seeds alone; nothing where they differ otherwise."""
    runs = [run for cell, _ in sweep.finished() if (run := sweep.run_of(cell)) is not None]
    seeds = [axis.key for axis in sweep.axes] == ["seed"]
    return f"{_TITLE}\n{spread(runs)}" if seeds and _errors(sweep) else ""


_TITLE = "errors against the truth: to read, not to choose by, as new data have none"


def _spread(values: Sequence[float]) -> str:
    sd = f" ± {statistics.stdev(values):.3f}" if len(values) > 1 else ""
    return f"{statistics.fmean(values):.3f}{sd}"


# Files.


def write_tables(sweep: Sweep) -> list[Path]:
    """Write sweep.csv and sweep.md, and errors.csv where fits were evaluated; return them."""
    outcomes = {cell.name: sweep.outcome(cell) for cell in sweep.cells}
    parts = list(dict.fromkeys(name for one in outcomes.values() if one for name in one.scores))
    keys = [axis.key for axis in sweep.axes]
    rows = [["run", *keys, "state", "steps", "seconds", *parts, "scored_on", "error"]]
    for cell in sweep.cells:
        one = outcomes[cell.name]
        state = "not finished" if one is None else "failed" if one.error else "finished"
        one = one or Outcome()
        scores = [f"{one.scores[name]:.6g}" if name in one.scores else "" for name in parts]
        rows.append(
            [
                cell.name,
                *cell.values.values(),
                state,
                str(one.steps),
                f"{one.seconds:.3f}",
                *scores,
                one.scored_on,
                one.error,
            ]
        )
    written = [_write_csv(sweep.path / "sweep.csv", rows)]
    with replacing(sweep.path / "sweep.md") as file:
        file.write(as_bytes("\n".join(_markdown(sweep))))
    errors = _errors(sweep)
    if errors:
        names = list(dict.fromkeys(name for one in errors.values() for name in one))
        rows = [["run", *keys, *names]]
        for cell in sweep.cells:
            if cell.name in errors:
                rows.append(
                    [
                        cell.name,
                        *cell.values.values(),
                        *(f"{errors[cell.name].get(name, math.nan):.6g}" for name in names),
                    ]
                )
        written.append(_write_csv(sweep.path / "errors.csv", rows))
    return [*written, sweep.path / "sweep.md"]


def _write_csv(path: Path, rows: Sequence[Sequence[str]]) -> Path:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    with replacing(path) as file:
        file.write(as_bytes(text.getvalue()))
    return path


def _markdown(sweep: Sweep) -> list[str]:
    best = best_of(sweep)
    grid = "; ".join(f"{axis.key}: {', '.join(axis.values)}" for axis in sweep.axes)
    lines = [f"# Sweep of {len(sweep.cells):,} fits", "", f"Task {sweep.task or 'of own data'}. {grid}."]
    lines += [sheet.markdown() for sheet in _sheets(sweep)]
    lines += ["", "```", text, "```"] if (text := _errors_of_seeds(sweep)) else []
    if best is not None:
        lines += ["", f"Best, by {_SCORE} alone: {best[1]}. Run: `{best[0].name}`."]
    failed = sweep.failed()
    lines += ["", *(f"- failed: {words_of(cell.values)}: {one.error}" for cell, one in failed)] if failed else []
    return [*lines, ""]
