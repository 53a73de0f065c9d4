"""The lifters that the score is tried on: families of short fits that differ, and one of each family distorted."""

from __future__ import annotations

import dataclasses
import os
import shlex
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from benchmarks.common import ROOT, data_folder, facts, run_uplift, store, stored
from benchmarks.score_2d.candidates import candidates
from benchmarks.score_2d.distorted import CHANGES, Distorted
from uplift.data.load import load_file
from uplift.data.poses import PoseData
from uplift.metrics.evaluate import evaluate
from uplift.metrics.score_2d import score_2d
from uplift.models.lifter import Lifter
from uplift.models.model import Model, load_poses

__all__ = ["ERRORS", "RESULTS", "Family", "families", "run_family"]

RESULTS = ROOT / "benchmarks" / "results" / "score_2d.json"
ERRORS = ("p_mpjpe", "n_mpjpe", "mpjpe_gt_scale")
"""The errors against the truth that the score should order lifters as."""

_FITS = Path(__file__).resolve().parent / "fits.yaml"
_ALSO = ("facing", "facing_sign")
_FEWER = (100, 500)


@dataclass(frozen=True)
class Family:
    """Lifters of one skeleton and the frames they are compared on."""

    name: str
    test: str
    common: str
    fits: dict[str, str]
    distort: str
    """The fit that is distorted."""
    frames: int = 2000


def families() -> dict[str, Family]:
    """Return the families by name."""
    return {name: Family(name, **spec) for name, spec in yaml.safe_load(_FITS.read_text()).items()}


def run_family(family: Family, runs: Path) -> None:
    """Fit what ``runs`` does not hold yet, measure what is not stored yet, and store it.

    Raises:
        BenchmarkError: UPLIFT_DATA is not set, or a fit failed.
    """
    data = None
    for fit, words in family.fits.items():
        names = [fit] if fit != family.distort else [fit, *(f"{fit}, {name}" for name in ("untrained", *CHANGES))]
        if all(f"{family.name}/{name}" in stored(RESULTS) for name in names):
            continue
        print(f"run {family.name}/{fit}", flush=True)
        model = load_poses(_run_of(family, fit, words, runs / family.name / fit))
        data = _frames(family, model) if data is None else data
        for name, changed in _lifters(model, data, names):
            store(RESULTS, f"{family.name}/{name}", _measured(changed, data) | _about(family, words))


def _run_of(family: Family, fit: str, words: str, folder: Path) -> Path:
    """Return the folder of a fit, which is made if it is not there."""
    found = sorted(folder.glob("runs/*/last/lifter.pt"))
    if not found:
        folder.mkdir(parents=True, exist_ok=True)
        run_uplift("fit", shlex.split(f"{family.common} {words}"), folder, {min(os.sched_getaffinity(0))})
        found = sorted(folder.glob("runs/*/last/lifter.pt"))
    return found[0].parent


def _frames(family: Family, model: Model) -> PoseData:
    data = load_file(data_folder() / family.test, model.skeleton)
    return data.select(np.sort(np.random.default_rng(0).permutation(len(data))[: family.frames]))


def _lifters(model: Model, data: PoseData, names: list[str]) -> Iterator[tuple[str, Model]]:
    """Yield the model, and under each name "FIT, CHANGE" a changed one."""
    for name in names:
        change = name.partition(", ")[2]
        if not change:
            yield name, model
        elif change == "untrained":
            torch.manual_seed(0)
            yield name, dataclasses.replace(model, lifter=Lifter(model.skeleton, model.settings).eval())
        else:
            yield name, dataclasses.replace(model, lifter=Distorted(model, CHANGES[change]))


def _measured(model: Model, data: PoseData) -> dict[str, Any]:
    """Return errors against the truth of single frames, and all figures without it."""
    found = evaluate(model.predict(data, refine=False), data, model.skeleton).overall
    start = time.monotonic()
    score = score_2d(model, data)
    seconds = time.monotonic() - start
    fewer = {f"score_2d of {most} frames": score_2d(model, data, most=most)["score_2d"] for most in _FEWER}
    return {
        "errors": {name: float(found[name]) for name in (*ERRORS, *_ALSO) if name in found},
        "score": score,
        "candidates": {**candidates(model, data), **fewer},
        "seconds": round(seconds, 2),
    }


def _about(family: Family, words: str) -> dict[str, Any]:
    return {"command": f"uplift fit {family.common} {words}", "test": family.test, "frames": family.frames, **facts()}
