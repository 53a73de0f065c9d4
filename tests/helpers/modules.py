"""Modules around lifters, data and priors that a test made itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from uplift.config.settings import StudentSettings, TeacherSettings, ViewSettings
from uplift.data.mask_tensors import MaskSet
from uplift.data.sampler import LabelledSampler
from uplift.data.tensors import TrainingSet
from uplift.models.lifter import Lifter
from uplift.models.mixture import ShapeMixture
from uplift.priors.base import Prior
from uplift.training.base import plain_settings
from uplift.training.lifting import LiftingModule
from uplift.training.mixture import EStepStatistics, MixtureModule
from uplift.training.pseudo_labels import PseudoPoses
from uplift.training.student import StudentModule

__all__ = ["lifting_module", "mixture_module", "student_module"]


def lifting_module(
    lifter: Lifter,
    frames: TrainingSet,
    priors: Mapping[str, Prior],
    weights: Mapping[str, float] | None = None,
    *,
    views: ViewSettings | None = None,
    seed: int = 0,
    labelled_share: float | None = None,
    **teacher: Any,
) -> LiftingModule:
    """Return a module of ``lifter`` and ``priors``, each of weight 1 by default, that draws from ``frames``.

    Settings that are not given are those of `TeacherSettings` and `ViewSettings`, whatever the default recipe has.
    """
    chosen = dict.fromkeys(priors, 1.0) if weights is None else dict(weights)

    class Given(LiftingModule):
        def configure_lifter(self) -> Lifter:
            return lifter

        def configure_priors(self) -> tuple[dict[str, Prior], dict[str, float]]:
            return dict(priors), chosen

    plain = dataclasses.asdict(views or ViewSettings())
    radius = "all" if plain.pop("count_root") else "without_root"
    module = Given(
        lifter.skeleton,
        lifter={"radius": radius},
        views=plain,
        seed=seed,
        **plain_settings(TeacherSettings(**teacher)),
    )
    module.frames, module.labelled_share = frames, labelled_share
    module.sampler = LabelledSampler(frames.labelled, labelled_share)
    return module


def student_module(
    lifter: Lifter, poses: PseudoPoses, *, count_root: bool = False, seed: int = 0, **student: Any
) -> StudentModule:
    """Return a module of ``lifter`` that is shown views of ``poses``, ready for its first step on the CPU."""

    class Given(StudentModule):
        def configure_lifter(self) -> Lifter:
            return lifter

    radius = "all" if count_root else "without_root"
    settings = plain_settings(StudentSettings(**student))
    module = Given(lifter.skeleton, lifter={"radius": radius}, seed=seed, **settings)
    module.frames, module.labelled_share = poses, None
    module.on_fit_start()
    return module


def mixture_module(
    mixture: ShapeMixture,
    masks: MaskSet,
    priors: Mapping[str, Prior] | None = None,
    *,
    hot: bool = True,
    seed: int = 0,
    kind: type[MixtureModule] = MixtureModule,
    **teacher: Any,
) -> Any:
    """Return a module of ``mixture``, a ``kind`` of `MixtureModule`, that explains ``masks``; priors have weight 1."""
    given = dict(priors or {})

    class Given(kind):
        def configure_lifter(self) -> ShapeMixture:
            return mixture

        def configure_priors(self) -> tuple[dict[str, Prior], dict[str, float]]:
            return given, dict.fromkeys(given, 1.0)

    settings = plain_settings(TeacherSettings(**teacher))
    module = Given(shape=dataclasses.asdict(mixture.settings), hot=hot, seed=seed, **settings)
    module.frames = masks
    module.statistics = EStepStatistics(mixture, bool(masks.labelled.any()), module._pooled)
    return module
