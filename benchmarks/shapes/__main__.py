"""Fit lifters of masks and compare their shapes with the baselines and a supervised twin.

demo is `uplift fit task=masks_demo`; families the same on chairs, sofas, cars and simulated animals; ceiling trains a
supervised network on their true shapes and views and says which share of its figures the fits reach; twin is trained
on every true shape, semi on a few; animals tests on held-out species (needs UPLIFT_DATA with animal_meshes), modelnet
on ModelNet10 (--folder, where you have it); cost measures a training step at each resolution. Results stored in
benchmarks/results/shapes.json are not computed again.
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
from benchmarks.shapes.fits import COMMANDS, FAMILIES, ceiling_key, cells_of, run_cell
from benchmarks.shapes.show import ceiling_sheets, cost_sheet, sheets_of

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not stored yet and print the tables; 1 if something failed."""
    given = _parser().parse_args(arguments)
    cells = [
        cell
        for name in given.commands
        if name in COMMANDS
        for cell in cells_of(name, given.seeds, given.minutes, given.families, given.shares)
    ]
    if "modelnet" in given.commands and given.folder is None:
        print("modelnet: skipped, no --folder of ModelNet10 (docs/masks-data.md)", flush=True)
    fitted = [cell for cell in cells if not cell.modelnet or given.folder is not None]
    jobs: dict[str, Callable[[], object]] = {
        cell.key: partial(run_cell, cell, given.runs, given.folder) for cell in fitted
    }
    jobs |= _ceilings(given) if "ceiling" in given.commands else {}
    for resolution in given.resolutions if "cost" in given.commands else []:
        key = f"cost_{resolution}" + (f"_{given.threads}threads" if given.threads else "")
        jobs[key] = partial(_run_cost, key, resolution, given.steps, given.threads)
    failed = 0 if given.print else run_missing(fits.RESULTS, jobs)
    results = stored(fits.RESULTS)
    sheets = [
        *sheets_of(cells, results),
        *(ceiling_sheets(results, given.families, given.seconds) if "ceiling" in given.commands else []),
        *(cost_sheet(results) if "cost" in given.commands else []),
    ]
    for sheet in sheets:
        print((markdown if given.markdown else text)(sheet), flush=True)
    return 1 if failed else 0


def _ceilings(given: argparse.Namespace) -> dict[str, Callable[[], object]]:
    return {
        ceiling_key(family, given.seconds, seed): partial(_run_ceiling, family, given.seconds, seed)
        for seed in given.seeds
        for family in given.families
    }


def _run_ceiling(family: str, seconds: float, seed: int) -> None:
    from benchmarks.shapes.ceiling import run_ceiling

    run_ceiling(family, seconds, seed)


def _run_cost(key: str, resolution: int, steps: int, threads: int | None) -> None:
    store(fits.RESULTS, key, measured_apart(resolution, steps, threads))


def _parser() -> argparse.ArgumentParser:
    parser = table_parser("shapes", __doc__)
    parser.add_argument("commands", nargs="+", choices=[*COMMANDS, "ceiling", "cost"], metavar="COMMAND",
                        help=f"any of {', '.join(COMMANDS)}, ceiling, cost")  # fmt: skip
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], metavar="N", help="default 0 1 2")
    parser.add_argument("--minutes", type=float, help="training time, default: the task's")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES), metavar="NAME",
                        help=f"for families and ceiling, default {' '.join(FAMILIES)}")  # fmt: skip
    parser.add_argument("--shares", nargs="+", type=float, default=list(fits.LABELLED), metavar="X", help="for semi")
    parser.add_argument("--seconds", type=float, default=150, help="CPU time of ceiling's training, default 150")
    parser.add_argument("--folder", type=Path, help="of ModelNet10, for modelnet")
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
