"""Lift animals with missing joints, with and without the mask prior, and compare the errors per joint.

Needs UPLIFT_DATA with the folders quadruped and animal_meshes. Keypoints and masks are those of the same posed
meshes; Cow and ShibaInu are not in the training frames. Each fit has a fixed number of steps on one core, half of
them for the teacher; results stored in benchmarks/results/quadruped_masks.json are not computed again.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import tempfile
import time
from collections.abc import Sequence
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
    run_missing,
    run_uplift,
    store,
    stored,
    table_parser,
    text,
)  # fmt: skip
from benchmarks.quadruped_masks.files import hidden_joints, rendered_frames, write_case

__all__ = ["KINDS", "RESULTS", "errors_of", "main", "run_case"]

RESULTS = ROOT / "benchmarks" / "results" / "quadruped_masks.json"
KINDS = {
    "keypoints": [],
    "masks": ["priors.mask.weight=7.5"],
    "hidden": ["teacher.hide=0.2", "priors.fill.weight=5"],
    "hidden_masks": ["teacher.hide=0.2", "priors.fill.weight=5", "priors.mask.weight=7.5"],
}
"""The settings that each kind of fit adds to the task."""
COMMON = [
    "data.train=train.npz", "teacher.share=1", "student.share=1", "teacher.batch_size=128", "student.batch_size=256",
    "priors.flow.steps=500",
]  # fmt: skip
_SEEDS = {"train": 1, "test": 2}
PROTOCOLS = ("n_mpjpe", "p_mpjpe")
_HEAD = ["missing", "fit", "seeds", "stage", "frames", "n seen", "n missing", "p seen", "p missing"]
_FIGURES = ("n_mpjpe_seen", "n_mpjpe_missing", "p_mpjpe_seen", "p_mpjpe_missing")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not stored yet and print the table; 1 if a fit failed."""
    given = _parser().parse_args(arguments)
    core = {max(os.sched_getaffinity(0))}
    jobs = {
        _key(kind, share, given.steps, seed): partial(run_case, kind, share, given.steps, seed, given.cache, core)
        for share in given.missing
        for seed in given.seeds
        for kind in given.kinds
    }
    failed = 0 if given.print else run_missing(RESULTS, jobs)
    results = stored(RESULTS)
    rows = [row for m in given.missing for k in given.kinds for row in _rows(k, m, given.steps, given.seeds, results)]
    print((markdown if given.markdown else text)(Sheet("quadruped_masks", _HEAD, rows)), flush=True)
    return 1 if failed else 0


def _parser() -> argparse.ArgumentParser:
    cache = Path(os.environ.get("UPLIFT_BENCHMARK_CACHE") or "~/.cache/uplift").expanduser() / "quadruped_masks"
    parser = table_parser("quadruped_masks", __doc__)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=["keypoints", "masks"], help="kinds of fits")
    parser.add_argument("--missing", nargs="+", type=float, default=[0.4, 0.2, 0.0], help="fractions of the joints")
    parser.add_argument("--steps", type=int, default=800, help="steps of each fit, default 800")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1], metavar="N", help="default 0 1")
    parser.add_argument("--cache", type=Path, default=cache, help="folder for rendered masks; default: "
                        "UPLIFT_BENCHMARK_CACHE or ~/.cache/uplift")  # fmt: skip
    return parser


def _key(kind: str, share: float, steps: int, seed: int) -> str:
    return f"{kind}_{100 * share:g}%_{steps}steps_seed{seed}"


def _rows(
    kind: str, share: float, steps: int, seeds: Sequence[int], results: dict[str, dict[str, Any]]
) -> list[list[str]]:
    """Return the rows of one kind of fit, means over the stored seeds."""
    found = [results[key]["errors"] for seed in seeds if (key := _key(kind, share, steps, seed)) in results]
    rows = []
    for stage in ("teacher", "student") if found else ():
        for split in _SEEDS:
            values = [[one[stage][split].get(figure) for one in found] for figure in _FIGURES]
            means = ["" if None in of else f"{sum(of) / len(of):.0f}" for of in values]
            rows.append([f"{100 * share:g}%", kind, str(len(found)), stage, split, *means])
    return rows


def run_case(kind: str, share: float, steps: int, seed: int, cache: Path, cores: set[int]) -> dict[str, Any]:
    """Fit, score and store one case.

    Raises:
        BenchmarkError: UPLIFT_DATA is not set, or the fit failed.
    """
    root = data_folder()
    with tempfile.TemporaryDirectory() as temporary:
        folder, files = Path(temporary), {}
        for split, number in _SEEDS.items():
            frames = rendered_frames(root, split, cache)
            names = tuple(str(name) for name in frames.arrays["joint_names"])
            hidden = hidden_joints(names, len(frames), share, number)
            files[split] = folder / f"{split}.npz"
            write_case(files[split], frames.arrays, hidden, masks=split == "train")
        words = [
            "task=quadruped", "data.root=.", "data.test=null", "trainer.max_time=null", f"trainer.max_steps={steps}",
            "trainer.threads=1", f"seed={seed}", *COMMON, *KINDS[kind],
        ]  # fmt: skip
        start = time.monotonic()
        run_uplift("fit", words, folder, cores)
        found = {
            "command": " ".join(["uplift fit", *words]),
            "benchmark": f"python -m benchmarks.quadruped_masks --kinds {kind} --missing {share:g} --steps {steps} --seeds {seed}",
            "seed": seed,
            "missing": share,
            **facts(),
            "wall_seconds": round(time.monotonic() - start, 1),
            "errors": _scores((folder / "runs" / "quadruped" / "last").resolve(), files),
        }
    store(RESULTS, _key(kind, share, steps, seed), found)
    return found


def _scores(run: Path, files: dict[str, Path]) -> dict[str, Any]:
    """Return the errors of the run's teacher and last student on each of ``files``, which have the poses of all joints."""
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
    """Return each protocol's mean error over visible and over missing joints, after aligning complete poses."""
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
    import torch

    from uplift.config.files import read_torch
    from uplift.config.run import RunFolder
    from uplift.models.lifter import Lifter

    of_teacher = {"uncertainty": False, "denoise": False, "signs": 0, "cameras": "own"}
    settings = dataclasses.replace(RunFolder.open(str(run)).settings().lifter, **of_teacher)
    lifter = Lifter(model.skeleton, settings)
    state = read_torch(run / "checkpoints" / "teacher.ckpt", "checkpoint")["state_dict"]
    prefix = "averaged.module."
    with torch.no_grad():
        lifter.load_state_dict({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
    return dataclasses.replace(model, lifter=lifter.eval(), settings=settings)


if __name__ == "__main__":
    sys.exit(main())
