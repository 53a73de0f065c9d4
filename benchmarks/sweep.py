"""A sweep beside its fits one after another: seconds by the clock, on the same cores, with the same weights at the end.

``python -m benchmarks.sweep`` trains seeds of the task demo for a set number of steps in turns: as a sweep with a process on
each core, as the same command with its fits one after another in one process on one core, and as commands of one fit each.
Medians are compared, the sweep with the second, which has the same start. Fits on a machine that does other things take
whatever is left: run it on a quiet one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from benchmarks.common import ROOT, BenchmarkError, Sheet, facts, run_python, text, write_json

__all__ = ["LEAST", "RESULT", "main", "measure"]

RESULT = ROOT / "benchmarks" / "results" / "sweep.json"
LEAST = 1.9
"""How many times as fast a sweep on two cores is to be as its fits one after another."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and store the result; 1 if a sweep on two cores is too slow, or its fits are not the lone ones."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sweep", description=__doc__)
    parser.add_argument("--fits", type=int, default=16, help="seeds, default 16")
    parser.add_argument("--steps", type=int, default=200, help="of each fit, default 200")
    parser.add_argument("--cores", type=int, default=2, help="of the sweep, default 2")
    parser.add_argument("--repeats", type=int, default=1, help="measurements of both, default 1")
    parser.add_argument("--how", default="processes", choices=("processes", "stack"), help="sweep.how")
    parser.add_argument("--out", type=Path, default=RESULT, help="JSON file for the result")
    given = parser.parse_args(arguments)
    found = measure(given.fits, given.steps, given.cores, given.repeats, given.how)
    command = " ".join(["python -m benchmarks.sweep", *(arguments if arguments is not None else sys.argv[1:])])
    write_json(given.out, {"command": command, **facts(), **found})
    rows = [[name, f"{found[f'{name}_s']:.1f}", f"{found[f'{name}_cpu_s']:.1f}"] for name in _WAYS]
    title = f"{given.fits} fits of {given.steps} steps: {found['times_as_fast']:.2f} times as fast as one after another"
    print(text(Sheet(title, ["", "seconds", "CPU seconds"], rows)))
    print(f"weights of the sweep and of the lone fits: {'the same' if found['same_weights'] else 'different'}")
    print(f"wrote {given.out}")
    fast = found["times_as_fast"] >= LEAST or given.cores != 2
    return 0 if fast and (found["same_weights"] or given.how == "stack") else 1


_WAYS = ("commands", "in a row", "sweep")


def measure(fits: int, steps: int, cores: int, repeats: int, how: str) -> dict[str, Any]:
    """Train both ways in turns, each in an empty folder; return the medians and whether the weights are the same."""
    taken: dict[str, list[tuple[float, float]]] = {way: [] for way in _WAYS}
    allowed = set(sorted(os.sched_getaffinity(0))[:cores])
    if len(allowed) < cores:
        raise BenchmarkError(f"this process may use {len(allowed)} cores, expected {cores}")
    same = True
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            common = ["task=demo", "trainer.max_time=null", f"trainer.max_steps={steps}"]
            seeds = [f"seed={seed}" for seed in range(fits)]
            all_seeds = ["fit", *common, f"seed=0..{fits - 1}"]
            alone = [["fit", *common, "trainer.threads=1", seed] for seed in seeds]
            row = [[*all_seeds, "trainer.threads=1", "sweep.workers=1"]]
            together = [[*all_seeds, f"sweep.how={how}", *_workers(how, cores)]]
            one = set(sorted(allowed)[:1])
            taken["commands"].append(_seconds(alone, folder / "commands", one))
            taken["in a row"].append(_seconds(row, folder / "row", one))
            taken["sweep"].append(_seconds(together, folder / "sweep", allowed))
            found = [_weights(folder / way, runs) for way, runs in _RUNS.items()]
            same &= all(len(one) == fits and one == found[0] for one in found)
    result = {"fits": fits, "steps": steps, "cores": cores, "how": how, "same_weights": same}
    for way, times in taken.items():
        result[f"{way}_s"], result[f"{way}_cpu_s"] = (statistics.median(column) for column in zip(*times, strict=True))
    return {**result, "times_as_fast": result["in a row_s"] / result["sweep_s"]}


_RUNS = {"commands": "20*", "row": "sweep_*/*_seed=*", "sweep": "sweep_*/*_seed=*"}
"""Where runs are below the folder of each way."""


def _workers(how: str, cores: int) -> list[str]:
    return [f"sweep.workers={cores}"] if how == "processes" else []


def _seconds(commands: Sequence[Sequence[str]], folder: Path, cores: set[int]) -> tuple[float, float]:
    """Return how long commands take one after another by the clock, and in CPU seconds."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    before, start = os.times(), time.perf_counter()
    for words in commands:
        run_python(["-m", "uplift.cli.main", *words], folder, cores)
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return time.perf_counter() - start, spent


def _weights(folder: Path, runs: str) -> list[str]:
    """Return a digest of the weights of each run, in order of their seeds."""
    found = {}
    for run in folder.glob(f"runs/demo/{runs}"):
        path = run / "lifter.pt"
        if path.is_file():
            state = torch.load(path, weights_only=True)["state"]
            digest = hashlib.sha256(b"".join(state[name].numpy().tobytes() for name in sorted(state)))
            found[_seed_of(run)] = digest.hexdigest()
    return [found[seed] for seed in sorted(found)]


def _seed_of(run: Path) -> int:
    return int(json.loads((run / "run.json").read_text())["seed"])


if __name__ == "__main__":
    sys.exit(main())
