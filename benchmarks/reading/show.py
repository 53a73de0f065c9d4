"""The results as tables."""

from __future__ import annotations

from typing import Any

from benchmarks.accuracy.show import Sheet

__all__ = ["sheets"]

_MILLION = 1_000_000


def sheets(found: dict[str, Any]) -> list[Sheet]:
    """Return a table of the readers and one of the writers."""
    return [sheet for sheet in (_readers(found.get("read", {})), _writers(found.get("write", {}))) if sheet.rows]


def _readers(cells: dict[str, dict[str, Any]]) -> Sheet:
    head = ["file", "rows", "joints", "size, MB", "CPU, s", "wall, s", "a million rows, CPU s", "peak, GB", "other"]
    rows = [
        [
            name,
            f"{cell['rows']:,}",
            str(cell["joints"]),
            f"{cell['bytes'] / 1e6:,.0f}",
            f"{cell['cpu_s']:.2f}",
            f"{cell['wall_s']:.2f}",
            f"{cell['cpu_s'] * _MILLION / cell['rows']:.1f}",
            f"{cell['peak_gb']:.2f}",
            _other(cell),
        ]
        for name, cell in cells.items()
    ]
    return Sheet("Reading", head, rows)


def _other(cell: dict[str, Any]) -> str:
    """Return the other program and its share of our time."""
    other = cell.get("yardstick")
    return f"{other['name']} {other['cpu_s']:.2f} s, ratio {cell['cpu_s'] / other['cpu_s']:.1f}" if other else ""


def _writers(cells: dict[str, dict[str, Any]]) -> Sheet:
    head = ["ending", "frames", "size, MB", "CPU, s", "wall, s", "peak, GB"]
    rows = [
        [
            name,
            f"{cell['frames']:,}",
            f"{cell['bytes'] / 1e6:,.1f}",
            f"{cell['cpu_s']:.2f}",
            f"{cell['wall_s']:.2f}",
            f"{cell['peak_gb']:.2f}",
        ]
        for name, cell in cells.items()
    ]
    return Sheet("Writing", head, rows)
