"""Fit lifters of masks and compare their shapes with the baselines and a supervised twin.

demo is `uplift fit task=masks_demo`; families the same on other simulated shapes; twin is trained on every true
shape, semi on a few; animals tests on held-out species (needs UPLIFT_DATA with animal_meshes); cost measures a
training step at each resolution. Results stored in benchmarks/results/shapes.json are not computed again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from benchmarks.common import markdown, run_missing, store, stored, table_parser, text
from benchmarks.shapes import fits
from benchmarks.shapes.cost import RESOLUTIONS, measured_apart
from benchmarks.shapes.fits import COMMANDS, cells_of, run_cell
from benchmarks.shapes.show import cost_sheet, sheets_of

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not stored yet and print the tables; 1 if something failed."""
    given = _parser().parse_args(arguments)
    cells = [cell for name in given.commands if name in COMMANDS for cell in cells_of(name, given.seeds, given.minutes)]
    jobs: dict[str, Callable[[], object]] = {cell.key: partial(run_cell, cell, given.runs) for cell in cells}
    for resolution in given.resolutions if "cost" in given.commands else []:
        key = f"cost_{resolution}" + (f"_{given.threads}threads" if given.threads else "")
        jobs[key] = partial(_run_cost, key, resolution, given.steps, given.threads)
    failed = 0 if given.print else run_missing(fits.RESULTS, jobs)
    results = stored(fits.RESULTS)
    for sheet in [*sheets_of(cells, results), *(cost_sheet(results) if "cost" in given.commands else [])]:
        print((markdown if given.markdown else text)(sheet), flush=True)
    return 1 if failed else 0


def _run_cost(key: str, resolution: int, steps: int, threads: int | None) -> None:
    store(fits.RESULTS, key, measured_apart(resolution, steps, threads))


def _parser() -> argparse.ArgumentParser:
    parser = table_parser("shapes", __doc__)
    parser.add_argument("commands", nargs="+", choices=[*COMMANDS, "cost"], metavar="COMMAND",
                        help=f"any of {', '.join(COMMANDS)}, cost")  # fmt: skip
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N", help="default 0 1 2")
    parser.add_argument("--minutes", type=float, help="training time, default: the task's")
    parser.add_argument("--runs", type=_folder, metavar="FOLDER", help="keep the run folders here")
    parser.add_argument("--resolutions", nargs="+", type=int, default=list(RESOLUTIONS), metavar="N", help="for cost")
    parser.add_argument("--steps", type=int, default=20, help="steps that cost measures, default 20")
    parser.add_argument("--threads", type=int, help="for cost; default: those of a fit")
    return parser


def _folder(text: str) -> Path:
    path = Path(text).expanduser().absolute()
    path.mkdir(parents=True, exist_ok=True)
    return path


if __name__ == "__main__":
    sys.exit(main())
