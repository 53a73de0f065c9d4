"""Fit lifters of masks and say how good their shapes are, beside the floors and the supervised twin.

demo is `uplift fit task=masks_demo`; families the same on other made-up shapes; twin sees every true
shape, semi a few; animals are lifted of species that were held out (needs UPLIFT_DATA with
animal_meshes); cost is what a training step takes at each resolution. What is kept in
benchmarks/results/shapes.json is not computed twice.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.accuracy.show import markdown, text
from benchmarks.accuracy.work import CellFailed
from benchmarks.shapes.cells import COMMANDS, Cell, cells_of
from benchmarks.shapes.cost import RESOLUTIONS, measured_apart
from benchmarks.shapes.show import cost_sheet, sheets_of
from benchmarks.shapes.work import keep, kept_results, run_cell

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not kept yet and print the tables; 1 where something failed."""
    given = _parser().parse_args(arguments)
    cells = [cell for name in given.commands if name in COMMANDS for cell in cells_of(name, given.seeds, given.minutes)]
    failed = 0
    for cell in [] if given.print else cells:
        failed += not _done(cell.key, lambda cell=cell: run_cell(cell, given.runs))
    if "cost" in given.commands and not given.print:
        for resolution in given.resolutions:
            key = f"cost_{resolution}" + (f"_{given.threads}threads" if given.threads else "")
            failed += not _done(key, lambda r=resolution, k=key: keep(k, measured_apart(r, given.steps, given.threads)))
    _print(given.commands, cells, markdown if given.markdown else text)
    return 1 if failed else 0


def _done(key: str, run: Callable[[], Any]) -> bool:
    """Run what is not kept yet; False where it failed, which is told."""
    if key in kept_results():
        return True
    print(f"run {key}", flush=True)
    try:
        run()
    except CellFailed as error:
        print(f"\n{key}: {error}\n", file=sys.stderr, flush=True)
        return False
    return True


def _print(commands: Sequence[str], cells: Sequence[Cell], show: Callable[[Any], str]) -> None:
    results = kept_results()
    sheets = [*sheets_of(cells, results), *(cost_sheet(results) if "cost" in commands else [])]
    for sheet in sheets:
        print(show(sheet), flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.shapes", description=__doc__)
    parser.add_argument("commands", nargs="+", choices=[*COMMANDS, "cost"], metavar="COMMAND",
                        help=f"of {', '.join(COMMANDS)} and cost")  # fmt: skip
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N", help="0 1 2 without it")
    parser.add_argument("--minutes", type=float, help="of training; the task's own without it")
    parser.add_argument("--runs", type=_folder, metavar="FOLDER", help="where run folders stay; removed without it")
    parser.add_argument("--resolutions", nargs="+", type=int, default=list(RESOLUTIONS), metavar="N", help="of cost")
    parser.add_argument("--steps", type=int, default=20, help="that cost measures, 20 without it")
    parser.add_argument("--threads", type=int, help="of cost; as a fit has them without it")
    parser.add_argument("--print", action="store_true", help="print what is kept and run nothing")
    parser.add_argument("--markdown", action="store_true", help="print the tables for a document")
    return parser


def _folder(text: str) -> Path:
    path = Path(text).expanduser().absolute()
    path.mkdir(parents=True, exist_ok=True)
    return path


if __name__ == "__main__":
    sys.exit(main())
