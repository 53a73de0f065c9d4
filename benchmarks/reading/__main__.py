"""Measure how long it takes to read a million bodies in each format, and to write predictions in each.

Each measurement is a fresh process, the best of three; what is read is compared with what was written. Files are
generated once and kept if --folder is given; stored results are not measured again without --again. Formats with a
file per frame get 20,000 files, and their time per million rows is extrapolated.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import ROOT, Sheet, facts, markdown, measure_apart, write_json
from benchmarks.reading.cells import CELLS, Cell
from benchmarks.reading.measure import expected_file
from uplift.export import WRITERS

__all__ = ["main"]

RESULT = ROOT / "benchmarks" / "results" / "reading.json"
_ROWS, _FRAMES, _MILLION = 1_000_000, 100_000, 1_000_000
_FILMS = (".gif", ".mp4")
"""Endings that get a hundredth of the frames."""
_MOST_FRAMES = {".c3d": 65_535}
"""The most frames that a file of an ending can hold."""
_PACKAGES = {"pandas": "pandas", "pandas h5": "tables", "sleap-io": "sleap_io"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is not stored yet, print and store the results."""
    given = _parser().parse_args(arguments)
    found: dict[str, Any] = json.loads(given.out.read_text()) if given.out.is_file() else {}
    if not given.print:
        with tempfile.TemporaryDirectory() as temporary:
            _measure(found, given, given.folder or Path(temporary))
    for sheet in _sheets(found):
        print(markdown(sheet))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reading", description=__doc__)
    parser.add_argument("--rows", type=int, default=_ROWS, help=f"rows of a file to read, default {_ROWS:,}")
    parser.add_argument("--frames", type=int, default=_FRAMES, help=f"frames of a file to write, default {_FRAMES:,}")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="only results whose name contains this")
    parser.add_argument("--times", type=int, default=3, help="repetitions; the best counts, default 3")
    parser.add_argument("--folder", type=Path, help="keep the files here; default: a temporary folder")
    parser.add_argument("--again", action="store_true", help="measure stored results again")
    parser.add_argument("--no-yardsticks", action="store_true", help="do not measure other programs")
    parser.add_argument("--out", type=Path, default=RESULT, help="JSON file for the results")
    parser.add_argument("--print", action="store_true", help="print stored results, measure nothing")
    return parser


def _measure(found: dict[str, Any], given: argparse.Namespace, folder: Path) -> None:
    """Measure file by file and store each result at once."""
    for cell in CELLS:
        rows = cell.walk(given.rows).rows
        if _wanted(found, given, "read", cell.name, "rows", rows):
            _store(found, given, "read", cell.name, _reader(cell, rows, folder, given))
    for ending in WRITERS["poses"]:
        name = f"write {ending}"
        frames = min(given.frames, _MOST_FRAMES.get(ending, given.frames))
        frames = max(frames // 100, 1) if ending in _FILMS else frames
        if _wanted(found, given, "write", name, "frames", frames):
            _store(found, given, "write", name, _best(_writer(ending, frames, folder), given.times))


def _wanted(found: dict[str, Any], given: argparse.Namespace, kind: str, name: str, unit: str, count: int) -> bool:
    if given.only and not any(part in name for part in given.only):
        return False
    return given.again or found.get(kind, {}).get(name, {}).get(unit) != count


def _reader(cell: Cell, rows: int, folder: Path, given: argparse.Namespace) -> dict[str, Any]:
    path = folder / str(rows) / cell.file
    path.parent.mkdir(parents=True, exist_ok=True)
    if not expected_file(path).is_file():
        _remove(path)
        print(f"{cell.name}: writing {rows:,} rows", flush=True)
        _process("make", cell.name, path, rows)
    expected = json.loads(expected_file(path).read_text())
    result = _best(lambda: _process("read", cell.name, path), given.times)
    result = {**result, "bytes": expected["bytes"], "making_cpu_s": expected["making_cpu_s"]}
    if cell.yardstick and not given.no_yardsticks and importlib.util.find_spec(_PACKAGES.get(cell.yardstick, "json")):
        other = _best(lambda: _process("other", cell.name, path), given.times)
        result["yardstick"] = {"name": cell.yardstick, **other}
    if not given.folder:
        _remove(path)
    return result


def _writer(ending: str, frames: int, folder: Path) -> Callable[[], dict[str, Any]]:
    def work() -> dict[str, Any]:
        with tempfile.TemporaryDirectory(dir=folder) as place:
            return _process("write", ending, place, frames)

    return work


def _process(*words: object) -> dict[str, Any]:
    return measure_apart("benchmarks.reading.measure", *words)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)


def _best(work: Callable[[], dict[str, Any]], times: int) -> dict[str, Any]:
    """Return the first run with the least CPU time, wall time and memory of all runs."""
    runs = [work() for _ in range(times)]
    least = {name: min(run[name] for run in runs) for name in ("cpu_s", "wall_s", "peak_gb")}
    return {**runs[0], **least, "times": times}


def _store(found: dict[str, Any], given: argparse.Namespace, kind: str, name: str, result: dict[str, Any]) -> None:
    """Add a result to the file, in the order of the tables."""
    machine = facts()
    usual = {"rows": _ROWS, "frames": _FRAMES, "times": 3}
    words = [f"--{key}={getattr(given, key)}" for key, value in usual.items() if getattr(given, key) != value]
    found.setdefault(kind, {})[name] = {**result, "commit": machine["commit"]}
    order = [cell.name for cell in CELLS] if kind == "read" else [f"write {ending}" for ending in WRITERS["poses"]]
    found[kind] = {one: found[kind][one] for one in order if one in found[kind]}
    found.update({"command": " ".join(["python -m benchmarks.reading", *words]), **machine})
    for last in ("read", "write"):
        if last in found:
            found[last] = found.pop(last)
    write_json(given.out, found)
    print(f"{name}: {result['cpu_s']:.2f} s CPU, {result['peak_gb']:.2f} GB", flush=True)


def _sheets(found: dict[str, Any]) -> list[Sheet]:
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
    """Return the other program, its time, and ours relative to it."""
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


if __name__ == "__main__":
    sys.exit(main())
