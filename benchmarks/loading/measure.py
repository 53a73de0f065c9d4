"""What one fresh process measures: ``load FOLDER`` or ``train FOLDER``; prints JSON."""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.loading.files import settings_of
from uplift.data.load import load_data
from uplift.data.poses import PoseData
from uplift.skeleton import load_skeleton

__all__ = ["load"]

_ARRAYS = ("keypoints", "confidence", "pose", "root", "tilt_deg", "root_filled", "lens")


def load(folder: str | Path) -> dict[str, Any]:
    """Return the seconds and the peak memory of this process, of loading and of making the training set."""
    settings = settings_of(folder)
    skeleton = load_skeleton(settings.skeleton)
    start, before = time.perf_counter(), time.process_time()
    loaded = load_data(settings, skeleton)
    found: dict[str, Any] = {"load_s": time.perf_counter() - start, "load_cpu_s": time.process_time() - before}
    found["load_peak_gb"] = _peak_gb()
    parts = [part for part in (loaded.train, loaded.test) if part is not None]
    found |= {"frames": sum(map(len, parts)), "arrays_gb": sum(map(_bytes, parts)) / 1e9}
    from uplift.training.pose_recipe import training_frames

    start = time.perf_counter()
    frames = training_frames(loaded, skeleton, settings)
    return {
        **found,
        "training_set_s": time.perf_counter() - start,
        "training_frames": len(frames),
        "peak_gb": _peak_gb(),
    }


def _bytes(data: PoseData) -> int:
    arrays = [getattr(data, name) for name in _ARRAYS]
    return sum(array.nbytes for array in (*arrays, *data.identity.values()) if isinstance(array, np.ndarray))


def _peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def main() -> int:
    """Print what was measured as JSON."""
    what, folder = sys.argv[1:]
    if what == "train":
        from benchmarks.loading.training import train

        print(json.dumps({**train(folder), "peak_gb": _peak_gb()}))
    else:
        print(json.dumps(load(folder)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
