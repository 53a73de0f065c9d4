"""What one fresh process finds: ``load FOLDER`` loads the set once, ``train FOLDER`` trains on it and on a small one."""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from uplift.config.loading import load_settings
from uplift.config.settings import Settings
from uplift.data.load import load_data
from uplift.data.poses import PoseData
from uplift.skeleton import load_skeleton

__all__ = ["load", "settings_of"]

_ARRAYS = ("keypoints", "confidence", "pose", "root", "tilt_deg", "root_filled", "lens")


def settings_of(folder: str | Path, *more: str) -> Settings:
    """Return the settings of a fit of Human3.6M at its full rate, with its files in ``folder``."""
    return load_settings("h36m", ["data.options.fps=50", f"data.root={folder}", *more])


def load(folder: str | Path) -> dict[str, Any]:
    """Return the seconds and the peak memory of loading and of making the training set; memory is this process'."""
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
    what, folder = sys.argv[1:3]
    if what == "train":
        from benchmarks.loading.training import train

        found = {**train(folder), "peak_gb": _peak_gb()}
    else:
        found = load(folder)
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
