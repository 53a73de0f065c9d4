"""Curves of a run as small inline SVG charts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from typing import SupportsFloat

__all__ = ["Curve", "curve_charts", "number_text"]

Curve = Sequence[tuple[SupportsFloat, SupportsFloat]]

_WIDTH, _HEIGHT, _MOST_POINTS = 240, 84, 240


def curve_charts(curves: Mapping[str, Curve]) -> str:
    """Return one small chart per curve of (step, value) points; values that are not finite are left out."""
    charts = []
    for name, points in curves.items():
        numbers = [(float(x), float(y)) for x, y in points]
        finite = [point for point in numbers if all(map(math.isfinite, point))]
        if finite:
            charts.append(_chart(name, finite))
    return f'<div class="charts">{"".join(charts)}</div>' if charts else ""


def number_text(value: object) -> str:
    """Return a table cell's text: numbers to four figures, everything else as it is."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if not math.isfinite(value):
        return "–"
    if float(value).is_integer() and abs(value) < 1e9:
        return f"{int(value):,}"
    return f"{value:.3f}" if abs(value) < 10 else f"{value:,.1f}"


def _chart(name: str, points: list[tuple[float, float]]) -> str:
    points = _thinned(points)
    (first, last), values = (points[0][0], points[-1][0]), [y for _, y in points]
    low, high = min(values), max(values)
    wide, tall = (last - first) or 1.0, (high - low) or 1.0
    xy = [((x - first) / wide * _WIDTH, _HEIGHT - (y - low) / tall * _HEIGHT) for x, y in points]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in xy)
    label = escape(name)
    final = number_text(points[-1][1])
    return (
        f'<figure class="chart"><figcaption><span>{label}</span><b>{escape(final)}</b></figcaption>'
        f'<svg viewBox="-5 -5 {_WIDTH + 10} {_HEIGHT + 10}" role="img" '
        f'aria-label="{label}, from {number_text(points[0][1])} to {final}">'
        f'<path class="axis" d="M0 {_HEIGHT}H{_WIDTH}"/><polyline class="curve" points="{line}"/>'
        f'<circle class="end" cx="{xy[-1][0]:.1f}" cy="{xy[-1][1]:.1f}" r="3"/></svg>'
        f'<div class="range"><span>steps {number_text(first)} to {number_text(last)}</span>'
        f"<span>{number_text(low)} to {number_text(high)}</span></div></figure>"
    )


def _thinned(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return at most so many points, each the mean of its neighbours, ends kept."""
    if len(points) <= _MOST_POINTS:
        return points
    edges = [round(n * len(points) / _MOST_POINTS) for n in range(_MOST_POINTS + 1)]
    parts = [points[a:b] for a, b in pairwise(edges)]
    means = [(sum(x for x, _ in part) / len(part), sum(y for _, y in part) / len(part)) for part in parts]
    return [points[0], *means[1:-1], points[-1]]
