"""The results of a table: errors, and what else was measured of its fits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from benchmarks.accuracy.cells import Cell
from benchmarks.common import Sheet, mean_and_range

__all__ = ["SHOWN", "sheets_of"]

SHOWN = ("p_mpjpe", "mpjpe_gt_scale", "n_mpjpe", "facing", "elevation_deg")
"""The protocols with a column."""
_WITH_ROLL = ("wrong_signs", "elevation_deg_clip", "roll_deg", "roll_deg_clip")
"""Those that have one where the truth says how cameras roll."""

_OCCLUSION = ("p_mpjpe", "n_mpjpe")
_ENDINGS = {"complete": "_complete", "hidden": "", "growth": "_growth", "missing": "_missing"}


Results = dict[tuple[str, str], list[dict[str, Any]]]
"""Results of all seeds, by fit and training time."""


def sheets_of(name: str, table: dict[str, Any], cells: Sequence[Cell]) -> list[Sheet]:
    """Return the errors, a row per recipe, training time and test, and whatever else was measured.

    Figures are means over the stored seeds, with minimum and maximum. The ratio column divides the table's ``ratio``
    protocol by that of the fit's reference, on the same test where it has that.
    """
    found: Results = {}
    for cell in cells:
        result = cell.result()
        found.setdefault((cell.fit.name, cell.spent), []).extend([result] if result else [])
    protocol = table.get("ratio", "p_mpjpe")
    shown = SHOWN if protocol in SHOWN else (protocol, *SHOWN)
    if any("roll_deg" in overall for results in found.values() for r in results for overall in _overalls(r).values()):
        shown = (*shown, *_WITH_ROLL)
    rows = [row for key in found for row in _error_rows(key, found, cells, protocol, shown)]
    head = ["recipe", "trained", "seeds", *shown]
    if any(cell.fit.reference for cell in cells):
        head.append(f"{protocol} ratio")
    sheets = [Sheet(name, head, [row[: len(head)] for row in rows])]
    sheets += [
        make(name, found) for make in (_occlusion, _calibration, _trunk, _signs, _mended, _hypotheses, _weights, _video)
    ]
    return [sheet for sheet in sheets if sheet.rows]


def _error_rows(
    key: tuple[str, str], found: Results, cells: Sequence[Cell], protocol: str, shown: Sequence[str]
) -> list[list[str]]:
    """Return the row of a fit and those of its additional tests."""
    (name, spent), results = key, found[key]
    fit = next(cell.fit for cell in cells if cell.fit.name == name)
    against = found.get((fit.reference or "", spent)) or found.get((fit.reference or "", "-")) or []
    rows = []
    for test in ("", *fit.tests):
        overall = [_overalls(r)[test] for r in results if test in _overalls(r)]
        label = f"{name}, on {test}" if test else name
        same = test if name != fit.reference else ""  # the reference itself shows what its tests differ by
        theirs = [_overalls(r).get(same, r["overall"]) for r in against]
        reference = _average([of.get(protocol) for of in theirs])
        mine = _average([o.get(protocol) for o in overall])
        ratio = "-" if not reference or mine is None else f"{mine / reference:.3f}"
        figures = [mean_and_range([o.get(name) for o in overall]) for name in shown]
        rows.append([label, spent, str(len(overall)), *figures, ratio])
    return rows


def _overalls(result: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return the overall figures of each test of a result; "" is the cell's own."""
    return {"": result["overall"], **result.get("tests", {})}


def _sections(found: Results, key: str) -> Iterator[tuple[list[str], list[dict[str, Any]]]]:
    """Yield the recipe (with its test) and training time of what has a section of evaluation.json, and those of all seeds."""
    for (fit, spent), results in found.items():
        tests = {"": [r for r in results if r.get(key)]}
        for test in dict.fromkeys(test for r in results for test in r.get("sections", {})):
            tests[test] = [r["sections"][test] for r in results if r.get("sections", {}).get(test, {}).get(key)]
        for test, some in tests.items():
            if some:
                yield [f"{fit}, on {test}" if test else fit, spent], [one[key] for one in some]


def _trunk(name: str, found: Results) -> Sheet:
    figures = {"frames": ".0f", "share": ".3f", "p_mpjpe": ".1f", "flipped": ".3f", "wrong_signs": ".3f"}
    rows = []
    for label, tables in _sections(found, "by_trunk_angle"):
        for angle in dict.fromkeys(angle for table in tables for angle in table):
            some = [table[angle] for table in tables if angle in table]
            shown = [mean_and_range([of.get(figure) for of in some], form) for figure, form in figures.items()]
            rows.append([*label, angle, *shown])
    return Sheet(f"{name}: by the trunk's angle from upright", ["recipe", "trained", "degrees", *figures], rows)


def _signs(name: str, found: Results) -> Sheet:
    rows = []
    for label, tables in _sections(found, "signs"):
        for bone in dict.fromkeys(bone for table in tables for bone in table):
            some = [table[bone] for table in tables if bone in table]
            shown = [
                mean_and_range([of[figure] for of in some], form)
                for figure, form in (("frames", ".0f"), ("wrong", ".3f"))
            ]
            rows.append([*label, bone, *shown])
    return Sheet(f"{name}: depth signs", ["recipe", "trained", "bone", "frames", "wrong"], rows)


def _mended(name: str, found: Results) -> Sheet:
    rows, head = [], []
    for (fit, spent), results in found.items():
        some = [r["mended"] for r in results if "mended" in r]
        if some:
            head = list(some[0])
            rows.append([fit, spent, *(mean_and_range([of[figure] for of in some], ".0f") for figure in head)])
    return Sheet(f"{name}: clips against single frames", ["recipe", "trained", *head], rows)


def _hypotheses(name: str, found: Results) -> Sheet:
    figures = {"count": ".0f", "likeliest": ".1f", "expected": ".1f", "best_of": ".1f", "weight_error": ".3f"}
    rows = [
        [*label, *(mean_and_range([of[figure] for of in some], form) for figure, form in figures.items())]
        for label, some in _sections(found, "hypotheses")
    ]
    return Sheet(f"{name}: hypotheses, p_mpjpe", ["recipe", "trained", *figures], rows)


def _weights(name: str, found: Results) -> Sheet:
    rows = []
    for label, tables in _sections(found, "hypotheses"):
        for said in sorted({said for table in tables for said in table["calibration"]}):
            some = [table["calibration"][said] for table in tables if said in table["calibration"]]
            shown = [mean_and_range([of["hypotheses"] for of in some], ".0f")]
            shown += [mean_and_range([of[figure] for of in some]) for figure in ("said", "found")]
            rows.append([*label, said, *shown])
    head = ["recipe", "trained", "weight", "hypotheses", "said", "best of its frame"]
    return Sheet(f"{name}: weights of hypotheses", head, rows)


def _video(name: str, found: Results) -> Sheet:
    forms = {
        "frames": ".0f",
        "p_mpjpe": ".1f",
        "facing": ".2f",
        "flat": ".1f",
        "mediapipe": ".1f",
        "tilt_deg": ".1f",
        "roll_deg": ".1f",
    }
    rows = []
    for (fit, spent), results in found.items():
        some = [r["video"] for r in results if "video" in r]
        for detector, cameras in (some[0] if some else {}).items():
            for camera in cameras:
                of = [table[detector][camera] for table in some]
                shown = [mean_and_range([one.get(figure) for one in of], form) for figure, form in forms.items()]
                rows.append([fit, spent, detector, camera, *shown])
    return Sheet(f"{name}: the real video, 13 joints", ["recipe", "trained", "2D", "camera", *forms], rows)


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
