"""Train and evaluate the cells of a table; finished cells are kept, so a broken run goes on."""

from __future__ import annotations

import argparse
import json
import os
import queue
import shlex
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml

from benchmarks.machine import ROOT, facts

_HERE = Path(__file__).resolve().parent
_RESULTS = ROOT / "benchmarks" / "results" / "accuracy"
_SHOWN = ("p_mpjpe", "mpjpe_gt_scale", "n_mpjpe", "facing", "elevation_deg")


def main() -> int:
    """Run the tables named on the command line, all without names, and print them."""
    tables = yaml.safe_load((_HERE / "cells.yaml").read_text())
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description=__doc__)
    parser.add_argument("tables", nargs="*", help=f"of {', '.join(tables)}; all without a name")
    parser.add_argument("--minutes", type=float, help="in place of the tables' own, for a quick look")
    parser.add_argument("--jobs", type=int, default=1, help="fits side by side, each on its own share of the cores")
    parser.add_argument("--print", action="store_true", help="print what is there and run nothing")
    given = parser.parse_args()
    unknown = set(given.tables) - set(tables)
    if unknown:
        parser.error(f"no table {', '.join(sorted(unknown))}; there are {', '.join(tables)}")
    for name in given.tables or tables:
        table = tables[name]
        cells = [
            (fit, minutes, seed)
            for minutes in ([given.minutes] if given.minutes else table["minutes"])
            for seed in table["seeds"]
            for fit in table["fits"]
        ]
        if not given.print:
            run_cells(name, table, cells, given.jobs)
        print(show(name, cells))
    return 0


def cell_path(table: str, fit: str, minutes: float, seed: int) -> Path:
    """Return where a cell's result is kept."""
    return _RESULTS / table / f"{fit}_{minutes:g}min_seed{seed}.json"


def run_cells(name: str, table: dict, cells: list[tuple[str, float, int]], jobs: int) -> None:
    """Run the cells that are not there yet, ``jobs`` at a time; each job has its own cores."""
    cores = sorted(os.sched_getaffinity(0))
    shares: queue.Queue[set[int]] = queue.Queue()
    for job in range(jobs):
        shares.put(set(cores[job::jobs]))

    def run(cell: tuple[str, float, int]) -> None:
        fit, minutes, seed = cell
        path = cell_path(name, fit, minutes, seed)
        if path.is_file():
            print(f"kept {path.relative_to(ROOT)}", flush=True)
            return
        mine = shares.get()
        try:
            run_cell(name, fit, table["fits"][fit], minutes, seed, table.get("test"), mine)
        finally:
            shares.put(mine)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(run, cells))


def run_cell(table: str, fit: str, words: str, minutes: float, seed: int, test: str | None, cores: set[int]) -> None:
    """Fit and evaluate one cell on ``cores``."""
    seconds = round(60 * minutes)
    clock = f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
    command = ["uplift", "fit", *shlex.split(words), f"trainer.max_time={clock}", f"seed={seed}"]
    print(f"\n{table}: {shlex.join(command)}", flush=True)
    python = [sys.executable, "-m", "uplift.cli"]
    environment = {**os.environ, "OMP_NUM_THREADS": str(len(cores))}

    def work(more: list[str], folder: str) -> None:
        subprocess.run(
            [*python, *more], cwd=folder, check=True, env=environment, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, preexec_fn=lambda: os.sched_setaffinity(0, cores),
        )  # fmt: skip

    with tempfile.TemporaryDirectory() as folder:
        work(command[1:], folder)
        run = next(Path(folder).glob("runs/*/last")).resolve()
        commands = [shlex.join(command)]
        if test:
            file = Path(os.environ["UPLIFT_DATA"]).resolve() / test
            work(["evaluate", f"run={run}", f"data.test={file}"], folder)
            commands.append(f"uplift evaluate run=RUN data.test=$UPLIFT_DATA/{test}")
        evaluation = json.loads((run / "evaluation.json").read_text())
        sizes = {"lifter_bytes": (run / "lifter.pt").stat().st_size}
    result = {
        "commands": commands,
        "seed": seed,
        "minutes": minutes,
        **facts(),
        **sizes,
        "overall": evaluation["overall"],
    }
    path = cell_path(table, fit, minutes, seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1) + "\n")


def show(table: str, cells: list[tuple[str, float, int]]) -> str:
    """Return the table: a row for each recipe and time, the mean over its seeds and their spread."""
    lines = [f"\n{table}", f"{'recipe':<18}{'minutes':>8}{'seeds':>6}" + "".join(f"{name:>20}" for name in _SHOWN)]
    for fit, minutes in dict.fromkeys((fit, minutes) for fit, minutes, _ in cells):
        seeds = [seed for f, m, seed in cells if (f, m) == (fit, minutes)]
        found = [cell_path(table, fit, minutes, seed) for seed in seeds]
        overall = [json.loads(path.read_text())["overall"] for path in found if path.is_file()]
        texts = [_mean([o[name] for o in overall if name in o]) for name in _SHOWN]
        lines.append(f"{fit:<18}{minutes:>8g}{len(overall):>6}" + "".join(f"{text:>20}" for text in texts))
    return "\n".join(lines)


def _mean(values: list[float]) -> str:
    if not values:
        return "-"
    mean = sum(values) / len(values)
    return f"{mean:.3f}" + (f" ({min(values):.3f}-{max(values):.3f})" if len(values) > 1 else "")


if __name__ == "__main__":
    sys.exit(main())
