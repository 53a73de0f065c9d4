"""The tables in the paper's layout, with published rows and ours."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.common import Sheet
from benchmarks.paper_tables.fits import TABLES
from benchmarks.paper_tables.published import COLUMNS, KUDO_3DHP, MEHTA_3DHP, PUBLISHED, Published
from uplift.metrics.report import paper_order

__all__ = ["notes_of", "sheets_of"]

_PROTOCOL = "mpjpe_gt_scale"
_MORE = ("n_mpjpe", "p_mpjpe", "facing")
_SHARES = ("pck@150", "auc", "pck14@150", "auc14")
_ACTIVITIES = ("Stand/Walk", "Exercise", "Sit", "Reach/Crouch", "Floor", "Sports", "Misc")
_COMMON = (
    "ours: 'uses' is the training signal ('lenses': the cameras' intrinsics, which Kudo et al. did not use); "
    "'of seeds' is the lowest and highest average; steps, epochs or minutes are the budget of the fit.",
)
_NOTES = {
    "h36m": (
        "mm, mean over the joints, the cameras and the frames of an action; Avg is the mean of the 15 actions.",
        "Ours and Kudo et al.: mpjpe_gt_scale, each pose scaled to the true size on the image plane, without any other "
        "alignment. The other published rows predict the size (learned from 3D): compare them with 'mpjpe'.",
        "Test S9, S11; training S1, S5, S6, S7, S8; 17 joints. Ours at 10 frames/s, as in the authors' code; most others 50.",
        *_COMMON,
    ),
    "mpi_inf_3dhp": (
        "percent of joints within 150 mm (pck), and its mean over 0 to 150 mm (auc); ours at the truth's scale.",
        f"The {KUDO_3DHP} of Kudo et al. measures the error in z alone, on the training data: compare it only with the "
        "column 'pck_z, training', not with any PCK. The figures to compare with are those of the test set.",
        "pck14, auc14: over the 14 joints of the test set's evaluation script, all frames weighted equally (overall).",
        *_COMMON,
    ),
}


def notes_of(table: str) -> tuple[str, ...]:
    """Return the notes on a table."""
    return _NOTES[TABLES[table].use]


def sheets_of(table: str, results: Sequence[Mapping[str, Any]]) -> list[Sheet]:
    """Return the sheets of a table for stored results; results that differ only in the seed share a row."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for result in sorted(results, key=lambda r: (r["task"], r["file"], r["seed"])):
        groups.setdefault(result["file"].rpartition("_seed")[0], []).append(result)
    rows = list(groups.values())
    if table == "3dhp":
        return [sheet for sheet in _activities(rows) if sheet.rows]
    return [_paper(table, rows), *([_protocols(table, rows)] if rows else [])]


def _paper(table: str, groups: Sequence[Sequence[Mapping[str, Any]]]) -> Sheet:
    head = ["Method", "2D", "uses", "seeds", *COLUMNS, "Avg", "of seeds"]
    published = {
        "w/ 3D dataset": [_published(row) for row in PUBLISHED[table] if row.uses == "3D"],
        "w/o 3D dataset": [_published(row) for row in PUBLISHED[table] if row.uses != "3D"],
    }
    for group in groups:
        section = "w/ 3D dataset" if "3D" in group[0]["uses"] else "w/o 3D dataset"
        published[section].append(_ours(group))
    rows = []
    for section, members in published.items():
        rows += [[section, *[""] * (len(head) - 1)], *members]
    return Sheet(f"{TABLES[table].title}: {_PROTOCOL}, mm", head, rows)


def _published(row: Published) -> list[str]:
    cells = ["-" if error is None else f"{error:.1f}" for error in row.errors]
    return [f"  {row.method}", row.sees, row.uses, "-", *cells, f"{row.average:.1f}", ""]


def _ours(group: Sequence[Mapping[str, Any]]) -> list[str]:
    first = group[0]
    cells = [_mean([_of_action(result, column) for result in group], "{:.1f}") for column in COLUMNS]
    averages = [result["overall"].get(f"{_PROTOCOL}_action_mean") for result in group]
    return [_name(first), _seen(first), first["uses"], _seeds(group), *cells,
            _mean(averages, "{:.1f}"), _range(averages)]  # fmt: skip


def _name(result: Mapping[str, Any]) -> str:
    rate = result.get("fps")
    return f"  {result['task'] or 'own'}, {result['budget']}" + (f", {rate} fps" if rate not in (None, 10) else "")


def _seen(result: Mapping[str, Any]) -> str:
    """Return which keypoints the test frames had, according to the data set."""
    found = re.search(r"keypoints (\w+)", result["data"])
    return {"gt": "GT", "projected": "GT", "sh": "SH"}.get(found[1], found[1]) if found else "?"


def _seeds(group: Sequence[Mapping[str, Any]]) -> str:
    return ",".join(str(result["seed"]) for result in group)


def _of_action(result: Mapping[str, Any], column: str, protocol: str = _PROTOCOL) -> float | None:
    columns = paper_order(list(result["per_action"])) or {}
    return result["per_action"].get(columns.get(column, ""), {}).get(protocol)


def _protocols(table: str, groups: Sequence[Sequence[Mapping[str, Any]]]) -> Sheet:
    """Return our averages by other protocols, and over all frames."""
    head = ["ours", "uses", "seeds", _PROTOCOL, "over frames", *_MORE]
    rows = []
    for group in groups:
        overall = [result["overall"] for result in group]
        means = [[of.get(f"{name}_action_mean", of.get(name)) for of in overall] for name in (_PROTOCOL, *_MORE)]
        frames = _mean([of.get(_PROTOCOL) for of in overall], "{:.1f}")
        shown = [_mean(values, "{:.3f}" if name == "facing" else "{:.1f}") for name, values in zip(_MORE, means[1:], strict=True)]  # fmt: skip
        rows.append(
            [_name(group[0]).strip(), group[0]["uses"], _seeds(group), _mean(means[0], "{:.1f}"), frames, *shown]
        )
    return Sheet(f"{TABLES[table].title}: ours by other protocols (mean of action means)", head, rows)


def _activities(groups: Sequence[Sequence[Mapping[str, Any]]]) -> list[Sheet]:
    head = ["Method", "uses", "seeds", "pck_z, training", "pck_z, test", *_SHARES, "of seeds"]
    rows = [
        ["Mehta et al. 2017, green screen, image", "3D", "-", "", "", f"{MEHTA_3DHP:.1f}", "", "", "", ""],
        ["Kudo et al. 2018, GT", "2D", "-", f"{KUDO_3DHP:.1f}", "", "", "", "", "", ""],
    ]
    detail = []
    for group in groups:
        first, overall = group[0], [result["overall"] for result in group]
        trained = [result.get("train", {}).get("overall", {}).get("pck_z@150") for result in group]
        shares = [_mean(_percent([of.get(name) for of in overall]), "{:.1f}") for name in ("pck_z@150", *_SHARES)]
        rows.append([_name({**first, "fps": None}).strip(), first["uses"], _seeds(group),
                     _mean(_percent(trained), "{:.1f}"), *shares, _range(_percent([of.get("pck@150") for of in overall]))])  # fmt: skip
        for protocol in ("pck@150", "auc"):
            cells = [_mean(_percent([_of_action(r, a, protocol) for r in group]), "{:.1f}") for a in _ACTIVITIES]
            detail.append([_name({**first, "fps": None}).strip(), protocol, *cells,
                           _mean(_percent([of.get(protocol) for of in overall]), "{:.1f}")])  # fmt: skip
    title = TABLES["3dhp"].title
    return [
        Sheet(f"{title}: at 150 mm, percent", head, rows),
        Sheet(f"{title}: test set by activity, percent", ["ours", "", *_ACTIVITIES, "All"], detail),
    ]


def _percent(values: Sequence[float | None]) -> list[float | None]:
    return [None if value is None else 100 * value for value in values]


def _mean(values: Sequence[float | None], shape: str) -> str:
    known = [value for value in values if value is not None]
    return shape.format(np.mean(known)) if known else "-"


def _range(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{min(known):.1f}-{max(known):.1f}" if len(known) > 1 else ""
