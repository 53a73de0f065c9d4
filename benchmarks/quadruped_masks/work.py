"""Fit one case and say how far off joints are that were seen, and joints that were missing."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.accuracy.work import CellFailed
from benchmarks.machine import ROOT

__all__ = ["errors_of", "fit_words", "run_fit", "scores"]

PROTOCOLS = ("n_mpjpe", "p_mpjpe")


def fit_words(steps: int, seed: int, more: Sequence[str]) -> list[str]:
    """Return the words of `uplift fit`; the frames are train.npz in the folder it runs in."""
    return [
        "task=quadruped", "data.root=.", "data.test=null", "trainer.max_time=null", f"trainer.max_steps={steps}",
        "trainer.threads=1", f"seed={seed}", *more,
    ]  # fmt: skip


def run_fit(folder: Path, words: Sequence[str], cores: set[int]) -> Path:
    """Run `uplift fit` in ``folder`` and return its run; raises CellFailed with the end of what it said."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-m", "uplift.cli.main", "fit", *words], cwd=folder, env=environment, capture_output=True, text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
    )  # fmt: skip
    if done.returncode:
        said = "\n".join((done.stdout + done.stderr).strip().splitlines()[-12:])
        raise CellFailed(f"uplift fit {' '.join(words)} ended with status {done.returncode}:\n{said}")
    return (folder / "runs" / "quadruped" / "last").resolve()


def scores(run: Path, files: dict[str, Path]) -> dict[str, Any]:
    """Return the errors of the run's teacher and of its last student on each of ``files``.

    Files hold poses of all joints, and confidence 0 where one is missing.
    """
    from uplift.data.load import load_file
    from uplift.models.model import load

    model = load(str(run))
    found: dict[str, Any] = {}
    for stage, of in (("teacher", _teacher(run, model)), ("student", model)):
        for name, path in files.items():
            data = load_file(path, model.skeleton)
            assert data.pose is not None
            pose = of.predict(data.without_truth(), refine=False).pose
            root = model.skeleton.root_index
            found.setdefault(stage, {})[name] = errors_of(pose, data.pose, data.confidence == 0, root)
    return found


def errors_of(pose: np.ndarray, truth: np.ndarray, missing: np.ndarray, root: int) -> dict[str, float]:
    """Return each protocol's mean error over seen and over missing joints; poses are aligned as wholes."""
    from uplift.metrics.pose_metrics import joint_errors

    found = {}
    for protocol in PROTOCOLS:
        errors = joint_errors(protocol, pose.astype(np.float64), truth.astype(np.float64), root)
        found[f"{protocol}_seen"] = float(errors[~missing].mean())
        if missing.any():
            found[f"{protocol}_missing"] = float(errors[missing].mean())
    return found


def _teacher(run: Path, model: Any) -> Any:
    """Return the model as it was after the first stage."""
    from uplift.config.files import read_torch
    from uplift.config.run import RunFolder
    from uplift.models.model import build_lifter

    settings = dataclasses.replace(RunFolder.open(str(run)).settings().lifter, spread=False, denoise=False)
    lifter = build_lifter(settings, model.skeleton)
    state = read_torch(run / "checkpoints" / "teacher.ckpt", "checkpoint")["state_dict"]
    prefix = "averaged.module."
    with torch.no_grad():
        lifter.load_state_dict({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
    return dataclasses.replace(model, lifter=lifter.eval(), settings=settings)
