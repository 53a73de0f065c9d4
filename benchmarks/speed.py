"""Measure speed as shares of what the machine can do, since absolute times depend on the machine.

Every share is of the fastest float32 matrix product found in the same round, whatever library makes it; bfloat16 has its
own. Medians of several rounds of CPU seconds on one thread. ``--profile`` prints instead where the time of a part goes; ``--device
cuda`` measures steps, launches and poses on a GPU, and compares losses with the CPU's at equal steps.
"""

from __future__ import annotations

import argparse
import contextlib
import cProfile
import io
import json
import os
import pstats
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.common import ROOT, facts, measure_apart, write_json
from benchmarks.stepping import stepper, student, teacher, untrained_poses
from uplift.config.device import fast_products
from uplift.config.loading import load_settings
from uplift.config.settings import TrainerSettings
from uplift.data.load import read_files
from uplift.data.module import KeypointData
from uplift.data.poses import PoseData
from uplift.data.synthetic.simulate import simulate
from uplift.data.tensors import TrainingSet
from uplift.export import write
from uplift.metrics.evaluate import evaluate_model
from uplift.models.model import Model, load_poses
from uplift.skeleton import load_skeleton
from uplift.training.base import TrainingModule
from uplift.training.stages import StageBudget, run_stage

_RESULTS = ROOT / "benchmarks" / "results"
_ROUNDS, _WARM_UP = 5, 8
_SKELETON = "h36m17"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure everything that is asked for, print it and write benchmarks/results/speed.json."""
    given = _parser().parse_args(arguments)
    torch.set_num_threads(given.threads)
    if given.row:  # in a process of its own
        print(json.dumps(ROWS[given.row]()))
        return 0
    if given.profile is not None:
        for part in given.profile or PARTS:
            print(f"== {part}\n{PARTS[part]()}", flush=True)
        return 0
    path = _RESULTS / ("speed.json" if given.device == "cpu" else f"speed_{given.device}.json")
    table: dict[str, Callable[[], Any]] = {
        name: partial(measure_apart, "benchmarks.speed", "--row", name) for name in ROWS
    }
    wanted = table if given.device == "cpu" else _rows_of_device(given.device)
    kept = json.loads(path.read_text())["rows"] if given.only and path.is_file() else {}
    rows = {name: row for name, row in kept.items() if name in wanted}
    for name, measure in wanted.items():
        if not given.only or any(part in name for part in given.only):
            rows[name] = measure()
            print(f"{name}: {json.dumps(rows[name])}", flush=True)
    write_json(path, {"command": _command(given), **facts(), "threads": given.threads, "rows": rows})
    print(f"wrote {path.relative_to(ROOT)}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__)
    parser.add_argument("--device", default="cpu", help="cpu (default) or cuda")
    parser.add_argument("--threads", type=int, default=1, help="threads of matrix products, default 1")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="only rows whose name contains this")
    parser.add_argument("--profile", nargs="*", choices=PARTS, metavar="PART", help=f"of {', '.join(PARTS)}; or all")
    parser.add_argument("--row", choices=ROWS, help=argparse.SUPPRESS)
    return parser


def _command(given: argparse.Namespace) -> str:
    words = [f"--device {given.device}"] * (given.device != "cpu") + [f"--threads {given.threads}"] * (
        given.threads != 1
    )
    return " ".join(["python -m benchmarks.speed", *words])


# The fastest matrix product.


def peak(device: str = "cpu") -> dict[str, float]:
    """Return the best rate of matrix products by each way, in GFLOP/s, of the sizes and numbers tried."""
    ways = {"torch.mm": "highest", "torch.mm, medium": "medium"}
    rates = {name: _best_rate(device, torch.float32, way) for name, way in ways.items()}
    if device == "cpu":
        rates["numpy"] = _best_rate(device, None, "highest")
    return rates | {"bfloat16": _best_rate(device, torch.bfloat16, "highest")}


def _best_rate(device: str, dtype: torch.dtype | None, way: str, times: int = 8) -> float:
    best = 0.0
    with fast_products(way):
        for size in (512, 1024) if device == "cpu" else (4096, 8192):
            pair: Any = [torch.randn(size, size, device=device) for _ in range(2)]
            left, right = pair if dtype is None else (one.to(dtype) for one in pair)
            left, right = (left.numpy(), right.numpy()) if dtype is None else (left, right)
            for _ in range(times):
                best = max(best, 2 * size**3 / _seconds(lambda: left @ right, device))  # noqa: B023 (called at once)
    return best / 1e9


def _seconds(work: Callable[[], object], device: str = "cpu") -> float:
    """Return how long ``work`` takes: CPU seconds, as others may use the cores too, or those of a device's clock."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    wait = (lambda: None) if device == "cpu" else torch.cuda.synchronize
    wait()
    start = clock()
    work()
    wait()
    return clock() - start


def _honest(device: str = "cpu", precision: str = "32-true") -> float:
    """Return the peak in FLOP/s for products of that precision: float32 with float32's error, or bfloat16."""
    rates = peak(device)
    if precision != "32-true":
        return 1e9 * rates["bfloat16"]
    with fast_products("auto", training=device != "cpu"):
        exact = torch.get_float32_matmul_precision()
    return 1e9 * max(
        rate for name, rate in rates.items() if name != "bfloat16" and (exact != "highest" or "medium" not in name)
    )


# Training steps.


def _data(frames: int = 20_000) -> PoseData:
    return simulate(load_skeleton(_SKELETON), frames, seed=0)


def _training_set(data: PoseData, count_root: bool) -> TrainingSet:
    return TrainingSet.of(data, load_skeleton(_SKELETON), count_root=count_root)


def _module(stage: str, task: str | None, batch: int | None) -> tuple[TrainingModule, int]:
    """Return the training of a stage of a recipe, and its batch size: the recipe's own where none is given."""
    group = "teacher" if stage == "teacher" else "student"
    more = [f"{group}.batch_size={batch}"] if batch else []
    settings = load_settings(task, [f"skeleton={_SKELETON}", *more])
    if "flow" in settings.priors:
        settings.priors["flow"]["steps"] = 20
    frames = _training_set(_data(), settings.views.count_root)
    if stage == "teacher":
        return teacher(settings, frames), settings.teacher.batch_size
    return student(settings, untrained_poses(settings, frames), last=stage == "student_2"), settings.student.batch_size


def training(stage: str, task: str | None = None, batch: int | None = None, device: str = "cpu") -> dict[str, Any]:
    """Return the speed of a training step relative to the peak, by precision, and the overhead of Lightning."""
    found: dict[str, Any] = {}
    module, size = _module(stage, task, batch)
    flops = _flops(module, size)
    for precision in ("32-true", "bf16-mixed"):
        shares, seconds = [], []
        run = stepper(_module(stage, task, batch)[0].to(device), size, precision)
        run(_WARM_UP)
        for _ in range(_ROUNDS):
            top, count = _honest(device, precision), 20
            seconds.append(_seconds(lambda: run(count), device) / count)  # noqa: B023 (called at once)
            shares.append(flops / seconds[-1] / top)
        found[precision] = {"of_peak": float(np.median(shares)), "ms_per_step": 1e3 * float(np.median(seconds))}
    found |= {"batch": size, "mflop_per_step": flops / 1e6, "launches_per_step": _launches(module, size)}
    if device == "cpu":
        with_trainer = _trainer_loop(_module(stage, task, batch)[0], size, 20)
        found["trainer_overhead"] = 1e3 * with_trainer / found["32-true"]["ms_per_step"] - 1
    return found


def _flops(module: TrainingModule, batch: int) -> float:
    """Return the matrix-product FLOPs of one step, forward and backward."""
    stepper(module, batch)(1)
    with FlopCounterMode(display=False) as counter:
        module.objective(batch)[0].backward()
    return float(counter.get_total_flops())


def _launches(module: TrainingModule, batch: int) -> int:
    """Return how many operations a step hands to the device."""
    run = stepper(module, batch)
    run(_WARM_UP)
    with profile(activities=[ProfilerActivity.CPU]) as found:
        run(1)
    events = [event for event in found.events() or () if event.name.startswith("aten::") and not event.cpu_children]
    return sum(event.name.removeprefix("aten::") not in _NO_WORK for event in events)


_NO_WORK = frozenset(
    [
        "as_strided",
        "view",
        "_reshape_alias",
        "detach",
        "detach_",
        "empty",
        "empty_like",
        "empty_strided",
        "expand",
        "select",
        "slice",
        "transpose",
        "t",
        "unsqueeze",
        "squeeze",
        "permute",
        "alias",
        "resize_",
        "lift_fresh",
        "result_type",
        "resolve_conj",
        "resolve_neg",
        "_local_scalar_dense",
    ]
)
"""Operations that only look at memory in another way."""


def _trainer_loop(module: TrainingModule, batch: int, count: int) -> float:
    """Return seconds per step of a complete stage: Lightning, progress, metrics."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "checkpoints").mkdir()
        settings = TrainerSettings(checkpoint_every=1e9)
        # The module has its frames: of these data, which are small, only the batch size counts.
        skeleton = load_skeleton(_SKELETON)
        data = KeypointData(simulate(skeleton, 100, seed=0), skeleton, val=None, batch_size=batch)
        data.endless = True
        marks: list[float] = []
        hook = module.on_train_batch_end

        def mark(*words: object) -> None:
            hook(*words)  # type: ignore[arg-type]
            marks.append(time.process_time())

        module.on_train_batch_end = mark  # type: ignore[method-assign]
        with open(os.devnull, "w") as null, contextlib.redirect_stderr(null), fast_products(training=True):
            run_stage("bench", module, data, settings, StageBudget(_WARM_UP + count, None), Path(folder))
    return (marks[-1] - marks[_WARM_UP - 1]) / count


# Prediction, evaluation, files.


def _model(run: str = "person") -> Model:
    return load_poses(run)


def prediction(refine: bool, frames: int = 30_000, device: str = "cpu") -> dict[str, float]:
    """Return poses per second of `Model.predict`, and the rate of its matrix products relative to the peak."""
    model, data = _model().to(device), _data(frames).without_truth()
    with FlopCounterMode(display=False) as counter:
        model.predict(data.select(np.arange(1000)), refine=False)
    flops = counter.get_total_flops() / 1000
    rates, shares = [], []
    for _ in range(_ROUNDS):
        top = _honest(device)
        rates.append(len(data) / _seconds(lambda: model.predict(data, refine=refine), device))
        shares.append(rates[-1] * flops / top)
    return {"poses_per_second": float(np.median(rates)), "of_peak": float(np.median(shares))}


def command_line() -> dict[str, float]:
    """Return the seconds that ``uplift --help`` takes, and those from ``uplift fit`` to its first step, without and with a fitted flow in the cache."""
    helps = []
    for _ in range(_ROUNDS):
        start = time.perf_counter()
        subprocess.run([*_UPLIFT, "--help"], check=True, capture_output=True)
        helps.append(time.perf_counter() - start)
    with tempfile.TemporaryDirectory() as cache:
        first = _first_step(cache)
        again = [_first_step(cache) for _ in range(_ROUNDS)]
    found = {"help_s": np.median(helps), "fit_to_first_step_s": first, "again_s": np.median(again)}
    return {name: float(value) for name, value in found.items()}


_UPLIFT = [sys.executable, "-m", "uplift.cli.main"]


def _first_step(cache: str) -> float:
    words = ["fit", "task=demo", "data.simulate=5000", "trainer.max_steps=3", "trainer.max_time=null"]
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        process = subprocess.Popen(
            [*_UPLIFT, *words], cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
            env={**os.environ, "UPLIFT_CACHE": cache, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        assert process.stderr is not None
        seconds = next((time.perf_counter() - start for line in process.stderr if b"step 1 " in line), float("nan"))
        process.kill()
        process.wait()
    return seconds


def files(frames: int) -> dict[str, Any]:
    """Return seconds and peak memory of ``uplift predict`` from one .npz to another, on all cores, clips refined."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "many.npz"
        _write_npz(source, frames)
        cores = str(os.cpu_count())
        words = [*_UPLIFT, "predict", "run=person", f"input={source}", f"output={folder}/poses.npz", "check=false"]
        start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            words, check=True, capture_output=True,
            env={**os.environ, "OMP_NUM_THREADS": cores, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return {
            "frames": frames,
            "wall_s": time.perf_counter() - start,
            "cpu_s": used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime,
            "peak_gb": used.ru_maxrss * 1024 / 1e9,
        }


def _write_npz(path: Path, frames: int) -> None:
    """Write simulated people, clips of 300 frames, block by block."""
    data = _data(min(frames, 30_000))
    rows = np.arange(frames)
    np.savez(
        path,
        keypoints=data.keypoints[rows % len(data)],
        confidence=data.confidence[rows % len(data)],
        joint_names=np.array(data.joint_names),
        sequence=(rows // 300).astype("U8"),
        frame=rows % 300,
    )


ROWS: dict[str, Callable[[], dict[str, Any]]] = {
    "peak": peak,
    "kudo, 1024": partial(training, "teacher", "kudo2018_code", 1024),
    "teacher": partial(training, "teacher"),
    "student_1": partial(training, "student_1"),
    "student_2": partial(training, "student_2"),
    "predict, single frames": partial(prediction, False),
    "predict, clips refined": partial(prediction, True),
    "a million frames, npz to npz": partial(files, 1_000_000),
    "ten million frames, npz to npz": partial(files, 10_000_000),
    "command line": command_line,
}
"""What is measured, each in a process of its own."""


# On another device.


def _rows_of_device(device: str) -> dict[str, Callable[[], Any]]:
    stages: dict[str, tuple[str, str | None, int | None]] = {
        "kudo, 1024": ("teacher", "kudo2018_code", 1024),
        "teacher": ("teacher", None, None),
        "student_1": ("student_1", None, None),
        "student_2": ("student_2", None, None),
    }
    rows: dict[str, Callable[[], Any]] = {"peak": partial(peak, device)}
    rows |= {name: partial(training, *words, device=device) for name, words in stages.items()}
    rows |= {f"{name}, losses": partial(_agreement, *words, device=device) for name, words in stages.items()}
    rows["predict, single frames"] = partial(prediction, False, 1_000_000, device)
    rows["predict, clips refined"] = partial(prediction, True, 1_000_000, device)
    return rows


def _agreement(stage: str, task: str | None, batch: int | None, device: str, steps: int = 200) -> dict[str, float]:
    """Return the mean loss of the last half of some steps on the CPU and on the device: their random numbers differ."""
    losses = {}
    for place in ("cpu", device):
        module, size = _module(stage, task, batch)
        run, found = stepper(module.to(place), size), []
        for _ in range(steps):
            run(1)
            found.append(float(vars(module)["last_loss"]))
        losses[place] = float(np.mean(found[steps // 2 :]))
    return losses


# Where the time goes.

_SHOWN = 14


def _of_step(stage: str) -> str:
    """Return the operations of training steps that take longest, and how many there are in a step."""
    module, size = _module(stage, None, None)
    run = stepper(module, size)
    run(_WARM_UP)
    with profile(activities=[ProfilerActivity.CPU]) as found:
        run(5)
    table = found.key_averages().table(sort_by="self_cpu_time_total", row_limit=_SHOWN)
    return f"{_launches(module, size)} operations a step\n{table}"


def _of_code(work: Callable[[], object]) -> str:
    """Return the functions that take longest in ``work``, with all that they call."""
    profiler = cProfile.Profile()
    profiler.runcall(work)
    text = io.StringIO()
    stats = pstats.Stats(profiler, stream=text).sort_stats("cumulative")
    stats.print_stats(r"uplift/|torch/|numpy/", 2 * _SHOWN)
    return text.getvalue()


@contextlib.contextmanager
def _file(ending: str) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder) / f"poses{ending}"


def _predicting(refine: bool) -> str:
    model, data = _model(), _data(20_000).without_truth()
    return _of_code(lambda: model.predict(data, refine=refine))


def _evaluating() -> str:
    model, data = _model(), _data(5000)
    return _of_code(lambda: evaluate_model(model, data, "simulated"))


def _reading() -> str:
    with _file(".npz") as path:
        _write_npz(path, 100_000)
        return _of_code(lambda: list(read_files(path, None)[0]))


def _writing() -> str:
    found, texts = _model().predict(_data(5000).without_truth()), []
    for ending in (".csv", ".bvh", ".glb", ".npz"):
        with _file(ending) as path:
            texts.append(f"-- {ending}\n{_of_code(lambda: write(found, path, None))}")
    return "\n".join(texts)


PARTS: dict[str, Callable[[], str]] = {
    "teacher": partial(_of_step, "teacher"),
    "student": partial(_of_step, "student_2"),
    "predict": partial(_predicting, False),
    "refine": partial(_predicting, True),
    "evaluate": _evaluating,
    "readers": _reading,
    "writers": _writing,
}


if __name__ == "__main__":
    sys.exit(main())
