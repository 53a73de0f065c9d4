"""What an evaluation found, of poses or of shapes: as plain data, as CSV, as a table for the terminal."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from uplift.config.files import as_bytes, replacing, without_folders
from uplift.data.parsers.table import safe_cell
from uplift.metrics.protocols import (
    ACTION_MEAN,
    BEST_BASELINE,
    LONGEST_SIDE,
    MISSING,
    figure_text,
    is_error,
    metric_meaning,
    metric_order,
    metric_unit,
)

__all__ = ["AnyEvaluation", "Evaluation", "ShapeEvaluation", "Sheet", "paper_order"]

Figures = Mapping[str, int | float]
"""Metric -> value."""
Groups = Mapping[str, Figures]
"""Name of an action, joint, category, ... -> its figures."""

_KEYS = {"baselines": "floors"}
"""Field -> key of evaluation.json, where they differ."""
_OPTIONAL = ("calibration", "by_trunk_angle", "signs", "hypotheses", "floors")
"""Keys that are absent where there is nothing in them."""

_MAX_ROWS = 20
_HYPOTHESIS_ERRORS = ("likeliest", "expected", "best_of")
_HEADLINE = ("mpjpe", "mpjpe_gt_scale", "n_mpjpe", "p_mpjpe", "pck@150", "facing")
_ACTIVITY_HEADLINE = (*_HEADLINE[:-1], "auc", "pck14@150", "auc14", "facing")


class AnyEvaluation:
    """What evaluations of poses and of shapes share; the figures themselves are fields of the two classes below."""

    data: str
    """What the truth is called."""
    overall: dict[str, float]
    notes: list[str]
    unit: str
    """Of lengths."""
    title: ClassVar[str]
    """What a figure is called in the head of a table."""
    saved: ClassVar[tuple[str, ...]]
    """The fields in evaluation.json, in their order."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for evaluation.json; metrics that do not apply are absent, and files named without folders."""
        found = {_KEYS.get(name, name): getattr(self, name) for name in self.saved}
        found |= {"data": without_folders(self.data), "notes": [without_folders(note) for note in self.notes]}
        return {key: value for key, value in found.items() if value or key not in _OPTIONAL}

    def write_csv(self, path: str | Path) -> None:
        """Write one figure a row: group (overall, action, joint, category, ...), name, protocol, value, unit.

        Names that a spreadsheet would run as a formula begin with an apostrophe.
        """
        text = io.StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(["group", "name", "protocol", "value", "unit"])
        writer.writerows(["overall", "", *self._cells(name, value)] for name, value in self.overall.items())
        writer.writerows([group, safe_cell(name), *figure] for group, name, *figure in self._rows())
        with replacing(path) as file:
            file.write(as_bytes(text.getvalue()))

    def table(self) -> str:
        """Return all of it as aligned plain text for the terminal."""
        parts = [*self._tables(), "\n".join(f"- {note}" for note in self.notes)]
        return "\n\n".join(part for part in parts if part)

    def _rows(self) -> Iterator[list[str]]:
        raise NotImplementedError

    def _tables(self) -> list[str]:
        """Return the parts of `table`, empty where there is nothing to show."""
        raise NotImplementedError

    def _cells(self, name: str, value: float) -> tuple[str, str, str]:
        """Return name, value and unit of a figure in the CSV."""
        return name, repr(value), metric_unit(name, self.unit)

    def _rows_of(self, groups: Mapping[str, Groups]) -> Iterator[list[str]]:
        for group, members in groups.items():
            for name, values in members.items():
                yield from ([group, name, *self._cells(*figure)] for figure in values.items())

    def _text(self, name: str, values: Figures, absent: str = "-") -> str:
        return figure_text(name, values[name], self.unit) if name in values else absent

    def _overall_table(self, beside: Groups, absent: str) -> str:
        """Return a row for each metric, with the figures of ``beside`` in columns of their own."""
        rows = [[self.title, "value", *beside, "unit", "meaning"]]
        for name in self._shown():
            figures = [self._text(name, self.overall), *(self._text(name, of, absent) for of in beside.values())]
            rows.append([name, *figures, metric_unit(name, self.unit), metric_meaning(name)])
        return _columns(rows, left=(0, len(rows[0]) - 2, len(rows[0]) - 1))

    def _shown(self) -> list[str]:
        return sorted(self.overall, key=metric_order)

    def _group_rows(self, groups: Groups, names: Sequence[str], counts: Mapping[str, int]) -> list[list[str]]:
        largest = sorted(groups, key=lambda name: -counts.get(name, 0))[:_MAX_ROWS]
        return [
            [_short(group), f"{counts.get(group, 0):,}", *(self._text(name, groups[group]) for name in names)]
            for group in sorted(largest)
        ]


@dataclass(frozen=True)
class Evaluation(AnyEvaluation):
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
    """What `uplift.metrics.evaluate.evaluate` found of the uncertainty; None for a prediction without one."""
    by_trunk_angle: dict[str, dict[str, int | float]] = field(default_factory=dict)
    """Degrees from upright, such as 15-30 -> what `uplift.metrics.gravity_errors.by_trunk_angle` says of these frames."""
    signs: dict[str, dict[str, int | float]] = field(default_factory=dict)
    """Bone -> the share of its depth signs that are ``wrong``, and the number of ``frames`` in which it counts."""
    hypotheses: dict[str, Any] | None = None
    """What `uplift.metrics.hypotheses.evaluate_hypotheses` found; None for a prediction without any."""

    title = "protocol"
    saved = (
        "data", "unit", "frames", "overall", "per_action", "per_joint", "per_subject", "calibration", "by_trunk_angle",
        "signs", "hypotheses", "notes",
    )  # fmt: skip

    def _rows(self) -> Iterator[list[str]]:
        yield from self._rows_of({"action": self.per_action, "subject": self.per_subject, "joint": self.per_joint})
        for name, found in (self.calibration or {}).items():
            figures = found.items() if isinstance(found, dict) else [(name, found)]
            group = name if isinstance(found, dict) else ""
            yield from (["calibration", group, protocol, repr(value), ""] for protocol, value in figures)
        for section, groups in (("trunk", self.by_trunk_angle), ("signs", self.signs)):
            for name, figures in groups.items():
                yield from (
                    [section, name, figure, repr(value), self._unit(figure)] for figure, value in figures.items()
                )
        for name, value in (self.hypotheses or {}).items():
            if name != "calibration":
                yield ["hypotheses", "", name, repr(value), self.unit if name in _HYPOTHESIS_ERRORS else ""]
        for name, figures in (self.hypotheses or {}).get("calibration", {}).items():
            yield from (["hypotheses", name, figure, repr(value), ""] for figure, value in figures.items())

    def _unit(self, figure: str) -> str:
        return self.unit if is_error(figure) else ""

    def _tables(self) -> list[str]:
        ends = len(ACTION_MEAN)
        means = {name[:-ends]: value for name, value in self.overall.items() if name.endswith(ACTION_MEAN)}
        return [
            f"{self.data or 'evaluation'}: {self.frames:,} frames",
            self._overall_table({"mean of actions": means} if means else {}, absent=""),
            self._action_table() if self.per_action else "",
            self._joint_table(),
            self._calibration_table(),
            self._trunk_table(),
            self._sign_table(),
            self._hypothesis_table(),
        ]

    def _shown(self) -> list[str]:
        return [name for name in super()._shown() if not name.endswith(ACTION_MEAN)]

    def _action_table(self) -> str:
        paper = paper_order(list(self.per_action))
        activities = paper is not None and set(paper) <= set(_ACTIVITY_COLUMNS)
        names = _present(_ACTIVITY_HEADLINE if activities else _HEADLINE, self.per_action)
        if paper:
            return self._paper_table(paper, names, activities)
        rows = self._group_rows(self.per_action, names, self.action_frames)
        mean = ["mean of all actions", f"{self.frames:,}", *(self._mean(name) for name in names)]
        more = _more(len(self.per_action) - len(rows), "actions", "frames")
        return _columns([["per action", "frames", *names], *rows, mean]) + more

    def _paper_table(self, paper: dict[str, str], names: list[str], activities: bool) -> str:
        """Return a column for each action and their mean; of activities also all frames, as MPI-INF-3DHP reports."""
        rows = [["per action", *paper, "Avg", *(["All"] if activities else [])]]
        for name in names:
            cells = [self._text(name, self.per_action[action]) for action in paper.values()]
            rows.append([name, *cells, self._mean(name), *([self._text(name, self.overall)] if activities else [])])
        if activities:
            counts = (f"{self.action_frames.get(action, 0):,}" for action in paper.values())
            rows.append(["frames", *counts, "", f"{self.frames:,}"])
        return _columns(rows)

    def _mean(self, name: str) -> str:
        values = [of[name] for of in self.per_action.values() if name in of]
        return figure_text(name, sum(values) / len(values), self.unit)

    def _joint_table(self) -> str:
        names = _present(_HEADLINE, self.per_joint)
        rows = [[joint, *(self._text(name, of) for name in names)] for joint, of in self.per_joint.items()]
        return _columns([["per joint", *names], *rows])

    def _calibration_table(self) -> str:
        """Return the shares of depth errors inside the intervals that the uncertainty gives; nothing without one."""
        found = self.calibration or {}
        groups = [(name, ending) for name, ending in (("visible", ""), ("missing", MISSING)) if name in found]
        if not groups:
            return ""
        rows = [["depth errors inside the interval of", *found[groups[0][0]], "uncertainty_error", "rank_correlation"]]
        for name, ending in groups:
            others = [found.get(f"{figure}{ending}") for figure in ("uncertainty_error", "rank_correlation")]
            shown = [*found[name].values(), *others]
            rows.append([f"joints {name}", *("-" if value is None else f"{value:.3f}" for value in shown)])
        return _columns(rows)

    def _trunk_table(self) -> str:
        if not self.by_trunk_angle:
            return ""
        rows = [["trunk's angle from upright, deg", "frames", "share", "p_mpjpe", "flipped", "wrong_signs"]]
        for name, of in self.by_trunk_angle.items():
            error, wrong = (self._text(figure, of) for figure in ("p_mpjpe", "wrong_signs"))
            rows.append([name, f"{of['frames']:,}", f"{of['share']:.3f}", error, f"{of['flipped']:.3f}", wrong])
        return _columns(rows)

    def _sign_table(self) -> str:
        """Return the bones with the most wrong signs."""
        worst = sorted(self.signs, key=lambda bone: -self.signs[bone]["wrong"])[:_MAX_ROWS]
        rows = [[bone, f"{self.signs[bone]['frames']:,}", f"{self.signs[bone]['wrong']:.3f}"] for bone in worst]
        more = _more(len(self.signs) - len(rows), "bones", "wrong signs")
        return _columns([["depth signs", "frames", "wrong"], *rows]) + more if rows else ""

    def _hypothesis_table(self) -> str:
        found = self.hypotheses
        if not found:
            return ""
        head = [f"{found['count']} hypotheses, p_mpjpe", "value"]
        rows = [[name, f"{found[name]:.1f}"] for name in _HYPOTHESIS_ERRORS]
        said = [["said to be as likely as", "hypotheses", "mean", "share that is the best of its frame"]]
        for name, of in found["calibration"].items():
            said.append([name, f"{of['hypotheses']:,}", f"{of['said']:.3f}", f"{of['found']:.3f}"])
        return f"{_columns([head, *rows])}\n\n{_columns(said)}"


@dataclass(frozen=True)
class ShapeEvaluation(AnyEvaluation):
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
    baselines: dict[str, dict[str, float]] = field(default_factory=dict)
    """The overall figures of each baseline."""
    notes: list[str] = field(default_factory=list)

    title, unit = "metric", LONGEST_SIDE
    saved = ("data", "unit", "items", "overall", "per_category", "baselines", "notes")

    def _rows(self) -> Iterator[list[str]]:
        yield from self._rows_of({"category": self.per_category, "floor": self.baselines})
        for metric, values in self.per_item.items():
            for name, value in zip(self.names, values.tolist(), strict=True):
                if math.isfinite(value):
                    yield ["item", name, *self._cells(metric, value)]

    def _tables(self) -> list[str]:
        return [
            f"{self.data or 'evaluation'}: {self.items:,} shapes",
            self._overall_table(self.baselines, absent="-"),
            self._category_table() if self.per_category else "",
        ]

    def _shown(self) -> list[str]:
        return [name for name in super()._shown() if not (self.baselines and name.startswith(BEST_BASELINE))]

    def _category_table(self) -> str:
        names = self._shown()
        rows = self._group_rows(self.per_category, names, self.category_items)
        more = _more(len(self.per_category) - len(rows), "categories", "shapes")
        return _columns([["per category", "shapes", *names], *rows]) + more


def _present(names: Iterable[str], groups: Groups) -> list[str]:
    """Return the metrics that any of the groups has."""
    return [name for name in names if any(name in values for values in groups.values())]


def _more(count: int, groups: str, members: str) -> str:
    return f"\n({count} more {groups}, with fewer {members}: in the JSON and CSV files)" if count else ""


def _short(text: str, limit: int = 32) -> str:
    return text if len(text) <= limit else text[: limit - 1] + "…"


def _columns(rows: list[list[str]], left: tuple[int, ...] = (0,)) -> str:
    """Return rows as aligned text: the ``left`` columns to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    sides = ["<" if place in left else ">" for place in range(len(widths))]
    cells = ([f"{c:{s}{w}}" for c, s, w in zip(row, sides, widths, strict=True)] for row in rows)
    return "\n".join("  ".join(row).rstrip() for row in cells)


@dataclass(frozen=True)
class Sheet:
    """A table: title, column heads, rows of cells."""

    title: str
    head: list[str]
    rows: list[list[str]]

    def text(self) -> str:
        """Return it with aligned columns."""
        return f"\n{self.title}\n{_columns([self.head, *self.rows])}"

    def markdown(self) -> str:
        """Return it in Markdown."""
        rule = ["---", *("---:" for _ in self.head[1:])]
        lines = ["| " + " | ".join(row) + " |" for row in (self.head, rule, *self.rows)]
        return "\n".join(["", f"**{self.title}**", "", *lines])


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
