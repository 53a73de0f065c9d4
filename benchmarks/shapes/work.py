"""Run one fit, keep what was found, with the command that found it."""

from __future__ import annotations

import contextlib
import json
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.accuracy.work import CellFailed
from benchmarks.machine import ROOT, facts
from benchmarks.shapes.animals import animal_masks, cache_folder
from benchmarks.shapes.cells import Cell
from uplift.config.files import replacing
from uplift.errors import UserError

__all__ = ["RESULTS", "keep", "kept_results", "run_cell"]

RESULTS = ROOT / "benchmarks" / "results" / "shapes.json"
_KEPT = ("items", "overall", "floors", "per_category", "notes")


def kept_results() -> dict[str, dict[str, Any]]:
    """Return the results that are there, by `Cell.key`."""
    return json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}


def keep(key: str, result: dict[str, Any]) -> None:
    """Put a result beside those that are there."""
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    with replacing(RESULTS) as file:
        file.write((json.dumps(dict(sorted({**kept_results(), key: result}.items())), indent=1) + "\n").encode())


def run_cell(cell: Cell, runs: Path | None = None) -> dict[str, Any]:
    """Fit, keep what the evaluation found and return it; the run stays in ``runs``, if that is given.

    Raises:
        CellFailed: the fit was refused, or nothing was evaluated.
    """
    words = [*_data_words(cell), *cell.overrides]
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(runs or folder):
        evaluation = _evaluation(cell.task, words)
    result = {
        "command": shown(" ".join(["uplift fit", f"task={cell.task}", *words])),
        "benchmark": f"python -m benchmarks.shapes {cell.name.partition('_')[0].replace('family', 'families')}",
        "seed": cell.seed,
        "minutes": cell.minutes,
        **facts(),
        "wall_seconds": round(time.monotonic() - start, 1),
        **{part: evaluation[part] for part in _KEPT if part in evaluation},
    }
    keep(cell.key, result)
    return result


def _data_words(cell: Cell) -> list[str]:
    """Return which files the masks of the cell are, where they are not the task's."""
    if not cell.animals:
        return []
    files = animal_masks()
    return ["data.simulate=0", f"data.train={files['train'].absolute()}", f"data.test={files['test'].absolute()}"]


def _evaluation(task: str, words: list[str]) -> dict[str, Any]:
    """Fit in the current folder and return what evaluation.json then holds."""
    from uplift.cli import fit
    from uplift.config.loading import load_settings

    try:
        evaluation = fit.fit_settings(load_settings(task, words)).evaluation()
    except UserError as error:
        raise CellFailed(f"uplift fit task={task} {' '.join(words)}: {error}") from error
    if evaluation is None:
        raise CellFailed(f"uplift fit task={task} {' '.join(words)}: nothing was evaluated")
    return evaluation


def shown(text: str) -> str:
    """Return a command without this machine's folders."""
    return text.replace(str(cache_folder().absolute()), "$UPLIFT_BENCHMARK_CACHE/shapes")
