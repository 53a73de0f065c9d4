"""What an evaluation found, as plain data, as CSV, as a table for the terminal."""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uplift.metrics.protocols import (
    ACTION_MEAN,
    MISSING,
    metric_kind,
    metric_meaning,
    metric_order,
    metric_unit,
    protocol_kind,
    protocol_meaning,
    protocol_unit,
)

__all__ = ["Evaluation", "ShapeEvaluation", "paper_order"]

# The actions in the order and by the names that papers have in their tables.

_H36M_COLUMNS = {
    "Direct.": ("directions", "direction"),
    "Discuss": ("discussion", "discuss"),
    "Eating": ("eating",),
    "Greet": ("greeting", "greet"),
    "Phone": ("phoning", "phone"),
    "Photo": ("photo", "takingphoto"),
    "Pose": ("posing", "pose"),
    "Purch.": ("purchases", "purchase"),
    "Sitting": ("sitting",),
    "SittingD": ("sittingdown", "sittingd"),
    "Smoke": ("smoking", "smoke"),
    "Wait": ("waiting", "wait"),
    "WalkD": ("walkdog", "walkingdog", "walkd"),
    "Walk": ("walking", "walk"),
    "WalkT": ("walktogether", "walkingtogether", "walkt"),
}
_ACTIVITY_COLUMNS = {
    "Stand/Walk": ("standingwalking",),
    "Exercise": ("exercising",),
    "Sit": ("sitting",),
    "Reach/Crouch": ("reachingcrouching",),
    "Floor": ("onthefloor",),
    "Sports": ("sports",),
    "Misc": ("miscellaneous",),
}
"""Of MPI-INF-3DHP's test set, in its order."""
_PAPERS = (_H36M_COLUMNS, _ACTIVITY_COLUMNS)


def paper_order(actions: list[str]) -> dict[str, str] | None:
    """Return a paper's column -> our action, in its order; None where an action is in none of the papers."""
    plain = {"".join(letter for letter in action.casefold() if letter.isalpha()): action for action in actions}
    for columns in _PAPERS:
        found = {column: plain[name] for column, known in columns.items() for name in known if name in plain}
        if len(found) == len(actions) and len(plain) == len(actions):
            return found
    return None


def _are_activities(columns: Collection[str]) -> bool:
    """Return whether the columns are those of MPI-INF-3DHP, which reports all frames beside the actions."""
    return set(columns) <= set(_ACTIVITY_COLUMNS)


# What an evaluation found, and how it is told: as plain data, as CSV, as a table for the terminal.

_HEADLINE = ("mpjpe", "mpjpe_gt_scale", "n_mpjpe", "p_mpjpe", "pck@150", "facing")
_ACTIVITY_HEADLINE = (*_HEADLINE[:-1], "auc", "pck14@150", "auc14", "facing")
_MAX_ROWS = 20


@dataclass(frozen=True)
class Evaluation:
    """The protocols of one prediction against one truth; lengths in ``unit``, shares from 0 to 1."""

    data: str
    overall: dict[str, float]
    per_action: dict[str, dict[str, float]]
    per_joint: dict[str, dict[str, float]]
    per_subject: dict[str, dict[str, float]]
    unit: str
    frames: int
    action_frames: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    calibration: dict[str, Any] | None = None
    """What `calibrate` found; None for a prediction without a spread."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for evaluation.json; protocols that do not apply are absent."""
        return {
            "data": self.data,
            "unit": self.unit,
            "frames": self.frames,
            "overall": self.overall,
            "per_action": self.per_action,
            "per_joint": self.per_joint,
            "per_subject": self.per_subject,
            **({"calibration": self.calibration} if self.calibration else {}),
            "notes": self.notes,
        }

    def write_csv(self, path: str | Path) -> None:
        """Write one figure a row: group (overall, action, subject, joint, calibration), name, protocol, value, unit."""
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["group", "name", "protocol", "value", "unit"])
            for group, name, protocol, value in self._figures():
                writer.writerow([group, name, protocol, repr(value), protocol_unit(protocol, self.unit)])
            for name, found in (self.calibration or {}).items():
                for protocol, value in found.items() if isinstance(found, dict) else [(name, found)]:
                    of = name if isinstance(found, dict) else ""
                    writer.writerow(["calibration", of, protocol, repr(value), ""])

    def _figures(self) -> Iterator[tuple[str, str, str, float]]:
        parts = {"action": self.per_action, "subject": self.per_subject, "joint": self.per_joint}
        yield from (("overall", "", protocol, value) for protocol, value in self.overall.items())
        for group, members in parts.items():
            for name, values in members.items():
                yield from ((group, name, protocol, value) for protocol, value in values.items())

    def table(self) -> str:
        """Return all of it as aligned plain text for the terminal."""
        parts = [f"{self.data or 'evaluation'}: {self.frames:,} frames", self._overall_table()]
        if self.per_action:
            parts.append(self._action_table())
        parts += [self._joint_table(), self._calibration_table(), "\n".join(f"- {note}" for note in self.notes)]
        return "\n\n".join(part for part in parts if part)

    def _overall_table(self) -> str:
        means = any(name.endswith(ACTION_MEAN) for name in self.overall)
        head = ["protocol", "value", *(["mean of actions"] if means else []), "unit", "meaning"]
        rows = []
        for name in (name for name in self.overall if not name.endswith(ACTION_MEAN)):
            of_actions = self.overall.get(name + ACTION_MEAN)
            mean = ["" if of_actions is None else _figure(name, of_actions)] if means else []
            figures = [_figure(name, self.overall[name]), *mean]
            rows.append([name, *figures, protocol_unit(name, self.unit), protocol_meaning(name)])
        return _columns([head, *rows], left=(0, len(head) - 2, len(head) - 1))

    def _action_table(self) -> str:
        paper = paper_order(list(self.per_action))
        activities = paper is not None and _are_activities(paper)
        shown = _ACTIVITY_HEADLINE if activities else _HEADLINE
        names = [name for name in shown if any(name in values for values in self.per_action.values())]
        if paper:
            return self._paper_table(paper, names, activities)
        shown = list(self.per_action)
        if len(shown) > _MAX_ROWS:
            largest = sorted(shown, key=lambda action: -self.action_frames.get(action, 0))[:_MAX_ROWS]
            shown = sorted(largest)
        head = ["per action", "frames", *names]
        counts = {action: f"{self.action_frames.get(action, 0):,}" for action in shown}
        rows = [[_short(action), counts[action], *(self._cell(action, name) for name in names)] for action in shown]
        rows.append(["mean of all actions", f"{self.frames:,}", *(self._mean(name) for name in names)])
        more = len(self.per_action) - len(shown)
        rest = f"\n({more} more actions, with fewer frames: in the JSON and CSV files)" if more else ""
        return _columns([head, *rows]) + rest

    def _paper_table(self, paper: dict[str, str], names: list[str], activities: bool) -> str:
        """Return a column for each action and their mean; of activities also all frames, as MPI-INF-3DHP reports."""
        rows = [["per action", *paper, "Avg", *(["All"] if activities else [])]]
        for name in names:
            cells = [self._cell(action, name) for action in paper.values()]
            rows.append([name, *cells, self._mean(name), *([_figure(name, self.overall[name])] if activities else [])])
        if activities:
            rows.append(
                ["frames", *(f"{self.action_frames.get(a, 0):,}" for a in paper.values()), "", f"{self.frames:,}"]
            )
        return _columns(rows)

    def _cell(self, action: str, name: str) -> str:
        values = self.per_action[action]
        return _figure(name, values[name]) if name in values else "-"

    def _mean(self, name: str) -> str:
        values = [of[name] for of in self.per_action.values() if name in of]
        return _figure(name, sum(values) / len(values))

    def _joint_table(self) -> str:
        names = [name for name in _HEADLINE if any(name in values for values in self.per_joint.values())]
        rows = [
            [joint, *(_figure(name, values[name]) if name in values else "-" for name in names)]
            for joint, values in self.per_joint.items()
        ]
        return _columns([["per joint", *names], *rows])

    def _calibration_table(self) -> str:
        """Return the shares of depth errors inside the intervals that the spread gives; nothing without one."""
        found = self.calibration or {}
        groups = [(name, ending) for name, ending in (("visible", ""), ("missing", MISSING)) if name in found]
        if not groups:
            return ""
        rows = []
        for name, ending in groups:
            others = [found.get(f"{figure}{ending}") for figure in ("spread_error", "rank_correlation")]
            shown = [*found[name].values(), *others]
            rows.append([f"joints {name}", *("-" if value is None else f"{value:.3f}" for value in shown)])
        head = ["depth errors inside the interval of", *found[groups[0][0]], "spread_error", "rank_correlation"]
        return _columns([head, *rows])


def _figure(name: str, value: float) -> str:
    return f"{value:.3f}" if protocol_kind(name) == "share" else f"{value:.1f}"


def _short(text: str, limit: int = 32) -> str:
    return text if len(text) <= limit else text[: limit - 1] + "…"


def _columns(rows: list[list[str]], left: tuple[int, ...] = (0,)) -> str:
    """Return rows as aligned text: the ``left`` columns to the left, the others to the right."""
    widths = [max(len(row[place]) for row in rows) for place in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = (c.ljust(w) if i in left else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


# What an evaluation of lifted shapes found, as plain data, as CSV, as a table for the terminal.


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
            floors = [_shape_figure(name, values.get(name)) for values in self.floors.values()]
            rows.append(
                [name, _shape_figure(name, self.overall[name]), *floors, metric_unit(name), metric_meaning(name)]
            )
        return _shape_columns(rows, left=(0, len(rows[0]) - 2, len(rows[0]) - 1))

    def _category_table(self) -> str:
        if not self.per_category:
            return ""
        largest = sorted(self.per_category, key=lambda name: -self.category_items.get(name, 0))[:_MAX_ROWS]
        names = [name for name in self.overall if name in _known(self)]
        rows = [["per category", "shapes", *names]]
        for category in sorted(largest):
            cells = [_shape_figure(name, self.per_category[category].get(name)) for name in names]
            rows.append([category, f"{self.category_items.get(category, 0):,}", *cells])
        more = len(self.per_category) - len(largest)
        return _shape_columns(rows) + (f"\n({more} more, with fewer shapes: in the JSON and CSV files)" if more else "")


def _known(result: ShapeEvaluation) -> list[str]:
    """Return the metrics of the run itself: not the best floors', which have columns."""
    return [name for name in result.overall if not (result.floors and name.startswith("best_floor_"))]


def _shape_figure(name: str, value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if metric_kind(name) == "deg" else f"{value:.3f}"


def _shape_columns(rows: list[list[str]], left: tuple[int, ...] = (0,)) -> str:
    widths = [max(len(row[place]) for row in rows) for place in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = (c.ljust(w) if i in left else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
