"""The tables: fits compared with baselines, every baseline, categories, the cost of resolution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.common import Sheet, mean_and_range
from benchmarks.shapes.fits import Cell

__all__ = ["cost_sheet", "sheets_of"]

_BESIDE = ("volume_iou", "silhouette_iou_unseen")
_ALONE = ("silhouette_iou_seen", "chamfer", "f_score", "normal_consistency", "handedness", "azimuth_deg")
_OF_FLOORS = ("volume_iou", "silhouette_iou_seen", "silhouette_iou_unseen", "chamfer", "f_score", "handedness")
_OF_CATEGORIES = ("volume_iou", "silhouette_iou_unseen", "chamfer", "f_score", "handedness")

Results = Mapping[str, Mapping[str, Any]]


def sheets_of(cells: Sequence[Cell], results: Results) -> list[Sheet]:
    """Return the tables of the stored fits: means over seeds, with minimum and maximum."""
    rows: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for cell in cells:
        if cell.key in results:
            rows.setdefault((cell.name, cell.spent), []).append(results[cell.key])
    beside = [f"{metric}{column}" for metric in _BESIDE for column in ("", " best floor", " gain")]
    sheets = [
        Sheet("fits", ["fit", "trained", "seeds", *beside, *_ALONE], [_fit_row(*item) for item in rows.items()]),
        Sheet("floors", ["fit", "floor", *_OF_FLOORS], _group_rows(rows, "floors", _OF_FLOORS)),
        Sheet("categories", ["fit", "category", *_OF_CATEGORIES], _group_rows(rows, "per_category", _OF_CATEGORIES)),
    ]
    return [sheet for sheet in sheets if sheet.rows]


def _fit_row(name: tuple[str, str], found: list[Mapping[str, Any]]) -> list[str]:
    overalls = [one["overall"] for one in found]
    cells = []
    for metric in _BESIDE:
        pairs = [(one.get(metric), one.get(f"best_floor_{metric}")) for one in overalls]
        gains = [mine - floor for mine, floor in pairs if mine is not None and floor is not None]
        cells += [
            mean_and_range([mine for mine, _ in pairs]),
            mean_and_range([floor for _, floor in pairs]),
            mean_and_range(gains, "+.3f"),
        ]
    return [
        *name,
        str(len(found)),
        *cells,
        *(mean_and_range([one.get(metric) for one in overalls]) for metric in _ALONE),
    ]


def _group_rows(
    rows: Mapping[tuple[str, str], list[Mapping[str, Any]]], part: str, metrics: Sequence[str]
) -> list[list[str]]:
    """Return a row per baseline or category; fits of a single category have none."""
    found = []
    for (name, spent), results in rows.items():
        groups = dict.fromkeys(group for one in results for group in one.get(part, {}))
        if part == "per_category" and len(groups) < 2:
            continue
        label = name if spent == "task's" else f"{name} {spent}"
        for group in groups:
            values = [one[part][group] for one in results if group in one.get(part, {})]
            found.append(
                [label, group, *(mean_and_range([value.get(metric) for value in values]) for metric in metrics)]
            )
    return found


def cost_sheet(results: Results) -> list[Sheet]:
    """Return the cost of a step at each measured resolution."""
    found = sorted(
        (one for key, one in results.items() if key.startswith("cost_")),
        key=lambda one: (one["threads"], one["resolution"]),
    )
    rows = [
        [
            f"{one['resolution']}", f"{one['shapes']}", f"{one['threads']}", f"{one['seconds_per_step']:.3f}",
            f"{one['peak_gb']:.2f}", f"{one['peak_before_gb']:.2f}",
        ]
        for one in found
    ]  # fmt: skip
    head = ["resolution", "shapes", "threads", "s per step", "peak GB", "GB before training"]
    return [Sheet("cost of a training step", head, rows)] if rows else []
