"""What one fresh process measures: ``load FOLDER`` or ``train FOLDER``; prints JSON."""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.loading.files import settings_of
from uplift.data.load import load_data
from uplift.data.poses import PoseData
from uplift.skeleton import load_skeleton

if TYPE_CHECKING:  # loading is measured without what training imports
    from uplift.training.base import TrainingModule

__all__ = ["SMALL", "load", "train"]

SMALL = 20_000
"""Frames of the small set: its arrays are still larger than the CPU's caches."""
_WARM_UP, _STEPS, _TURNS = 16, 32, 8  # a student makes 16 batches at once

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
    from uplift.data.module import KeypointData

    start = time.perf_counter()
    frames = KeypointData.of(loaded, skeleton, settings).frames(settings.lifter)
    return {
        **found,
        "training_set_s": time.perf_counter() - start,
        "training_frames": len(frames),
        "peak_gb": _peak_gb(),
    }


def _bytes(data: PoseData) -> int:
    arrays = [getattr(data, name) for name in _ARRAYS]
    return sum(array.nbytes for array in (*arrays, *data.identity.values()) if hasattr(array, "nbytes"))


def _peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def train(folder: str | Path) -> dict[str, Any]:
    """Return the steps per second of teacher and student on each set, on one thread, and their median ratio."""
    import torch

    from benchmarks.stepping import student, teacher, untrained_poses
    from uplift.data.module import KeypointData

    torch.set_num_threads(1)
    settings = settings_of(folder, "priors.flow.steps=20")
    skeleton = load_skeleton(settings.skeleton)
    loaded = load_data(settings, skeleton)
    full = KeypointData.of(loaded, skeleton, settings).frames(settings.lifter)
    small = full.select(torch.arange(min(SMALL, len(full))))
    found: dict[str, Any] = {"threads": 1, "frames": len(full), "small_frames": len(small)}
    found["teacher"] = _compare(teacher(settings, full), teacher(settings, small), settings.teacher.batch_size)
    poses = [untrained_poses(settings, frames) for frames in (full, small)]
    found["student"] = _compare(*(student(settings, of) for of in poses), settings.student.batch_size)
    found["student"]["frames"] = len(poses[0])
    return found


def _compare(large: TrainingModule, small: TrainingModule, batch_size: int) -> dict[str, float]:
    """Return the speed on both sets; they alternate, so that other load on the machine slows both equally."""
    from benchmarks.stepping import stepper

    runs = [stepper(large, batch_size), stepper(small, batch_size)]
    for run in runs:
        run(_WARM_UP)
    seconds = np.empty((_TURNS, 2))
    for turn in range(_TURNS):
        for which in (0, 1) if turn % 2 else (1, 0):
            seconds[turn, which] = runs[which](_STEPS)
    return {
        "steps_per_s": float(_STEPS / np.median(seconds[:, 0])),
        "small_steps_per_s": float(_STEPS / np.median(seconds[:, 1])),
        "ratio": float(np.median(seconds[:, 1] / seconds[:, 0])),
    }


def main() -> int:
    """Print what was measured as JSON."""
    what, folder = sys.argv[1:]
    found = {**train(folder), "peak_gb": _peak_gb()} if what == "train" else load(folder)
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
