"""Measure speed as ratios within one run, since absolute times depend on the machine."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.common import ROOT, facts, write_json
from benchmarks.stepping import stepper, student, teacher, untrained_poses
from uplift.config.loading import load_settings
from uplift.config.settings import LifterSettings, TrainerSettings
from uplift.data.module import KeypointData
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.data.tensors import TrainingSet
from uplift.models.lifter import Lifter
from uplift.models.model import Model
from uplift.skeleton import load_skeleton
from uplift.training.base import TrainingModule
from uplift.training.lifting import LiftingModule
from uplift.training.stages import StageBudget, run_stage
from uplift.training.student import StudentModule, student_settings

_ROUNDS, _WARM_UP = 3, 16


def main() -> int:
    """Measure everything, print it and write benchmarks/results/speed.json."""
    skeleton = load_skeleton("h36m17")
    data = simulate(skeleton, 20_000, seed=0)
    rows: dict[str, object] = {}
    for task in ("kudo2018_code", "default"):
        for batch in (16, 1024):
            rows[f"train {task}, batch {batch}"] = training(task, batch, data)
    rows["predict, default student, single frames"] = prediction(data, refine=False)
    rows["predict, default student, clips mended"] = prediction(data, refine=True)
    rows["command line"] = command_line()
    rows["a million poses"] = million(data)
    result = {"command": "python -m benchmarks.speed", **facts(), "threads": torch.get_num_threads(), "rows": rows}
    path = ROOT / "benchmarks" / "results" / "speed.json"
    write_json(path, result)
    print(json.dumps(rows, indent=1))
    print(f"wrote {path}")
    return 0


def peak() -> float:
    """Return the peak rate of matrix products on all threads, FLOP/s: the best of many products of two sizes."""
    best = 0.0
    for size in (1024, 2048):
        left, right = torch.randn(size, size), torch.randn(size, size)
        for _ in range(6):
            start = time.perf_counter()
            torch.mm(left, right)
            best = max(best, 2 * size**3 / (time.perf_counter() - start))
    return best


def training(task: str, batch: int, data: PoseData) -> dict[str, object]:
    """Return the speed of a training step relative to the peak, and the overhead of Lightning."""
    found: dict[str, object] = {"teacher": _steps(lambda: _teacher(task, batch, data), batch)}
    if task == "default":
        found["student"] = _steps(lambda: _student(batch, data), batch)
    return found


def _steps(make: Callable[[], TrainingModule], batch: int) -> dict[str, float]:
    flops = _flops(make(), batch)
    count = 100 if batch < 100 else 10
    ratios, overheads, with_trainer = [], [], []
    for _ in range(_ROUNDS):
        top = peak()
        run = stepper(make(), batch)
        run(_WARM_UP)
        bare = run(count) / count
        seconds = _trainer_loop(make(), batch, count)
        ratios.append(flops / seconds / top)
        overheads.append(seconds / bare - 1)
        with_trainer.append(seconds)
    return {
        "of_peak": float(np.median(ratios)),
        "trainer_overhead": float(np.median(overheads)),
        "ms_per_step": 1e3 * float(np.median(with_trainer)),
        "mflop_per_step": flops / 1e6,
    }


def _flops(module: TrainingModule, batch: int) -> float:
    """Return the matrix-product FLOPs of one step, forward and backward."""
    stepper(module, batch)(1)
    with FlopCounterMode(display=False) as counter:
        module.objective(batch)[0].backward()
    return float(counter.get_total_flops())


def _trainer_loop(module: TrainingModule, batch: int, count: int) -> float:
    """Return seconds per step of a complete stage: Lightning, progress, metrics."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "checkpoints").mkdir()
        settings = TrainerSettings(checkpoint_every=1e9)
        # The module has its frames: of these data, which are small, only the batch size counts.
        skeleton = load_skeleton("h36m17")
        data = KeypointData(simulate(skeleton, 100, seed=0), skeleton, val=None, batch_size=batch)
        data.endless = True
        marks: list[float] = []
        hook = module.on_train_batch_end

        def mark(*words: object) -> None:
            hook(*words)  # type: ignore[arg-type]
            marks.append(time.perf_counter())

        module.on_train_batch_end = mark  # type: ignore[method-assign]
        with open(os.devnull, "w") as null, contextlib.redirect_stderr(null):
            run_stage("bench", module, data, settings, StageBudget(_WARM_UP + count, None), Path(folder))
    return (marks[-1] - marks[_WARM_UP - 1]) / count


def _training_set(data: PoseData, count_root: bool) -> TrainingSet:
    return TrainingSet.of(data, load_skeleton("h36m17"), count_root=count_root)


def _teacher(task: str, batch: int, data: PoseData) -> LiftingModule:
    settings = load_settings(task, [f"teacher.batch_size={batch}", "skeleton=h36m17"])
    if "flow" in settings.priors:
        settings.priors["flow"]["steps"] = 20
    return teacher(settings, _training_set(data, settings.views.count_root))


def _student(batch: int, data: PoseData) -> StudentModule:
    settings = load_settings(None, [f"student.batch_size={batch}", "skeleton=h36m17"])
    return student(settings, untrained_poses(settings, _training_set(data, settings.views.count_root)))


def _model() -> Model:
    settings = load_settings(None, ["skeleton=h36m17"])
    chosen: LifterSettings = student_settings(settings, last=True)
    skeleton = load_skeleton("h36m17")
    return Model(Lifter(skeleton, chosen).eval(), skeleton, chosen)


def prediction(data: PoseData, *, refine: bool) -> dict[str, float]:
    """Return poses per second of `Model.predict`, and the rate of its matrix products relative to the peak."""
    model = _model()
    many = data.select(np.arange(100_000) % len(data))
    with FlopCounterMode(display=False) as counter:
        model.predict(data.select(np.arange(1000)), refine=False)
    flops = counter.get_total_flops() / 1000
    rates, ratios = [], []
    for _ in range(_ROUNDS):
        top = peak()
        start = time.perf_counter()
        model.predict(many, refine=refine)
        rate = len(many) / (time.perf_counter() - start)
        rates.append(rate)
        ratios.append(rate * flops / top)
    return {"poses_per_second": float(np.median(rates)), "of_peak": float(np.median(ratios))}


def command_line() -> dict[str, float]:
    """Return the seconds that ``uplift --help`` takes, and those from ``uplift fit`` to its first step."""
    helps = []
    for _ in range(_ROUNDS):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "uplift.cli.main", "--help"], check=True, capture_output=True)
        helps.append(time.perf_counter() - start)
    firsts = []
    for _ in range(3):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            words = ["fit", "task=demo", "data.simulate=5000", "trainer.max_steps=3", "trainer.max_time=null"]
            process = subprocess.Popen(
                [sys.executable, "-m", "uplift.cli.main", *words],
                cwd=folder,
                stderr=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
            )
            assert process.stderr is not None
            for line in process.stderr:
                if b"step 1 " in line:
                    firsts.append(time.perf_counter() - start)
                    break
            process.kill()
            process.wait()
    return {"help_s": float(np.median(helps)), "fit_to_first_step_s": float(np.median(firsts))}


def million(data: PoseData) -> dict[str, float]:
    """Return the memory of a million poses: their arrays, the training set on top, and the peak when predicting."""
    before = _resident()
    many = data.select(np.arange(1_000_000) % len(data))
    arrays = _resident()
    training_set = _training_set(many, False)
    after = _resident()
    _model().predict(many, refine=False)
    top = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {
        "arrays_gb": (arrays - before) / 1e9,
        "training_set_gb": (after - arrays) / 1e9,
        "peak_predicting_gb": (top - before) / 1e9,
        "frames": float(len(training_set)),
    }


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


if __name__ == "__main__":
    sys.exit(main())
