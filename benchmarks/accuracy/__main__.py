"""Train and evaluate the cells of a table; results are stored, so an interrupted run can continue."""

from __future__ import annotations

import os
import queue
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import yaml

from benchmarks.accuracy.cells import Cell, cells_of
from benchmarks.accuracy.show import sheets_of
from benchmarks.accuracy.work import fill_in, run_cell
from benchmarks.common import BenchmarkError, markdown, table_parser, text
from uplift.errors import UserError

_TABLES = Path(__file__).resolve().parent / "cells.yaml"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tables named on the command line, by default all, and print them; 1 if a cell failed."""
    tables: dict[str, dict[str, Any]] = yaml.safe_load(_TABLES.read_text())
    parser = table_parser("accuracy", __doc__)
    parser.add_argument("tables", nargs="*", help=f"any of {', '.join(tables)}; default: all")
    parser.add_argument("--only", nargs="+", metavar="FIT", help="only these fits of the tables")
    parser.add_argument("--minutes", type=float, help="training time instead of the tables'")
    parser.add_argument("--jobs", type=int, default=1, help="fits in parallel, each on its share of the cores")
    given = parser.parse_args(arguments)
    unknown = set(given.tables) - set(tables)
    if unknown:
        parser.error(f"no table {', '.join(sorted(unknown))}; expected any of {', '.join(tables)}")
    if not 1 <= given.jobs <= len(os.sched_getaffinity(0)):
        parser.error(f"--jobs {given.jobs}: expected 1 to {len(os.sched_getaffinity(0))}, at least one core each")
    chosen = {name: cells_of(name, tables[name], given.minutes) for name in given.tables or tables}
    missing = set(given.only or ()) - {cell.fit.name for cells in chosen.values() for cell in cells}
    if missing:
        parser.error(f"no fit {', '.join(sorted(missing))} in {', '.join(chosen)}")
    failed = 0
    for name, cells in chosen.items():
        if not given.print:
            failed += run_cells([cell for cell in cells if not given.only or cell.fit.name in given.only], given.jobs)
        show = markdown if given.markdown else text
        print("\n".join(show(sheet) for sheet in sheets_of(name, tables[name], cells)), flush=True)
    if failed:
        print(f"\n{failed} cells failed; repeat the command to retry them", file=sys.stderr)
    return 1 if failed else 0


def run_cells(cells: Sequence[Cell], jobs: int) -> int:
    """Run the cells without a stored result, ``jobs`` in parallel on separate cores; return how many failed."""
    cores = sorted(os.sched_getaffinity(0))
    shares: queue.Queue[set[int]] = queue.Queue()
    for job in range(jobs):
        shares.put(set(cores[job::jobs]))

    def run(cell: Cell) -> bool:
        if cell.path.is_file():
            print(f"stored {cell.path.name}", flush=True)
            return True
        mine = shares.get()
        try:
            print(f"run {cell.path.name}", flush=True)
            run_cell(cell, mine)
        except (BenchmarkError, UserError) as error:
            print(f"\n{cell.table}, {cell.fit.name}: {error}\n", file=sys.stderr, flush=True)
            return False
        finally:
            shares.put(mine)
        return True

    _prepare([cell for cell in cells if not cell.path.is_file()])
    with ThreadPoolExecutor(jobs) as pool:
        return sum(not done for done in pool.map(run, cells))


def _prepare(cells: Sequence[Cell]) -> None:
    """Build the rigs once, before parallel jobs would."""
    words = [cell.fit.command for cell in cells] + [t.data for cell in cells for t in cell.fit.tests.values()]
    words += [cell.fit.test or "" for cell in cells]
    if any("{rigs}" in word for word in words):
        print(f"rigs: {fill_in('{rigs}')}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
