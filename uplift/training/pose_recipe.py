"""`PoseRecipe`, the stages of a fit of keypoints: a teacher, then students of its pseudo labels."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import torch

from uplift.config.run import RunFolder
from uplift.config.settings import LifterSettings, Settings
from uplift.data.load import Loaded
from uplift.data.tensors import TrainingSet, mean_bones, to_training_set, with_labels
from uplift.errors import UserError
from uplift.models.lifter import Lifter
from uplift.models.model import Model, load_poses
from uplift.skeleton import Skeleton
from uplift.training.adversarial import AdversarialTraining
from uplift.training.objective import prepare_priors
from uplift.training.pseudo_labels import PseudoPoses, lift_all, true_poses
from uplift.training.sampler import LabelledSampler
from uplift.training.stages import Recipe
from uplift.training.student import StudentTraining

__all__ = ["PoseRecipe", "student_settings", "training_frames"]


class PoseRecipe(Recipe):
    """A teacher, then students of its pseudo labels; one supervised student where all frames are labelled."""

    def __init__(self, settings: Settings, skeleton: Skeleton, loaded: Loaded, run: RunFolder | None):
        self.skeleton = skeleton
        self.data = training_frames(loaded, skeleton, settings)
        self.supervised = bool(self.data.labelled.all())
        self.bone_mm = mean_bones(self.data) if loaded.unit == "mm" else None
        super().__init__(settings, _useful(settings.priors, self.data), skeleton)
        self.share_budget(self._shares(), len(self.data))
        self.notes += self._notes()
        if not self.priors:
            raise UserError(
                "No prior is on: nothing would train the lifter. Set priors.NAME.use and priors.NAME.weight."
            )
        # The teacher has no outputs for what only a student learns.
        self.chosen = dataclasses.replace(settings.lifter, spread=False, denoise=False)
        self.first = self._lifter(self.chosen)
        if settings.init and not self.supervised and not (run and (run.checkpoints / "teacher.ckpt").is_file()):
            _start_from(self.first, settings.init)

    def _shares(self) -> dict[str, float]:
        """Return each stage's share of the fit."""
        settings, student = self.settings, self.settings.student
        self.rounds = student.rounds if student.share > 0 else []
        if self.supervised:  # nothing to lift: one student has all the time
            self.rounds = [1.0]
        # Labels replace the teacher: what they say of a batch need not be found out.
        sampler = LabelledSampler(self.data.labelled, settings.data.labelled.share)
        labelled = sampler.share if self.data.labels is not None else 0.0
        students = {
            f"student_{number}": (student.share or 1.0) * share / sum(self.rounds)
            for number, share in enumerate(self.rounds, 1)
        }
        return {"teacher": settings.teacher.share * (1 - labelled), **students}

    def _notes(self) -> list[str]:
        notes, skeleton = [], self.skeleton
        if self.supervised:
            notes.append("every frame is labelled: there is no teacher, and the priors have no effect")
        if not skeleton.has_mirror_image:
            why = f"its root '{skeleton.root}' is one of a pair" if skeleton.mirror else "it has no `mirror:` pairs"
            notes.append(f"no mirroring of skeleton '{skeleton.name}': {why}")
        return notes

    def train(self, run: RunFolder) -> Model:
        """Return the model after the last stage."""
        lifter = self.first
        if not self.supervised:
            lifter = self.stage(run, "teacher", self._teacher)
        for number in range(1, len(self.rounds) + 1):
            lifter = self.stage(run, f"student_{number}", partial(self._student, lifter, number))
        return Model(lifter.cpu().eval(), self.skeleton, self.chosen)

    def _teacher(self) -> AdversarialTraining:
        settings = self.settings
        prepare_priors(self.priors, self.data)
        return AdversarialTraining(
            self.first,
            self.data,
            settings.teacher,
            settings.views,
            self.priors,
            self.weights,
            settings.seed,
            settings.data.labelled.share,
            self._truth(),
        )

    def _truth(self) -> PseudoPoses | None:
        """Return the labelled frames as poses to see from everywhere; None if there are none."""
        labelled = self.data.labelled
        if not bool(labelled.any()):
            return None
        return true_poses(self.data.select(labelled), self.first.camera, tilted=self.first.tilt != "level")

    def _student(self, lifter: Lifter, number: int) -> StudentTraining:
        """Return the training of a new lifter on poses of the last one."""
        settings = self.settings
        poses = self._poses(lifter, number)
        noisy = poses.noise is not None and settings.student.noise
        self.chosen = student_settings(settings, noisy=noisy, last=number == len(self.rounds))
        torch.manual_seed(settings.seed + number)
        fresh = self._lifter(self.chosen)
        if settings.student.warm and number > 1:
            _go_on(fresh, lifter)
        if self.supervised and settings.init:  # there is no teacher to start from it
            _start_from(fresh, settings.init)
        return StudentTraining(
            fresh, poses, settings.student, settings.views, settings.seed + number, settings.data.labelled.share
        )

    def _poses(self, lifter: Lifter, number: int) -> PseudoPoses:
        """Return what a student learns from: the truth if every frame is labelled, else what ``lifter`` finds."""
        student = self.settings.student
        if self.supervised:
            return true_poses(self.data, self.first.camera, tilted=lifter.tilt != "level")
        return lift_all(lifter, self.data.some(student.frames, self.settings.seed + number), student.refine)

    def _lifter(self, chosen: LifterSettings) -> Lifter:
        """Return an untrained lifter that knows how large the labelled bodies are."""
        lifter = Lifter(self.skeleton, chosen)
        if self.bone_mm is not None:
            lifter.bone_mm.copy_(self.bone_mm.nan_to_num())
        return lifter


def training_frames(loaded: Loaded, skeleton: Skeleton, settings: Settings) -> TrainingSet:
    """Return the training frames of all files in the model's units, with the labels that may be used."""
    frames = with_labels(to_training_set(loaded.train, skeleton, settings.lifter), loaded.train)
    if loaded.more is None:
        return frames
    return TrainingSet.concat(
        [frames, with_labels(to_training_set(loaded.more, skeleton, settings.lifter), loaded.more)]
    )


def _go_on(fresh: Lifter, last: Lifter) -> None:
    """Copy the weights of the last round's lifter into a new one, if the networks are the same."""
    shapes = [[(key, value.shape) for key, value in lifter.state_dict().items()] for lifter in (fresh, last)]
    if shapes[0] == shapes[1]:
        fresh.load_state_dict(last.state_dict())


def _useful(priors: dict[str, Any], data: TrainingSet) -> dict[str, Any]:
    """Return the priors, without ``labelled`` if it is on ``if_possible`` and no frame is labelled."""
    if bool(data.labelled.any()):
        return priors
    return {n: spec for n, spec in priors.items() if not (n == "labelled" and spec.get("if_possible"))}


def student_settings(settings: Settings, *, noisy: bool, last: bool) -> LifterSettings:
    """Return the lifter settings of a student: the teacher's, with what only students have.

    Args:
        noisy: whether the keypoints are, as its poses show.
        last: whether it is the last student.
    """
    student, lifter = settings.student, settings.lifter
    options = lifter.options if student.network is None else {}
    return dataclasses.replace(
        lifter,
        network=student.network or lifter.network,
        options={**options, **student.options, **(student.last_options if last else {})},
        denoise=noisy if lifter.denoise is None else lifter.denoise,
    )


def _start_from(lifter: Lifter, run: str) -> None:
    """Load the weights of another run's lifter, but keep the body size that labels of this fit give."""
    other, bone_mm = load_poses(run), lifter.bone_mm.clone()
    if other.skeleton.joints != lifter.skeleton.joints:
        raise UserError(
            f"init={run} was trained on skeleton '{other.skeleton.name}' ({len(other.skeleton.joints)} joints), "
            f"this fit is for '{lifter.skeleton.name}' ({len(lifter.skeleton.joints)} joints)."
        )
    try:
        lifter.load_state_dict(other.lifter.state_dict())
    except RuntimeError as error:
        raise UserError(f"init={run} has another network: {str(error).splitlines()[0]}") from error
    if bone_mm.any():
        lifter.bone_mm.copy_(bone_mm)
