"""Fit new data from scratch and from a ready lifter (init=), at given steps, and compare with that lifter as it is.

A new species: 300 frames of 2D of half of its motions, the other half is the test; the ready lifter never saw the
species. A known kind: three people that the ready lifter never saw, split alike. Needs UPLIFT_DATA with the folders
quadruped and cmu. Ready lifters are trained in --runs, or found there; results stored in
benchmarks/results/transfer.json are not computed again.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import (
    ROOT,
    Sheet,
    data_folder,
    facts,
    markdown,
    mean_and_range,
    run_missing,
    run_uplift,
    store,
    stored,
    table_parser,
    text,
)  # fmt: skip

__all__ = ["CASES", "RESULTS", "Case", "main", "run_fit", "score_ready", "write_split"]

RESULTS = ROOT / "benchmarks" / "results" / "transfer.json"
_PROTOCOLS = ("p_mpjpe", "n_mpjpe")
_TRUTH = ("pose", "root", "tilt_deg")
_COMMON = ("trainer.max_time=null", "trainer.threads=1")
_SMALL = ("student.last_options.units=256", "lifter.signs=256")


@dataclass(frozen=True)
class Case:
    """New data, and the lifter that a fit of them may start from."""

    skeleton: str
    file: str
    """Below UPLIFT_DATA."""
    subjects: tuple[str, ...]
    ready: str
    """The folder of the ready lifter in --runs."""
    ready_fit: tuple[str, ...]
    """The words of its fit."""
    frames: int | None = None
    """Frames to fit; None for all of half of the motions."""
    words: tuple[str, ...] = _SMALL
    """Of the fit from scratch: networks as large as the ready lifter's."""
    steps: Mapping[str, int] | None = None
    """Steps from "scratch" and with "init", where they differ."""


_QUADRUPED = ("task=quadruped", *_SMALL, "trainer.max_steps=2000", *_COMMON, "data.test=null", "seed=0")
_UNSEEN = ("S2", "S9", "S17")
_PEOPLE = (
    "task=cmu", f"data.hold_out.subjects=[{','.join(_UNSEEN)}]", "data.test=null", "trainer.max_steps=17000",
    "teacher.share=0.3529", "student.share=0.6471", "student.rounds=[0.4545,0.5455]", *_COMMON, "seed=0",
)  # fmt: skip
CASES = {
    "cow": Case("quadruped28", "quadruped/test.npz", ("Cow",), "six_species", _QUADRUPED, 300),
    "shiba_inu": Case("quadruped28", "quadruped/test.npz", ("ShibaInu",), "six_species", _QUADRUPED, 300),
    "alpaca": Case(
        "quadruped28", "quadruped/train.npz", ("Alpaca",), "without_alpaca",
        (*_QUADRUPED, "data.hold_out.subjects=[Alpaca]"), 300,
    ),
    "people": Case(
        "h36m17", "cmu/train.npz", _UNSEEN, "people", _PEOPLE, words=(), steps={"scratch": 10_000, "init": 2_000}
    ),
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not stored yet and print the table; 1 if a fit failed."""
    given = _parser().parse_args(arguments)
    names, jobs = given.only or CASES, {}
    for seed in given.seeds:
        for name in names:
            jobs[f"{name}_ready_seed{seed}"] = partial(score_ready, name, seed, given.runs)
            for start in ("init", "scratch"):
                steps = (CASES[name].steps or {}).get(start, given.steps)
                jobs[f"{name}_{start}_{steps}_seed{seed}"] = partial(run_fit, name, start, steps, seed, given.runs)
    failed = 0 if given.print else run_missing(RESULTS, jobs)
    rows = [row for name in names for row in _rows(name, given.steps, given.seeds, stored(RESULTS))]
    head = ["new data", "start", "steps", "seeds", *_PROTOCOLS]
    print((markdown if given.markdown else text)(Sheet("transfer", head, rows)), flush=True)
    return 1 if failed else 0


def _parser() -> argparse.ArgumentParser:
    parser = table_parser("transfer", __doc__)
    parser.add_argument("--only", nargs="+", choices=CASES, metavar="NAME", help=f"any of {', '.join(CASES)}")
    parser.add_argument("--steps", type=int, default=600, help="of a fit of a new species, default 600")
    parser.add_argument("--seeds", type=lambda text: [int(part) for part in text.split(",")], default=[0])
    parser.add_argument("--runs", type=Path, default=Path("runs/transfer"), help="folder of the ready lifters")
    return parser


def _rows(name: str, steps: int, seeds: Sequence[int], results: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Return the rows of a case: the ready lifter, the fit from scratch, and the one that starts from it."""
    rows = []
    for start in ("ready", "scratch", "init"):
        taken = (CASES[name].steps or {}).get(start, steps) if start != "ready" else 0
        middle = f"{start}_{taken}" if taken else start
        found = [results[key] for seed in seeds if (key := f"{name}_{middle}_seed{seed}") in results]
        if found:
            errors = [mean_and_range([one[protocol] for one in found], ".1f") for protocol in _PROTOCOLS]
            rows.append([name, start, f"{taken:,}", str(len(found)), *errors])
    return rows


def write_split(case: Case, seed: int, folder: Path) -> None:
    """Write fit.npz, 2D of one half of the motions, and test.npz, the other half with its truth."""
    with np.load(data_folder() / case.file) as file:
        arrays = dict(file)
    count, random = len(arrays["subject"]), np.random.default_rng(seed)
    mine = np.isin(arrays["subject"], case.subjects)
    motions = random.permutation(np.unique(arrays["sequence"][mine]))
    first = np.isin(arrays["sequence"], motions[: len(motions) // 2])
    rows = np.flatnonzero(mine & first)
    if case.frames is not None:
        rows = np.sort(random.permutation(rows)[: case.frames])
    for name, chosen in (("fit", rows), ("test", np.flatnonzero(mine & ~first))):
        kept = {key: value for key, value in arrays.items() if name == "test" or key not in _TRUTH}
        part = {key: value[chosen] if value.ndim and len(value) == count else value for key, value in kept.items()}
        np.savez(folder / f"{name}.npz", **part)


def score_ready(name: str, seed: int, runs: Path) -> None:
    """Store the errors of the ready lifter on a case's test, without any training."""
    from uplift.data.clean import clean
    from uplift.data.load import load_file
    from uplift.metrics.evaluate import evaluate_model
    from uplift.models.model import load_poses

    case = CASES[name]
    ready = _ready(case, runs)
    with tempfile.TemporaryDirectory() as folder:
        write_split(case, seed, Path(folder))
        model = load_poses(ready)
        test, _ = clean(load_file(Path(folder) / "test.npz", model.skeleton), model.skeleton)
        overall = evaluate_model(model, test, "test.npz").overall
    figures = {protocol: overall[protocol] for protocol in _PROTOCOLS}
    store(RESULTS, f"{name}_ready_seed{seed}", {"seed": seed, **_about(ready), **facts(), **figures})


def run_fit(name: str, start: str, steps: int, seed: int, runs: Path) -> None:
    """Fit the new data of a case and store the errors on its test."""
    case, core = CASES[name], {min(os.sched_getaffinity(0))}
    ready = _ready(case, runs) if start == "init" else None
    with tempfile.TemporaryDirectory() as folder:
        write_split(case, seed, Path(folder))
        words = [f"skeleton={case.skeleton}", "data.train=fit.npz", "data.test=test.npz", *_COMMON]
        words += [f"trainer.max_steps={steps}", f"seed={seed}"]
        words += case.words if ready is None else [f"init={ready.absolute()}"]
        run_uplift("fit", words, Path(folder), core)
        run = Path(folder) / "runs" / case.skeleton / "last"
        found = json.loads((run / "evaluation.json").read_text())
        seconds = sum(json.loads((run / "run.json").read_text())["seconds"].values())
    command = shlex.join(["uplift fit", *words[:-1], f"init={case.ready}"] if ready else ["uplift fit", *words])
    result = {"command": command.replace("'uplift fit'", "uplift fit"), "seed": seed, "steps": steps, **facts()}
    result |= {"seconds": round(seconds, 1), "frames": found["frames"]} | (_about(ready) if ready else {})
    result |= {protocol: found["overall"][protocol] for protocol in _PROTOCOLS}
    store(RESULTS, f"{name}_{start}_{steps}_seed{seed}", result)


def _ready(case: Case, runs: Path) -> Path:
    """Return the run of the ready lifter, trained first where it is not there."""
    folder = runs / case.ready
    if not (found := sorted(folder.glob("runs/*/last/lifter.pt"))):
        folder.mkdir(parents=True, exist_ok=True)
        root = f"data.root={data_folder() / case.ready_fit[0].removeprefix('task=')}"
        run_uplift("fit", [*case.ready_fit, root], folder, {min(os.sched_getaffinity(0))})
        found = sorted(folder.glob("runs/*/last/lifter.pt"))
    return found[0].parent


def _about(ready: Path) -> dict[str, Any]:
    known = json.loads((ready / "run.json").read_text())
    return {"ready": known["command"], "ready_commit": known["git"]["commit"][:7]}


if __name__ == "__main__":
    sys.exit(main())
