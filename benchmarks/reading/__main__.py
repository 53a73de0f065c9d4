"""Measure how long reading a million bodies takes in each format, and writing predictions in each.

Each measurement is a fresh process, the best of three; what is read is compared with what was written. Files
are made once and kept where --folder is given; finished cells are kept in the results unless --again. Formats
with a file a frame get 20,000 files, and the column of a million rows is scaled.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.accuracy.show import markdown
from benchmarks.machine import ROOT, facts
from benchmarks.reading.cells import CELLS, Cell
from benchmarks.reading.measure import told_of
from benchmarks.reading.show import sheets
from benchmarks.reading.writing import FILMS, MOST_FRAMES
from uplift.config.files import replacing
from uplift.export import WRITERS

__all__ = ["main"]

RESULT = ROOT / "benchmarks" / "results" / "reading.json"
_ROWS, _FRAMES = 1_000_000, 100_000
_PACKAGES = {"pandas": "pandas", "pandas h5": "tables", "sleap-io": "sleap_io"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is not measured yet, print and keep the results."""
    given = _parser().parse_args(arguments)
    found: dict[str, Any] = json.loads(given.out.read_text()) if given.out.is_file() else {}
    if not given.print:
        given.out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as temporary:
            _measure(found, given, given.folder or Path(temporary))
    for sheet in sheets(found):
        print(markdown(sheet))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reading", description=__doc__)
    parser.add_argument("--rows", type=int, default=_ROWS, help=f"of a file to read, {_ROWS:,} without it")
    parser.add_argument("--frames", type=int, default=_FRAMES, help=f"of a file to write, {_FRAMES:,} without it")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="parts of the names of cells")
    parser.add_argument("--times", type=int, default=3, help="of which the best counts")
    parser.add_argument("--folder", type=Path, help="where the files go and stay; without it a temporary one")
    parser.add_argument("--again", action="store_true", help="measure finished cells once more")
    parser.add_argument("--no-yardsticks", action="store_true", help="leave out what others take for the same files")
    parser.add_argument("--out", type=Path, default=RESULT, help="the JSON file of the results")
    parser.add_argument("--print", action="store_true", help="the tables of what is there, and measure nothing")
    return parser


def _measure(found: dict[str, Any], given: argparse.Namespace, folder: Path) -> None:
    """Measure cell by cell, and keep each as soon as it is there."""
    for cell in CELLS:
        rows = cell.walk(given.rows).rows
        if _wanted(found, given, "read", cell.name, "rows", rows):
            _keep(found, given, "read", cell.name, _reader(cell, rows, folder, given))
    for ending in WRITERS["poses"]:
        name = f"write {ending}"
        frames = (
            max(given.frames // 100, 1) if ending in FILMS else min(given.frames, MOST_FRAMES.get(ending, given.frames))
        )
        if _wanted(found, given, "write", name, "frames", frames):
            work = _writer(ending, frames, folder)
            _keep(found, given, "write", name, _best(work, given.times))


def _wanted(found: dict[str, Any], given: argparse.Namespace, kind: str, name: str, count: str, of: int) -> bool:
    if given.only and not any(part in name for part in given.only):
        return False
    return given.again or found.get(kind, {}).get(name, {}).get(count) != of


def _reader(cell: Cell, rows: int, folder: Path, given: argparse.Namespace) -> dict[str, Any]:
    place = folder / str(rows)
    place.mkdir(parents=True, exist_ok=True)
    path = place / cell.file
    if not told_of(path).is_file():
        _remove(path)
        print(f"{cell.name}: writing {rows:,} rows", flush=True)
        _process("benchmarks.reading.measure", "make", cell.name, path, rows)
    told = json.loads(told_of(path).read_text())
    result = _best(lambda: _process("benchmarks.reading.measure", "read", cell.name, path), given.times)
    result = {**result, "bytes": told["bytes"], "making_cpu_s": told["making_cpu_s"]}
    if cell.yardstick and not given.no_yardsticks and importlib.util.find_spec(_PACKAGES.get(cell.yardstick, "json")):
        other = _best(lambda: _process("benchmarks.reading.measure", "other", cell.name, path), given.times)
        result["yardstick"] = {"name": cell.yardstick, **other}
    if not given.folder:
        _remove(path)
    return result


def _writer(ending: str, frames: int, folder: Path) -> Callable[[], dict[str, Any]]:
    def work() -> dict[str, Any]:
        with tempfile.TemporaryDirectory(dir=folder) as place:
            return _process("benchmarks.reading.writing", ending, place, frames)

    return work


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)


def _best(work: Callable[[], dict[str, Any]], times: int) -> dict[str, Any]:
    """Return the run of least processor time, with the least of wall time and memory."""
    runs = [work() for _ in range(times)]
    least = {name: min(run[name] for run in runs) for name in ("cpu_s", "wall_s", "peak_gb")}
    return {**runs[0], **least, "times": times}


def _process(module: str, *words: object) -> dict[str, Any]:
    """Return what a fresh process measured."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-m", module, *map(str, words)],
        env={**os.environ, "PYTHONPATH": path}, stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    return json.loads(done.stdout.splitlines()[-1])


def _keep(found: dict[str, Any], given: argparse.Namespace, kind: str, name: str, result: dict[str, Any]) -> None:
    """Put a result in its file, cells in the order of the table."""
    machine = facts()
    words = [f"--{key}={getattr(given, key)}" for key, usual in (("rows", _ROWS), ("frames", _FRAMES), ("times", 3))
             if getattr(given, key) != usual]  # fmt: skip
    result["commit"] = machine["commit"]
    found.setdefault(kind, {})[name] = result
    order = [cell.name for cell in CELLS] if kind == "read" else [f"write {ending}" for ending in WRITERS["poses"]]
    found[kind] = {one: found[kind][one] for one in order if one in found[kind]}
    found.update({"command": " ".join(["python -m benchmarks.reading", *words]), **machine})
    parts = ("read", "write")
    ordered = {key: value for key, value in found.items() if key not in parts} | {
        key: found[key] for key in parts if key in found
    }
    with replacing(given.out) as file:
        file.write((json.dumps(ordered, indent=1) + "\n").encode())
    print(f"{name}: {result['cpu_s']:.2f} s of the processor, {result['peak_gb']:.2f} GB", flush=True)


if __name__ == "__main__":
    sys.exit(main())
