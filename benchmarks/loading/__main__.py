"""Measure loading and training of simulated files of Human3.6M's size.

Each measurement is a fresh process. The first loads with an empty cache, the second from the cache.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import ROOT, Sheet, facts, measure_apart, text, write_json
from benchmarks.loading.files import FRAMES, write_full_size

__all__ = ["LIMITS", "main", "measure", "sheet_of"]

RESULT = ROOT / "benchmarks" / "results" / "loading.json"
LIMITS = {"first load, s": 60.0, "load from the cache, s": 5.0, "peak memory, GB": 6.0}
"""Upper limits at full size."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files, measure, print and store the result; 1 if a limit is exceeded."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loading", description=__doc__)
    parser.add_argument("--folder", type=Path, help="keep the files here; default: a temporary folder")
    parser.add_argument(
        "--frames", type=int, default=FRAMES, help=f"motion capture frames at 50 Hz, default {FRAMES:,}"
    )
    parser.add_argument("--no-training", action="store_true", help="measure loading only")
    parser.add_argument("--out", type=Path, default=RESULT, help="JSON file for the result")
    given = parser.parse_args(arguments)
    if given.folder:
        found = measure(given.folder, given.frames, training=not given.no_training)
    else:
        with tempfile.TemporaryDirectory() as folder:
            found = measure(Path(folder), given.frames, training=not given.no_training)
    words = [f"--frames={given.frames}"] * (given.frames != FRAMES) + ["--no-training"] * given.no_training
    command = " ".join(["python -m benchmarks.loading", *words])
    write_json(given.out, {"command": command, **facts(), **found})
    print(text(sheet_of(found)))
    print(f"\nwrote {given.out}")
    return 0 if all(found["holds"].values()) else 1


def measure(folder: Path, frames: int, *, training: bool = True) -> dict[str, Any]:
    """Measure, after writing the files if ``folder`` has none."""
    if not (folder / "data_3d_h36m.npz").is_file():
        print(f"writing {frames:,} frames seen by four cameras to {folder}", flush=True)
        write_full_size(folder, frames)
    files = {path.name: path.stat().st_size for path in sorted(folder.glob("*.npz"))}
    cache = folder / "cache"
    shutil.rmtree(cache, ignore_errors=True)
    try:
        first = _process("load", folder, cache)
        cached = sum(path.stat().st_size for path in cache.rglob("*") if path.is_file())
        second = _process("load", folder, cache)
        trained = _process("train", folder, cache) if training else {}
    finally:
        shutil.rmtree(cache, ignore_errors=True)
    peak = max(first["load_peak_gb"], second["load_peak_gb"])
    values = dict(zip(LIMITS, (first["load_s"], second["load_s"], peak), strict=True))
    return {
        "views": first["frames"],
        "file_bytes": files,
        "cache_bytes": cached,
        "first": first,
        "from_cache": second,
        "training": trained,
        "holds": {f"{name} < {limit:g}": values[name] < limit for name, limit in LIMITS.items()},
    }


def _process(what: str, folder: Path, cache: Path) -> dict[str, Any]:
    print(f"{what} ...", flush=True)
    return measure_apart("benchmarks.loading.measure", what, folder, env={"UPLIFT_CACHE": str(cache)})


def sheet_of(found: dict[str, Any]) -> Sheet:
    """Return the result as a table."""
    first, second, trained = found["first"], found["from_cache"], found["training"]
    rows = [
        ["load, s", f"{first['load_s']:.1f}", f"{second['load_s']:.1f}"],
        ["CPU time of it, s", f"{first['load_cpu_s']:.1f}", f"{second['load_cpu_s']:.1f}"],
        ["peak memory of loading, GB", f"{first['load_peak_gb']:.2f}", f"{second['load_peak_gb']:.2f}"],
        ["arrays, GB", f"{first['arrays_gb']:.2f}", f"{second['arrays_gb']:.2f}"],
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
    return Sheet(f"{found['views']:,} views of Human3.6M's shape", ["", "first load", "from the cache"], rows)


if __name__ == "__main__":
    sys.exit(main())
