"""Lift animals whose joints are partly missing, with and without the mask prior, and compare joint by joint.

Needs UPLIFT_DATA with the folders quadruped and animal_meshes. Keypoints and masks are those of the same
posed meshes; Cow and ShibaInu are in no training frame. Whole fits of a fixed number of steps on one
core, half of the steps for the teacher; what is kept in benchmarks/results/quadruped_masks.json is not
computed twice.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.accuracy.show import Sheet, markdown, text
from benchmarks.accuracy.work import CellFailed
from benchmarks.machine import ROOT, facts
from benchmarks.quadruped_masks.files import drawn_frames, hidden_joints, write_case
from benchmarks.quadruped_masks.work import fit_words, run_fit, scores
from uplift.config.files import replacing

__all__ = ["KINDS", "RESULTS", "kept_results", "key_of", "main", "run_case"]

RESULTS = ROOT / "benchmarks" / "results" / "quadruped_masks.json"
KINDS = {
    "keypoints": [],
    "masks": ["priors.mask.weight=7.5"],
    "hidden": ["teacher.hide=0.2", "priors.fill.weight=5"],
    "hidden_masks": ["teacher.hide=0.2", "priors.fill.weight=5", "priors.mask.weight=7.5"],
}
"""What is added to the task in each kind of fit."""
COMMON = [
    "data.train=train.npz", "teacher.share=1", "student.share=1", "teacher.batch_size=128", "student.batch_size=256",
    "priors.flow.steps=500",
]  # fmt: skip
_SEEDS = {"train": 1, "test": 2}
_HEAD = ["missing", "fit", "seeds", "stage", "frames", "n seen", "n missing", "p seen", "p missing"]
_FIGURES = ("n_mpjpe_seen", "n_mpjpe_missing", "p_mpjpe_seen", "p_mpjpe_missing")


def key_of(kind: str, share: float, steps: int, seed: int) -> str:
    """Return what a fit's result is kept under."""
    return f"{kind}_{100 * share:g}%_{steps}steps_seed{seed}"


def kept_results() -> dict[str, dict[str, Any]]:
    """Return the results that are there, by `key_of`."""
    return json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}


def run_case(kind: str, share: float, steps: int, seed: int, cache: Path, cores: set[int]) -> dict[str, Any]:
    """Fit, score and keep one case.

    Raises:
        CellFailed: UPLIFT_DATA is not set, or the fit ended with an error.
    """
    root = os.environ.get("UPLIFT_DATA")
    if not root:
        raise CellFailed("UPLIFT_DATA is not set: it names the folder of the data sets")
    with tempfile.TemporaryDirectory() as folder:
        files = {}
        for split, number in _SEEDS.items():
            frames = drawn_frames(Path(root), split, cache)
            names = tuple(str(name) for name in frames.arrays["joint_names"])
            files[split] = Path(folder) / f"{split}.npz"
            write_case(
                files[split], frames.arrays, hidden_joints(names, len(frames), share, number), masks=split == "train"
            )
        words = fit_words(steps, seed, [*COMMON, *KINDS[kind]])
        start = time.monotonic()
        run = run_fit(Path(folder), words, cores)
        found = {
            "command": " ".join(["uplift fit", *words]),
            "benchmark": f"python -m benchmarks.quadruped_masks --kinds {kind} --missing {share:g} --steps {steps} --seeds {seed}",
            "seed": seed,
            "missing": share,
            **facts(),
            "wall_seconds": round(time.monotonic() - start, 1),
            "errors": scores(run, files),
        }
    _keep(key_of(kind, share, steps, seed), found)
    return found


def _keep(key: str, result: dict[str, Any]) -> None:
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    with replacing(RESULTS) as file:
        file.write((json.dumps(dict(sorted({**kept_results(), key: result}.items())), indent=1) + "\n").encode())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not kept yet and print the table; 1 where a fit failed."""
    given = _parser().parse_args(arguments)
    core, failed = {max(os.sched_getaffinity(0))}, 0
    for share, seed, kind in ((m, s, k) for m in given.missing for s in given.seeds for k in given.kinds):
        key = key_of(kind, share, given.steps, seed)
        if given.print or key in kept_results():
            continue
        print(f"run {key}", flush=True)
        try:
            run_case(kind, share, given.steps, seed, given.cache, core)
        except CellFailed as error:
            print(f"\n{key}: {error}\n", file=sys.stderr, flush=True)
            failed += 1
    results = kept_results()
    rows = [row for m in given.missing for k in given.kinds for row in _rows(k, m, given.steps, given.seeds, results)]
    print((markdown if given.markdown else text)(Sheet("quadruped_masks", _HEAD, rows)), flush=True)
    return 1 if failed else 0


def _rows(
    kind: str, share: float, steps: int, seeds: Sequence[int], results: dict[str, dict[str, Any]]
) -> list[list[str]]:
    """Return the rows of one kind of fit, means over the seeds that are there; none where none is."""
    found = [results[key]["errors"] for seed in seeds if (key := key_of(kind, share, steps, seed)) in results]
    rows = []
    for stage in ("teacher", "student") if found else ():
        for split in _SEEDS:
            values = [[one[stage][split].get(figure) for one in found] for figure in _FIGURES]
            means = ["" if None in of else f"{sum(of) / len(of):.0f}" for of in values]
            rows.append([f"{100 * share:g}%", kind, str(len(found)), stage, split, *means])
    return rows


def _cache() -> Path:
    return Path(os.environ.get("UPLIFT_BENCHMARK_CACHE") or "~/.cache/uplift").expanduser() / "quadruped_masks"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.quadruped_masks", description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=["keypoints", "masks"], help="of fits")
    parser.add_argument("--missing", nargs="+", type=float, default=[0.4, 0.2, 0.0], help="shares of the joints")
    parser.add_argument("--steps", type=int, default=800, help="of each fit")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1], metavar="N", help="0 1 without it")
    parser.add_argument(
        "--cache",
        type=Path,
        default=_cache(),
        help="where drawn masks stay; UPLIFT_BENCHMARK_CACHE, else ~/.cache/uplift",
    )
    parser.add_argument("--print", action="store_true", help="print what is kept and run nothing")
    parser.add_argument("--markdown", action="store_true", help="print the table for a document")
    return parser


if __name__ == "__main__":
    sys.exit(main())
