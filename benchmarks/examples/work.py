"""Fit one example, evaluate it beside flat depth, and keep what was found."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.accuracy.floors import flat
from benchmarks.accuracy.work import CellFailed
from benchmarks.examples.files import write_files
from benchmarks.machine import ROOT, facts
from uplift.config.files import replacing

__all__ = ["RESULTS", "kept_results", "key_of", "run_example"]

RESULTS = ROOT / "benchmarks" / "results" / "examples.json"

_KEPT = ("n_mpjpe", "p_mpjpe", "mpjpe_gt_scale", "facing", "facing_sign")
_MOST_SUBJECTS = 20
"""More are shapes rather than somebody to name: their errors are not kept one by one."""


def key_of(name: str, minutes: float, seed: int) -> str:
    """Return what a fit's result is kept under."""
    return f"{name}_{minutes:g}min_seed{seed}"


def kept_results() -> dict[str, dict[str, Any]]:
    """Return the results that are there, by `key_of`."""
    return json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}


def run_example(name: str, minutes: float, seed: int, cores: set[int], more: Sequence[str] = ()) -> dict[str, Any]:
    """Fit an example on ``cores``, with ``more`` settings, keep its result and return it.

    Raises:
        CellFailed: UPLIFT_DATA is not set, or a command ended with an error.
    """
    root = os.environ.get("UPLIFT_DATA")
    if not root:
        raise CellFailed("UPLIFT_DATA is not set: it names the folder of the data sets")
    data = Path(root).resolve() / name
    seconds = round(60 * minutes)
    budget = f"trainer.max_time={seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
    with tempfile.TemporaryDirectory() as folder:
        task = write_files(name, Path(folder)).name
        words = [f"task={task}", f"data.root={data}", budget, f"seed={seed}", *more]
        start = time.monotonic()
        _uplift("fit", words, Path(folder), cores)
        wall = round(time.monotonic() - start, 1)
        run = Path(folder) / "runs" / Path(task).stem / "last"
        _uplift("evaluate", [f"run={run}"], Path(folder), cores)
        found = json.loads((run / "evaluation.json").read_text())
        floor = _flat_depth(Path(folder) / f"my_{name}.yaml", data / "test.npz")
    subjects = {who: values["n_mpjpe"] for who, values in found["per_subject"].items()}
    words[1] = f"data.root=$UPLIFT_DATA/{name}"
    result = {
        "commands": [" ".join(["uplift fit", *words]), f"uplift evaluate run=runs/my_{name}_task/last"],
        "seed": seed,
        "minutes": minutes,
        **facts(),
        "wall_seconds": wall,
        "unit": found["unit"],
        "frames": found["frames"],
        **{protocol: found["overall"][protocol] for protocol in _KEPT if protocol in found["overall"]},
        "flat_n_mpjpe": floor,
        "ratio": found["overall"]["n_mpjpe"] / floor,
        "subjects": subjects if len(subjects) <= _MOST_SUBJECTS else {},
    }
    _keep(key_of(name, minutes, seed), result)
    return result


def _flat_depth(skeleton_file: Path, test_file: Path) -> float:
    """Return the `n_mpjpe` of the observed 2D with every depth 0."""
    from uplift.data.clean import clean
    from uplift.data.load import load_file
    from uplift.metrics.evaluate import evaluate
    from uplift.metrics.scores import GivenPoses
    from uplift.skeleton import load_skeleton

    skeleton = load_skeleton(str(skeleton_file))
    test, _ = clean(load_file(test_file, skeleton), skeleton)
    return evaluate(GivenPoses(flat(test, skeleton), skeleton.joints), test, skeleton).overall["n_mpjpe"]


def _uplift(verb: str, words: Sequence[str], folder: Path, cores: set[int]) -> None:
    """Run a command in ``folder`` on ``cores``; raises CellFailed with the end of what it said."""
    environment = {**os.environ, "OMP_NUM_THREADS": str(len(cores))}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-m", "uplift.cli.main", verb, *words], cwd=folder, env=environment, capture_output=True, text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
    )  # fmt: skip
    if done.returncode:
        said = "\n".join((done.stdout + done.stderr).strip().splitlines()[-12:])
        raise CellFailed(f"uplift {verb} {' '.join(words)} ended with status {done.returncode}:\n{said}")


def _keep(key: str, result: dict[str, Any]) -> None:
    """Put a result beside those that are there."""
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    results = dict(sorted({**kept_results(), key: result}.items()))
    with replacing(RESULTS) as file:
        file.write((json.dumps(results, indent=1) + "\n").encode())
