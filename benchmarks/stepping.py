"""Training steps of the recipe's teacher and student, without a trainer."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import torch

from uplift.config.device import fast_products
from uplift.config.settings import Settings
from uplift.data.sampler import LabelledSampler
from uplift.data.tensors import TrainingSet
from uplift.models.lifter import Lifter
from uplift.training.base import TrainingModule, plain_settings
from uplift.training.lifting import LiftingModule
from uplift.training.objective import prepare_priors
from uplift.training.pseudo_labels import PseudoPoses, lift_all
from uplift.training.student import StudentModule, student_settings

__all__ = ["stepper", "student", "teacher", "untrained_poses"]


def teacher(settings: Settings, frames: TrainingSet) -> LiftingModule:
    """Return the training of a teacher on ``frames``, of which none is labelled."""
    wanted = {name: spec for name, spec in settings.priors.items() if name != "labelled"}  # no frame is labelled
    views = {key: value for key, value in dataclasses.asdict(settings.views).items() if key != "count_root"}
    module = LiftingModule(
        frames.skeleton,
        priors=wanted,
        lifter=dataclasses.asdict(settings.lifter),
        views=views,
        **plain_settings(settings.teacher),
    )
    prepare_priors(module.terms.priors, frames)
    module.frames, module.labelled_share = frames, None
    module.sampler = LabelledSampler(frames.labelled, None)
    return module


def untrained_poses(settings: Settings, frames: TrainingSet) -> PseudoPoses:
    """Return the unrefined poses of an untrained teacher, as many as a student is trained on."""
    lifter = Lifter(frames.skeleton, settings.lifter)
    settings.student.refine.iterations = 0
    return lift_all(lifter, frames.some(settings.student.frames, 1), settings.student.refine)


def student(settings: Settings, poses: PseudoPoses, *, last: bool = True) -> StudentModule:
    """Return the training of the last student on ``poses``, or of one before it."""
    chosen = dataclasses.replace(student_settings(settings, last=last), denoise=False)
    plain = plain_settings(settings.student)
    module = StudentModule(poses.skeleton, lifter=dataclasses.asdict(chosen), seed=1, **plain)
    module.frames, module.labelled_share = poses, None
    return module


def stepper(module: TrainingModule, batch_size: int, precision: str = "32-true") -> Callable[[int], float]:
    """Return a function that runs a number of training steps without a trainer and returns the seconds they took.

    The loss of the last step is kept as ``module.last_loss``.
    """
    kind = type(module)
    module.__class__ = type(kind.__name__, (kind,), {"global_step": property(lambda self: self.__dict__["steps"])})
    module.__dict__["steps"] = 0
    module.on_fit_start()
    optimizer = module.configure_optimizers()
    mixed = torch.autocast(module.device.type, torch.bfloat16, enabled=precision == "bf16-mixed")

    def run(count: int) -> float:
        start = time.perf_counter()
        with fast_products(training=True):
            for step in range(module.global_step, module.global_step + count):
                with mixed:
                    loss = module.training_step(batch_size, step)
                optimizer.zero_grad()
                loss.backward()
                module.on_before_optimizer_step(optimizer)
                optimizer.step()
                if module.averaged is not None:
                    module.averaged.update_parameters(module.lifter)
                module.__dict__["steps"] += 1
                module.__dict__["last_loss"] = loss.detach()
        return time.perf_counter() - start

    return run
