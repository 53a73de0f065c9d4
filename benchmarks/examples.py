"""Train the files of docs/examples.md on real data, and compare with flat depth.

Needs UPLIFT_DATA with the folders quadruped, rat, hand and chair. Each fit runs on one core; results stored in
benchmarks/results/examples.json are not computed again.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.common import (
    ROOT,
    Sheet,
    data_folder,
    facts,
    markdown,
    max_time,
    run_missing,
    run_uplift,
    store,
    stored,
    table_parser,
    text,
)  # fmt: skip

__all__ = ["EXAMPLES", "PAGE", "RESULTS", "files_of", "main", "run_example", "write_files"]

PAGE = ROOT / "docs" / "examples.md"
RESULTS = ROOT / "benchmarks" / "results" / "examples.json"

EXAMPLES = ("quadruped", "rat", "hand", "chair")
"""Folders of UPLIFT_DATA; the files of each are `my_NAME.yaml` and `my_NAME_task.yaml`."""

_FILE = re.compile(r"^```yaml\n(# (\w+\.yaml)\n.*?)^```$", re.M | re.S)
_HEAD = ["example", "trained", "seeds", "n_mpjpe", "flat depth", "ratio", "p_mpjpe", "facing"]
_FIGURES = ("n_mpjpe", "flat_n_mpjpe", "ratio", "p_mpjpe", "facing")
_PROTOCOLS = ("n_mpjpe", "p_mpjpe", "mpjpe_gt_scale", "facing", "facing_sign")
_MOST_SUBJECTS = 20
"""Errors per subject are not stored if there are more."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not stored yet and print the table; 1 if a fit failed."""
    given = _parser().parse_args(arguments)
    core = {min(os.sched_getaffinity(0))}
    names = given.only or EXAMPLES
    jobs = {
        _key(name, given.minutes, seed): partial(run_example, name, given.minutes, seed, core)
        for seed in given.seeds
        for name in names
    }
    failed = 0 if given.print else run_missing(RESULTS, jobs)
    results = stored(RESULTS)
    rows = [row for name in names if (row := _row(name, given.minutes, given.seeds, results))]
    print((markdown if given.markdown else text)(Sheet("examples", _HEAD, rows)), flush=True)
    return 1 if failed else 0


def _parser() -> argparse.ArgumentParser:
    parser = table_parser("examples", __doc__)
    parser.add_argument("--only", nargs="+", choices=EXAMPLES, metavar="NAME", help=f"any of {', '.join(EXAMPLES)}")
    parser.add_argument("--minutes", type=float, default=2.0, help="training time, default 2")
    parser.add_argument("--seeds", type=_seeds, default=[0], metavar="N,N,...", help="default 0")
    return parser


def _seeds(text: str) -> list[int]:
    return [int(part) for part in text.split(",")]


def _key(name: str, minutes: float, seed: int) -> str:
    return f"{name}_{minutes:g}min_seed{seed}"


def _row(name: str, minutes: float, seeds: Sequence[int], results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a row of the table, means over the stored seeds; empty if there are none."""
    found = [results[key] for seed in seeds if (key := _key(name, minutes, seed)) in results]
    if not found:
        return []
    means = [sum(float(result[figure]) for result in found) / len(found) for figure in _FIGURES]
    return [name, f"{minutes:g}min", str(len(found)), *(f"{mean:.3f}" for mean in means)]


def files_of(page: Path = PAGE) -> dict[str, str]:
    """Return the page's files by name: its YAML blocks whose first line is ``# NAME.yaml``."""
    return {name: text for text, name in _FILE.findall(page.read_text())}


def write_files(name: str, folder: Path) -> Path:
    """Write the skeleton and the task of an example into ``folder``; return the task's path."""
    files = files_of()
    for file in (f"my_{name}.yaml", f"my_{name}_task.yaml"):
        (folder / file).write_text(files[file])
    return folder / f"my_{name}_task.yaml"


def run_example(name: str, minutes: float, seed: int, cores: set[int], more: Sequence[str] = ()) -> dict[str, Any]:
    """Fit an example on ``cores``, with ``more`` settings; store and return the result.

    Raises:
        BenchmarkError: UPLIFT_DATA is not set, or a command failed.
    """
    data = data_folder() / name
    with tempfile.TemporaryDirectory() as folder:
        task = write_files(name, Path(folder)).name
        words = [f"task={task}", f"data.root={data}", max_time(minutes), f"seed={seed}", *more]
        start = time.monotonic()
        run_uplift("fit", words, Path(folder), cores)
        wall = round(time.monotonic() - start, 1)
        run = Path(folder) / "runs" / Path(task).stem / "last"
        run_uplift("evaluate", [f"run={run}"], Path(folder), cores)
        found = json.loads((run / "evaluation.json").read_text())
        flat = _flat_depth_error(Path(folder) / f"my_{name}.yaml", data / "test.npz")
    subjects = {subject: values["n_mpjpe"] for subject, values in found["per_subject"].items()}
    words[1] = f"data.root=$UPLIFT_DATA/{name}"
    result = {
        "commands": [" ".join(["uplift fit", *words]), f"uplift evaluate run=runs/my_{name}_task/last"],
        "seed": seed,
        "minutes": minutes,
        **facts(),
        "wall_seconds": wall,
        "unit": found["unit"],
        "frames": found["frames"],
        **{protocol: found["overall"][protocol] for protocol in _PROTOCOLS if protocol in found["overall"]},
        "flat_n_mpjpe": flat,
        "ratio": found["overall"]["n_mpjpe"] / flat,
        "subjects": subjects if len(subjects) <= _MOST_SUBJECTS else {},
    }
    store(RESULTS, _key(name, minutes, seed), result)
    return result


def _flat_depth_error(skeleton_file: Path, test_file: Path) -> float:
    """Return the `n_mpjpe` of the observed 2D with every depth 0."""
    from uplift.data.clean import clean
    from uplift.data.load import load_file
    from uplift.metrics.baselines import flat_depth
    from uplift.metrics.evaluate import evaluate
    from uplift.metrics.scores import GivenPoses
    from uplift.skeleton import load_skeleton

    skeleton = load_skeleton(str(skeleton_file))
    test, _ = clean(load_file(test_file, skeleton), skeleton)
    poses = flat_depth(test.keypoints, skeleton.root_index)
    return evaluate(GivenPoses(poses, skeleton.joints), test, skeleton).overall["n_mpjpe"]


if __name__ == "__main__":
    sys.exit(main())
