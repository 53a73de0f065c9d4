"""Training steps of the recipe's teacher and student, without a trainer."""

from __future__ import annotations

import time
from collections.abc import Callable

import torch

from uplift.config.settings import Settings
from uplift.data.tensors import TrainingSet
from uplift.models.lifter import Lifter
from uplift.priors import build_priors
from uplift.training.adversarial import AdversarialTraining
from uplift.training.base import LifterTraining
from uplift.training.pose_recipe import student_settings
from uplift.training.pseudo_labels import PseudoPoses, lift_all
from uplift.training.student import StudentTraining

__all__ = ["stepper", "student", "teacher", "untrained_poses"]


def teacher(settings: Settings, frames: TrainingSet) -> AdversarialTraining:
    """Return the training of a teacher on ``frames``, of which none is labelled."""
    torch.manual_seed(0)
    wanted = {name: spec for name, spec in settings.priors.items() if name != "labelled"}  # no frame is labelled
    priors, weights, _ = build_priors(wanted, frames.skeleton)
    for prior in priors.values():
        prior.prepare(frames)
    lifter = Lifter(frames.skeleton, settings.lifter)
    return AdversarialTraining(lifter, frames, settings.teacher, settings.views, priors, weights, 0)


def untrained_poses(settings: Settings, frames: TrainingSet) -> PseudoPoses:
    """Return the unrefined poses of an untrained teacher, as many as a student is trained on."""
    lifter = Lifter(frames.skeleton, settings.lifter)
    settings.student.refine.iterations = 0
    return lift_all(lifter, frames.some(settings.student.frames, 1), settings.student.refine)


def student(settings: Settings, poses: PseudoPoses) -> StudentTraining:
    """Return the training of the last student on ``poses``."""
    torch.manual_seed(1)
    chosen = student_settings(settings, noisy=False, last=True)
    return StudentTraining(Lifter(poses.skeleton, chosen), poses, settings.student, settings.views, 0)


def stepper(module: LifterTraining) -> Callable[[int], float]:
    """Return a function that runs a number of training steps without a trainer and returns the seconds they took."""
    kind = type(module)
    module.__class__ = type(kind.__name__, (kind,), {"global_step": property(lambda self: self.__dict__["steps"])})
    module.__dict__["steps"] = 0
    module.on_fit_start()
    optimizer = module.configure_optimizers()

    def run(count: int) -> float:
        start = time.perf_counter()
        for step in range(module.global_step, module.global_step + count):
            loss = module.training_step(step, step)
            optimizer.zero_grad()
            loss.backward()
            module.on_before_optimizer_step(optimizer)
            optimizer.step()
            module.on_train_batch_end(None, step, step)
            module.__dict__["steps"] += 1
        return time.perf_counter() - start

    return run
