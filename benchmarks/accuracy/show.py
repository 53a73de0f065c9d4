"""The results of a table as text for the terminal or as markdown for the docs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.accuracy.cells import Cell

__all__ = ["SHOWN", "Sheet", "markdown", "sheets_of", "text"]

SHOWN = ("p_mpjpe", "mpjpe_gt_scale", "n_mpjpe", "facing", "elevation_deg")
"""The protocols with a column."""

_OCCLUSION = ("p_mpjpe", "n_mpjpe")
_ENDINGS = {"complete": "_complete", "hidden": "", "growth": "_growth", "missing": "_missing"}


@dataclass(frozen=True)
class Sheet:
    """A title, the heads of the columns, and rows of as many cells."""

    title: str
    head: list[str]
    rows: list[list[str]]


Results = dict[tuple[str, str], list[dict[str, Any]]]
"""What the seeds of each fit, at each time, found."""


def sheets_of(name: str, table: dict[str, Any], cells: Sequence[Cell]) -> list[Sheet]:
    """Return the errors, a row for each recipe, time and test, and what is there of occlusion and calibration.

    Figures are means over the seeds that have run, with the least and the greatest beside them. The
    ratio is that of the table's ``ratio`` protocol to the `overall` of the fit's reference.
    """
    found: Results = {}
    for cell in cells:
        result = cell.result()
        found.setdefault((cell.fit.name, cell.spent), []).extend([result] if result else [])
    protocol = table.get("ratio", "p_mpjpe")
    shown = SHOWN if protocol in SHOWN else (protocol, *SHOWN)
    rows = [row for key in found for row in _error_rows(key, found, cells, protocol, shown)]
    head = ["recipe", "trained", "seeds", *shown]
    if any(cell.fit.reference for cell in cells):
        head.append(f"{protocol} ratio")
    sheets = [Sheet(name, head, [row[: len(head)] for row in rows]), _occlusion(name, found), _calibration(name, found)]
    return [sheet for sheet in sheets if sheet.rows]


def _error_rows(
    key: tuple[str, str], found: Results, cells: Sequence[Cell], protocol: str, shown: Sequence[str]
) -> list[list[str]]:
    """Return the row of a fit and those of its further tests."""
    (name, spent), results = key, found[key]
    fit = next(cell.fit for cell in cells if cell.fit.name == name)
    against = found.get((fit.reference or "", spent)) or found.get((fit.reference or "", "-")) or []
    floor = _average([r["overall"].get(protocol) for r in against])
    overalls = {name: [r["overall"] for r in results]}
    for test in fit.tests:
        overalls[f"{name}, on {test}"] = [r["tests"][test] for r in results if test in r.get("tests", {})]
    rows = []
    for label, overall in overalls.items():
        mine = _average([o.get(protocol) for o in overall])
        ratio = "-" if not floor or mine is None else f"{mine / floor:.3f}"
        figures = [_mean([o.get(name) for o in overall]) for name in shown]
        rows.append([label, spent, str(len(overall)), *figures, ratio])
    return rows


def _occlusion(name: str, found: Results) -> Sheet:
    head = ["recipe", "trained", "hidden", *(f"{error} {column}" for error in _OCCLUSION for column in _ENDINGS)]
    rows = []
    for (fit, spent), results in found.items():
        tables = [r["occlusion"] for r in results if "occlusion" in r]
        for hidden in dict.fromkeys(key for table in tables for key in table):
            values = [
                _mean([table.get(hidden, {}).get(f"{error}{ending}") for table in tables])
                for error in _OCCLUSION
                for ending in _ENDINGS.values()
            ]
            rows.append([fit, spent, hidden, *values])
    return Sheet(f"{name}: joints that stay visible, and those that were hidden", head, rows)


def _calibration(name: str, found: Results) -> Sheet:
    rows, shares = [], {}
    for (fit, spent), results in found.items():
        curves = [r["calibration"] for r in results if r.get("calibration")]
        for group, ending in (("visible", ""), ("missing", "_missing")):
            some = [curve for curve in curves if group in curve]
            if some:
                shares = some[0][group]
                values = [_mean([curve[group][share] for curve in some]) for share in shares]
                values += [_mean([c.get(f"{of}{ending}") for c in some]) for of in ("spread_error", "rank_correlation")]
                rows.append([fit, spent, group, *values])
    head = ["recipe", "trained", "joints", *shares, "spread_error", "rank_correlation"]
    return Sheet(f"{name}: share of depth errors inside the interval of", head, rows)


def _average(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _mean(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    mean = _average(known)
    if mean is None:
        return "-"
    return f"{mean:.3f}" + (f" ({min(known):.3f}-{max(known):.3f})" if len(known) > 1 else "")


def text(sheet: Sheet) -> str:
    """Return a sheet with aligned columns."""
    lines = [sheet.head, *sheet.rows]
    widths = [max(len(row[place]) for row in lines) for place in range(len(sheet.head))]
    shown = [
        "  ".join(
            cell.rjust(width) if place else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in lines
    ]
    return "\n".join(["", sheet.title, *shown])


def markdown(sheet: Sheet) -> str:
    """Return a sheet as a markdown table."""
    marks = ["---", *("---:" for _ in sheet.head[1:])]
    return "\n".join(
        ["", f"**{sheet.title}**", "", *("| " + " | ".join(row) + " |" for row in (sheet.head, marks, *sheet.rows))]
    )
