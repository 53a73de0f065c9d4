"""The tables: fits compared with baselines, every baseline, categories, the cost of resolution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.common import Sheet, mean_and_range
from benchmarks.shapes.fits import Cell, ceiling_key

__all__ = ["ceiling_sheets", "cost_sheet", "sheets_of"]

_BESIDE = ("silhouette_iou_unseen", "f_score", "volume_iou")
_ALONE = (
    "chamfer", "volume_iou_aligned", "silhouette_iou_seen", "normal_consistency", "handedness", "views_within_20", "train_views_within_20",
    "azimuth_deg",
)  # fmt: skip
_LEADING = ("silhouette_iou_unseen", "f_score", "chamfer", "volume_iou", "volume_iou_aligned")
_OF_FLOORS = (*_LEADING, "silhouette_iou_seen", "handedness")
_OF_CATEGORIES = (*_LEADING, "handedness")
_SHARED = ("silhouette_iou_unseen", "f_score", "volume_iou", "volume_iou_aligned")

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
        pairs = [(one["overall"].get(metric), _best_floor(one, metric)) for one in found]
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


def _best_floor(result: Mapping[str, Any], metric: str) -> float | None:
    """Return the highest figure of the baselines."""
    return max((of[metric] for of in result.get("floors", {}).values() if metric in of), default=None)


def ceiling_sheets(results: Results, families: Sequence[str], seconds: float) -> list[Sheet]:
    """Return the supervised network beside the best baseline and the fits from masks alone, and the share that these reach.

    Means over the stored seeds of each; the share is that of the means.
    """
    rows = []
    for family in families:
        above = _seeds_of(results, ceiling_key(family, seconds, 0))
        fits = _seeds_of(results, f"family_{family}_seed0") or _seeds_of(
            results, "demo_seed0" if family == "chairs" else ""
        )
        floors = [{m: _best_floor(one, m) for m in _SHARED} for one in above]
        means = {
            "supervised": _means([one["overall"] for one in above]),
            "masks alone": _means([one["overall"] for one in fits]),
            "best floor": _means(floors),
        }
        counts = {"supervised": len(above), "masks alone": len(fits), "best floor": len(above)}
        rows += [
            [family, name, f"{counts[name]}", *(f"{of[m]:.3f}" if m in of else "-" for m in _SHARED)]
            for name, of in means.items()
            if of
        ]
        if above and fits:
            top, mine = means["supervised"], means["masks alone"]
            shares = (f"{mine[m] / top[m]:.2f}" if top.get(m) and m in mine else "-" for m in _SHARED)
            rows.append([family, "share reached", "", *shares])
    head = ["family", "trained on", "seeds", *_SHARED]
    return [Sheet(f"ceiling: a supervised network, {seconds:g} s of one CPU thread", head, rows)] if rows else []


def _seeds_of(results: Results, key: str) -> list[Mapping[str, Any]]:
    start = key.removesuffix("0")
    return [
        one for name, one in results.items() if key and name.startswith(start) and name.removeprefix(start).isdigit()
    ]


def _means(figures: Sequence[Mapping[str, float | None]]) -> dict[str, float]:
    known = {metric: [of[metric] for of in figures if of.get(metric) is not None] for metric in _SHARED}
    return {metric: float(np.mean(np.array(values, float))) for metric, values in known.items() if values}


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
            f"{one['resolution']}", f"{one['pixels']}", f"{one['batch']}", f"{one['threads']}", f"{one['seconds_per_step']:.3f}",
            f"{one['peak_gb']:.2f}", f"{one['peak_before_gb']:.2f}",
        ]
        for one in found
    ]  # fmt: skip
    head = ["resolution", "pixels", "batch", "threads", "s per step", "peak GB", "GB before training"]
    return [Sheet("cost of a training step", head, rows)] if rows else []
