"""Steps per second of the default recipe on the full set and on 20,000 frames of it, alternating in one process."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.loading.files import settings_of
from uplift.config.settings import Settings
from uplift.data.load import load_data
from uplift.data.tensors import TrainingSet
from uplift.models.model import build_lifter
from uplift.priors import build_priors
from uplift.skeleton import load_skeleton
from uplift.training.adversarial import AdversarialTraining
from uplift.training.base import LifterTraining
from uplift.training.pseudo_labels import PseudoPoses, lift_all
from uplift.training.pose_recipe import student_settings, training_frames
from uplift.training.student import StudentTraining

__all__ = ["SMALL", "train"]

SMALL = 20_000
"""Frames of the small set: its arrays are still larger than the CPU's caches."""
_WARM_UP, _STEPS, _TURNS = 16, 32, 8  # a student makes 16 batches at once


def train(folder: str | Path) -> dict[str, Any]:
    """Return the steps per second of teacher and student on each set, on one thread, and their median ratio."""
    torch.set_num_threads(1)
    settings = settings_of(folder, "priors.flow.steps=20")
    skeleton = load_skeleton(settings.skeleton)
    loaded = load_data(settings, skeleton)
    full = training_frames(loaded, skeleton, settings)
    small = full.select(torch.arange(min(SMALL, len(full))))
    found: dict[str, Any] = {"threads": 1, "frames": len(full), "small_frames": len(small)}
    found["teacher"] = _compare(_teacher(settings, full), _teacher(settings, small))
    poses = [_poses(settings, frames) for frames in (full, small)]
    found["student"] = _compare(*(_student(settings, of) for of in poses)) | {"frames": len(poses[0])}
    return found


def _compare(large: LifterTraining, small: LifterTraining) -> dict[str, float]:
    """Return the speed on both sets; they alternate, so that other load on the machine slows both equally."""
    runs = [_run_of(large), _run_of(small)]
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


def _run_of(module: LifterTraining) -> Callable[[int], float]:
    """Return a function that runs training steps, as a trainer would, and returns the seconds they took."""
    kind = type(module)
    module.__class__ = type(kind.__name__, (kind,), {"global_step": property(lambda self: self.__dict__["steps"])})
    module.__dict__["steps"] = 0
    module.on_fit_start()
    optimizer = module.configure_optimizers()

    def run(count: int) -> float:
        start = time.perf_counter()
        for _ in range(count):
            loss = module.training_step(module.global_step, module.global_step)
            optimizer.zero_grad()
            loss.backward()
            module.on_before_optimizer_step(optimizer)
            optimizer.step()
            if module.averaged is not None:
                module.averaged.update_parameters(module.lifter)
            module.__dict__["steps"] += 1
        return time.perf_counter() - start

    return run


def _teacher(settings: Settings, frames: TrainingSet) -> AdversarialTraining:
    torch.manual_seed(0)
    wanted = {name: spec for name, spec in settings.priors.items() if name != "labelled"}  # no frame is labelled
    priors, weights, _ = build_priors(wanted, frames.skeleton)
    for prior in priors.values():
        prior.prepare(frames)
    lifter = build_lifter(settings.lifter, frames.skeleton)
    return AdversarialTraining(lifter, frames, settings.teacher, settings.views, priors, weights, 0)


def _poses(settings: Settings, frames: TrainingSet) -> PseudoPoses:
    """Return the unrefined poses of an untrained teacher, as many as a student is trained on."""
    lifter = build_lifter(settings.lifter, frames.skeleton)
    settings.student.refine.iterations = 0
    return lift_all(lifter, frames.some(settings.student.frames, 1), settings.student.refine)


def _student(settings: Settings, poses: PseudoPoses) -> StudentTraining:
    torch.manual_seed(1)
    chosen = student_settings(settings, noisy=False, last=True)
    return StudentTraining(build_lifter(chosen, poses.skeleton), poses, settings.student, settings.views, 0)
