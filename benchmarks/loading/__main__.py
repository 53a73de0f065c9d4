"""Measure loading and training of Human3.6M-shaped files of full size, written from simulated motion.

Each measurement is a fresh process. The first loads with an empty cache, the second from what the first kept.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.accuracy.show import Sheet, text
from benchmarks.h36m_files import FRAMES, write_full_size
from benchmarks.machine import ROOT, facts
from uplift.config.files import replacing

__all__ = ["LIMITS", "main", "measure", "sheet_of"]

RESULT = ROOT / "benchmarks" / "results" / "loading.json"
LIMITS = {"first load, s": 60.0, "load from the cache, s": 5.0, "peak memory, GB": 6.0}
"""What must hold at full size."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files, measure, print and keep the result; 1 where a limit does not hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loading", description=__doc__)
    parser.add_argument("--folder", type=Path, help="where the files go and stay; without it a temporary one")
    parser.add_argument("--frames", type=int, default=FRAMES, help=f"of motion capture at 50 Hz; {FRAMES:,} without it")
    parser.add_argument("--no-training", action="store_true", help="loading alone")
    parser.add_argument("--out", type=Path, default=RESULT, help="the JSON file of the result")
    given = parser.parse_args(arguments)
    if given.folder:
        found = measure(given.folder, given.frames, training=not given.no_training)
    else:
        with tempfile.TemporaryDirectory() as folder:
            found = measure(Path(folder), given.frames, training=not given.no_training)
    words = [f"--frames={given.frames}"] * (given.frames != FRAMES) + ["--no-training"] * given.no_training
    command = " ".join(["python -m benchmarks.loading", *words])
    given.out.parent.mkdir(parents=True, exist_ok=True)
    with replacing(given.out) as file:
        file.write((json.dumps({"command": command, **facts(), **found}, indent=1) + "\n").encode())
    print(text(sheet_of(found)))
    print(f"\nwrote {given.out}")
    return 0 if all(found["holds"].values()) else 1


def measure(folder: Path, frames: int, *, training: bool = True) -> dict[str, Any]:
    """Return what was found; the files are written where ``folder`` has none."""
    if not (folder / "data_3d_h36m.npz").is_file():
        print(f"writing {frames:,} frames seen by four cameras to {folder}", flush=True)
        write_full_size(folder, frames)
    files = {path.name: path.stat().st_size for path in sorted(folder.glob("*.npz"))}
    cache = folder / "cache"
    shutil.rmtree(cache, ignore_errors=True)
    try:
        first = _process("load", folder, cache)
        kept = sum(path.stat().st_size for path in cache.rglob("*") if path.is_file())
        second = _process("load", folder, cache)
        trained = _process("train", folder, cache) if training else {}
    finally:
        shutil.rmtree(cache, ignore_errors=True)
    peak = max(first["load_peak_gb"], second["load_peak_gb"])
    values = dict(zip(LIMITS, (first["load_s"], second["load_s"], peak), strict=True))
    return {
        "views": first["frames"],
        "file_bytes": files,
        "cache_bytes": kept,
        "first": first,
        "from_cache": second,
        "training": trained,
        "holds": {f"{name} < {limit:g}": values[name] < limit for name, limit in LIMITS.items()},
    }


def _process(what: str, folder: Path, cache: Path) -> dict[str, Any]:
    """Return what a fresh process measured."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path, "UPLIFT_CACHE": str(cache)}
    print(f"{what} ...", flush=True)
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.loading.measure", what, str(folder)],
        env=environment, stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    return json.loads(done.stdout.splitlines()[-1])


def sheet_of(found: dict[str, Any]) -> Sheet:
    """Return the table that is printed."""
    first, second, trained = found["first"], found["from_cache"], found["training"]
    rows = [
        ["load, s", f"{first['load_s']:.1f}", f"{second['load_s']:.1f}"],
        ["of it the processor, s", f"{first['load_cpu_s']:.1f}", f"{second['load_cpu_s']:.1f}"],
        ["peak memory of loading, GB", f"{first['load_peak_gb']:.2f}", f"{second['load_peak_gb']:.2f}"],
        ["its arrays, GB", f"{first['arrays_gb']:.2f}", f"{second['arrays_gb']:.2f}"],
        ["training set, s", f"{first['training_set_s']:.1f}", f"{second['training_set_s']:.1f}"],
        ["peak memory with it, GB", f"{first['peak_gb']:.2f}", f"{second['peak_gb']:.2f}"],
    ]
    for stage in ("teacher", "student"):
        if stage in trained:
            of = trained[stage]
            speed = f"{of['steps_per_s']:.1f} / {of['small_steps_per_s']:.1f} = {of['ratio']:.2f}"
            rows.append([f"{stage}, steps/s, all / {trained['small_frames']:,} frames", "", speed])
    if trained:
        rows.append(["peak memory of training, GB", "", f"{trained['peak_gb']:.2f}"])
    rows += [[name, "", "yes" if holds else "NO"] for name, holds in found["holds"].items()]
    return Sheet(f"{found['views']:,} views of Human3.6M's shape", ["", "first time", "from the cache"], rows)


if __name__ == "__main__":
    sys.exit(main())
