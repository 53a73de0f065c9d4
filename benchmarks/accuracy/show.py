"""The results of a table: errors, hidden joints, calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.accuracy.cells import Cell
from benchmarks.common import Sheet, mean_and_range

__all__ = ["SHOWN", "sheets_of"]

SHOWN = ("p_mpjpe", "mpjpe_gt_scale", "n_mpjpe", "facing", "elevation_deg")
"""The protocols with a column."""

_OCCLUSION = ("p_mpjpe", "n_mpjpe")
_ENDINGS = {"complete": "_complete", "hidden": "", "growth": "_growth", "missing": "_missing"}


Results = dict[tuple[str, str], list[dict[str, Any]]]
"""Results of all seeds, by fit and training time."""


def sheets_of(name: str, table: dict[str, Any], cells: Sequence[Cell]) -> list[Sheet]:
    """Return the errors, a row per recipe, training time and test, and any results on occlusion and calibration.

    Figures are means over the stored seeds, with minimum and maximum. The ratio column divides the table's ``ratio``
    protocol by that of the fit's reference.
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
    """Return the row of a fit and those of its additional tests."""
    (name, spent), results = key, found[key]
    fit = next(cell.fit for cell in cells if cell.fit.name == name)
    against = found.get((fit.reference or "", spent)) or found.get((fit.reference or "", "-")) or []
    reference = _average([r["overall"].get(protocol) for r in against])
    overalls = {name: [r["overall"] for r in results]}
    for test in fit.tests:
        overalls[f"{name}, on {test}"] = [r["tests"][test] for r in results if test in r.get("tests", {})]
    rows = []
    for label, overall in overalls.items():
        mine = _average([o.get(protocol) for o in overall])
        ratio = "-" if not reference or mine is None else f"{mine / reference:.3f}"
        figures = [mean_and_range([o.get(name) for o in overall]) for name in shown]
        rows.append([label, spent, str(len(overall)), *figures, ratio])
    return rows


def _occlusion(name: str, found: Results) -> Sheet:
    head = ["recipe", "trained", "hidden", *(f"{error} {column}" for error in _OCCLUSION for column in _ENDINGS)]
    rows = []
    for (fit, spent), results in found.items():
        tables = [r["occlusion"] for r in results if "occlusion" in r]
        for hidden in dict.fromkeys(key for table in tables for key in table):
            values = [
                mean_and_range([table.get(hidden, {}).get(f"{error}{ending}") for table in tables])
                for error in _OCCLUSION
                for ending in _ENDINGS.values()
            ]
            rows.append([fit, spent, hidden, *values])
    return Sheet(f"{name}: visible joints and hidden joints", head, rows)


def _calibration(name: str, found: Results) -> Sheet:
    rows, shares = [], {}
    for (fit, spent), results in found.items():
        curves = [r["calibration"] for r in results if r.get("calibration")]
        for group, ending in (("visible", ""), ("missing", "_missing")):
            some = [curve for curve in curves if group in curve]
            if some:
                shares = some[0][group]
                values = [mean_and_range([curve[group][share] for curve in some]) for share in shares]
                values += [
                    mean_and_range([c.get(f"{of}{ending}") for c in some])
                    for of in ("uncertainty_error", "rank_correlation")
                ]
                rows.append([fit, spent, group, *values])
    head = ["recipe", "trained", "joints", *shares, "uncertainty_error", "rank_correlation"]
    return Sheet(f"{name}: fraction of depth errors inside the interval of", head, rows)


def _average(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
