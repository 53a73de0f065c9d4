"""What an evaluation of lifted shapes found, as plain data, as CSV, as a table for the terminal."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uplift.evaluation.shape_metrics import metric_kind, metric_meaning, metric_order, metric_unit

__all__ = ["ShapeEvaluation"]

_MAX_ROWS = 20


@dataclass(frozen=True)
class ShapeEvaluation:
    """The metrics of lifted shapes against the truth; lengths in the truth's longest side, shares from 0 to 1."""

    data: str
    overall: dict[str, float]
    per_category: dict[str, dict[str, float]]
    items: int
    per_item: dict[str, np.ndarray] = field(default_factory=dict)
    """(items,) each, NaN where a metric does not apply to an item."""
    names: list[str] = field(default_factory=list)
    """Of the items."""
    category_items: dict[str, int] = field(default_factory=dict)
    floors: dict[str, dict[str, float]] = field(default_factory=dict)
    """The overall figures of each floor."""
    notes: list[str] = field(default_factory=list)

    unit = "longest side"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for evaluation.json; metrics that do not apply are absent."""
        return {
            "data": self.data,
            "unit": self.unit,
            "items": self.items,
            "overall": self.overall,
            "per_category": self.per_category,
            **({"floors": self.floors} if self.floors else {}),
            "notes": self.notes,
        }

    def write_csv(self, path: str | Path) -> None:
        """Write one figure a row: group (overall, category, floor, item), name, protocol, value, unit."""
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["group", "name", "protocol", "value", "unit"])
            for group, name, metric, value in self._figures():
                writer.writerow([group, name, metric, repr(value), metric_unit(metric)])

    def _figures(self) -> Iterator[tuple[str, str, str, float]]:
        yield from (("overall", "", metric, value) for metric, value in self.overall.items())
        for group, members in (("category", self.per_category), ("floor", self.floors)):
            for name, values in members.items():
                yield from ((group, name, metric, value) for metric, value in values.items())
        for metric, values in self.per_item.items():
            for name, value in zip(self.names, values.tolist(), strict=True):
                if math.isfinite(value):
                    yield "item", name, metric, value

    def table(self) -> str:
        """Return all of it as aligned plain text for the terminal."""
        notes = "\n".join(f"- {note}" for note in self.notes)
        head = f"{self.data or 'evaluation'}: {self.items:,} shapes"
        parts = [head, self._overall_table(), self._category_table(), notes]
        return "\n\n".join(part for part in parts if part)

    def _overall_table(self) -> str:
        """Return a row a metric, and a column a floor."""
        shown = sorted((name for name in self.overall if name in _known(self)), key=metric_order)
        rows = [["metric", "value", *self.floors, "unit", "meaning"]]
        for name in shown:
            floors = [_figure(name, values.get(name)) for values in self.floors.values()]
            rows.append([name, _figure(name, self.overall[name]), *floors, metric_unit(name), metric_meaning(name)])
        return _columns(rows, left=(0, len(rows[0]) - 2, len(rows[0]) - 1))

    def _category_table(self) -> str:
        if not self.per_category:
            return ""
        largest = sorted(self.per_category, key=lambda name: -self.category_items.get(name, 0))[:_MAX_ROWS]
        names = [name for name in self.overall if name in _known(self)]
        rows = [["per category", "shapes", *names]]
        for category in sorted(largest):
            cells = [_figure(name, self.per_category[category].get(name)) for name in names]
            rows.append([category, f"{self.category_items.get(category, 0):,}", *cells])
        more = len(self.per_category) - len(largest)
        return _columns(rows) + (f"\n({more} more, with fewer shapes: in the JSON and CSV files)" if more else "")


def _known(result: ShapeEvaluation) -> list[str]:
    """Return the metrics of the run itself: not the best floors', which have columns."""
    return [name for name in result.overall if not (result.floors and name.startswith("best_floor_"))]


def _figure(name: str, value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if metric_kind(name) == "deg" else f"{value:.3f}"


def _columns(rows: list[list[str]], left: tuple[int, ...] = (0,)) -> str:
    widths = [max(len(row[place]) for row in rows) for place in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = (c.ljust(w) if i in left else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
