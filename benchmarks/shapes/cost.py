"""Seconds and memory of a training step at one resolution; ``python -m benchmarks.shapes.cost 32`` prints them as JSON.

Each resolution is measured in a fresh process, so that its peak memory is its own.
"""

from __future__ import annotations

import contextlib
import json
import resource
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.common import facts, measure_apart
from benchmarks.shapes.fits import TASK
from uplift.config.loading import load_settings
from uplift.config.settings import Settings
from uplift.data.module import MaskDataModule
from uplift.errors import UserError
from uplift.training.base import plain_settings
from uplift.training.mixture import MixtureModule
from uplift.training.shapes import ShapeModule
from uplift.training.stages import StageBudget, run_stage

__all__ = ["RESOLUTIONS", "measure", "measured_apart"]

RESOLUTIONS = (16, 24, 32, 48, 64)
_MASKS = 400
_WARM_UP = 6
_GB = 1e9


def measured_apart(resolution: int, steps: int, threads: int | None = None) -> dict[str, Any]:
    """Return `measure` from a fresh process, with the command; raises BenchmarkError if it fails."""
    words = [str(resolution), str(steps), *([str(threads)] if threads else [])]
    found = measure_apart("benchmarks.shapes.cost", *words)
    return {"command": " ".join(["python -m benchmarks.shapes.cost", *words]), **facts(), **found}


def measure(resolution: int, steps: int, threads: int | None = None, task: str = TASK) -> dict[str, Any]:
    """Train for a few steps, then for ``steps`` more than these, and return the seconds per additional step.

    This excludes what a fit does once, whatever its number of steps; the peak memory includes it.
    """
    import torch

    from uplift.data.load_masks import load_masks

    words = [
        f"shape.resolution={resolution}",
        f"shape.detail={resolution}",
        f"shape.pixels={max(24, 3 * resolution // 4)}",
        f"data.simulate={_MASKS}",
        "trainer.max_time=null",
    ]
    words += [f"trainer.threads={threads}"] if threads else []
    settings = load_settings(task, [*words, f"trainer.max_steps={_WARM_UP}"])
    if settings.trainer.threads:
        torch.set_num_threads(settings.trainer.threads)
    before = _peak_bytes()
    data = MaskDataModule.of(load_masks(settings), settings)
    few, many = (_seconds(settings, data, count) for count in (_WARM_UP, _WARM_UP + steps))
    return {
        "resolution": resolution,
        "pixels": settings.shape.pixels,
        "steps": steps,
        "threads": torch.get_num_threads(),
        "batch": settings.teacher.batch_size,
        "masks": settings.data.simulate,
        "seconds_per_step": round((many - few) / steps, 4),
        "peak_gb": round(_peak_bytes() / _GB, 3),
        "peak_before_gb": round(before / _GB, 3),
    }


def _seconds(settings: Settings, data: MaskDataModule, steps: int) -> float:
    """Train the last stage for so many steps, and return the seconds of the trainer."""
    module = ShapeModule(
        MixtureModule(shape=asdict(settings.shape)), shape=asdict(settings.shape), **plain_settings(settings.teacher)
    )
    data.batch_size = settings.teacher.batch_size
    module.prepare(data)
    budget = StageBudget(steps, None)
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(sys.stderr):
        (Path(folder) / "checkpoints").mkdir()
        return run_stage("fine", module, data, settings.trainer, budget, Path(folder)).spent


def _peak_bytes() -> int:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024  # kilobytes on Linux


def main(words: Sequence[str]) -> int:
    """Measure and print; the arguments are resolution, steps and optionally threads."""
    try:
        resolution, steps, *threads = (int(word) for word in words)
        print(json.dumps(measure(resolution, steps, threads[0] if threads else None)))
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
