"""`PoseRecipe`, the stages of a fit of keypoints: a teacher, then students of its pseudo labels."""

from __future__ import annotations

import dataclasses
from functools import partial

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
from uplift.training.pseudo_labels import lift_all, true_poses
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
        priors = settings.priors
        if priors.get("labelled", {}).get("if_possible") and not bool(self.data.labelled.any()):
            priors = {name: spec for name, spec in priors.items() if name != "labelled"}
        super().__init__(settings, priors, skeleton)
        self.share_budget(self._shares(), len(self.data))
        self._add_notes()
        if not self.priors:
            raise UserError(
                "No prior is on: nothing would train the lifter. Set priors.NAME.use and priors.NAME.weight."
            )
        # Only students learn to predict the uncertainty and to correct visible joints.
        self.chosen = dataclasses.replace(settings.lifter, uncertainty=False, denoise=False)
        self.first = self._lifter(self.chosen)
        if settings.init and not self.supervised and not (run and (run.checkpoints / "teacher.ckpt").is_file()):
            _start_from(self.first, settings.init)

    def _shares(self) -> dict[str, float]:
        """Return each stage's share of the fit."""
        settings, student = self.settings, self.settings.student
        self.rounds = student.rounds if student.share > 0 else []
        if self.supervised:  # no teacher: one student has all the time
            self.rounds = [1.0]
        # The teacher is not needed for labelled frames.
        labelled = LabelledSampler(self.data.labelled, settings.data.labelled.share).share
        shares = [(student.share or 1.0) * share / sum(self.rounds) for share in self.rounds]
        students = {f"student_{number}": share for number, share in enumerate(shares, 1)}
        return {"teacher": settings.teacher.share * (1 - labelled), **students}

    def _add_notes(self) -> None:
        skeleton = self.skeleton
        if self.supervised:
            self.notes.append("every frame is labelled: there is no teacher, and the priors have no effect")
        if not skeleton.has_mirror_image:
            why = f"its root '{skeleton.root}' is one of a pair" if skeleton.mirror else "it has no `mirror:` pairs"
            self.notes.append(f"no mirroring of skeleton '{skeleton.name}': {why}")

    def train(self, run: RunFolder) -> Model:
        """Return the model after the last stage."""
        lifter = self.first
        if not self.supervised:
            lifter = self.stage(run, "teacher", self._teacher)
        for number in range(1, len(self.rounds) + 1):
            lifter = self.stage(run, f"student_{number}", partial(self._student, lifter, number))
        return Model(lifter.cpu().eval(), self.skeleton, self.chosen)

    def _teacher(self) -> AdversarialTraining:
        settings, first, labelled = self.settings, self.first, self.data.labelled
        prepare_priors(self.priors, self.data)
        truth = None
        if bool(labelled.any()):
            truth = true_poses(self.data.select(labelled), first.camera, tilted=first.tilt != "level")
        terms, share = (self.priors, self.weights), settings.data.labelled.share
        return AdversarialTraining(
            first, self.data, settings.teacher, settings.views, *terms, settings.seed, share, truth
        )

    def _student(self, lifter: Lifter, number: int) -> StudentTraining:
        """Return the training of a new lifter on the poses of ``lifter``, or on the labels if every frame has one."""
        settings = self.settings
        if self.supervised:
            poses = true_poses(self.data, self.first.camera, tilted=lifter.tilt != "level")
        else:
            data = self.data.some(settings.student.frames, settings.seed + number)
            poses = lift_all(lifter, data, settings.student.refine)
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

    def _lifter(self, chosen: LifterSettings) -> Lifter:
        """Return an untrained lifter with the size of the labelled bodies."""
        lifter = Lifter(self.skeleton, chosen)
        if self.bone_mm is not None:
            lifter.bone_mm.copy_(self.bone_mm.nan_to_num())
        return lifter


def training_frames(loaded: Loaded, skeleton: Skeleton, settings: Settings) -> TrainingSet:
    """Return the training frames of all files in the model's units, with the labels that may be used."""
    files = [part for part in (loaded.train, loaded.more) if part is not None]
    parts = [with_labels(to_training_set(part, skeleton, settings.lifter), part) for part in files]
    return parts[0] if len(parts) == 1 else TrainingSet.concat(parts)


def _go_on(fresh: Lifter, last: Lifter) -> None:
    """Copy the weights of the last round's lifter into a new one, if the networks are the same."""
    shapes = [[(key, value.shape) for key, value in lifter.state_dict().items()] for lifter in (fresh, last)]
    if shapes[0] == shapes[1]:
        fresh.load_state_dict(last.state_dict())


def student_settings(settings: Settings, *, noisy: bool, last: bool) -> LifterSettings:
    """Return the lifter settings of a student, the ``last`` one or not, for keypoints that are ``noisy`` or not."""
    student, lifter = settings.student, settings.lifter
    options = lifter.options if student.network is None else {}
    return dataclasses.replace(
        lifter,
        network=student.network or lifter.network,
        options={**options, **student.options, **(student.last_options if last else {})},
        denoise=noisy if lifter.denoise is None else lifter.denoise,
    )


def _start_from(lifter: Lifter, run: str) -> None:
    """Load the weights of another run's lifter, but keep the body size from the labels of this fit."""
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
