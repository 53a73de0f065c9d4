"""The stages of a fit: a teacher, then students of its poses; the supervised student where all frames are labelled."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import torch

from uplift.config import LifterSettings, Settings
from uplift.data.labels import joined, mean_bones, with_labels
from uplift.data.load import Loaded
from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.lifter import Lifter
from uplift.model import Model, build_lifter, load_poses
from uplift.priors import build_priors
from uplift.run import RunFolder
from uplift.seeing import frames_of
from uplift.skeleton import Skeleton
from uplift.training.adversarial import AdversarialTraining
from uplift.training.base import LifterTraining
from uplift.training.pseudo import PseudoPoses, lift_all, true_poses
from uplift.training.rows import Rows
from uplift.training.stages import run_stage, stage_budgets
from uplift.training.student import StudentTraining
from uplift.training.watch import blame

__all__ = ["Recipe", "student_settings", "training_frames"]


class Recipe:
    """The stages of one fit; each is built out of what the one before it left."""

    def __init__(self, settings: Settings, skeleton: Skeleton, loaded: Loaded, run: RunFolder | None):
        self.settings, self.skeleton = settings, skeleton
        self.data = training_frames(loaded, skeleton, settings)
        self.supervised = bool(self.data.labelled.all())
        self.bone_mm = mean_bones(self.data) if loaded.unit == "mm" else None
        self.rounds = settings.student.rounds if settings.student.share > 0 else []
        if self.supervised:  # nothing to lift: one student has all the time
            self.rounds = [1.0]
        # Labels take the place of the teacher: what they say of a batch, it need not find out.
        labelled = Rows(self.data.labelled, settings.data.labelled.share).share if self.data.labels is not None else 0.0
        first = settings.teacher.share * (1 - labelled)
        shares = [first, *((settings.student.share or 1.0) * r / sum(self.rounds) for r in self.rounds)]
        self.budgets = stage_budgets(settings.trainer, shares, len(self.data), settings.teacher.batch_size)
        self.spent: dict[str, float] = {}
        torch.manual_seed(settings.seed)
        self.priors, self.weights, self.notes = build_priors(_useful(settings.priors, self.data), skeleton)
        if self.supervised:
            self.notes.append("every frame is labelled: there is no teacher, and the priors have no say")
        if not skeleton.has_mirror_image:
            why = f"its root '{skeleton.root}' is one of a pair" if skeleton.mirror else "it has no `mirror:` pairs"
            self.notes.append(f"no mirroring of skeleton '{skeleton.name}': {why}")
        if not self.priors:
            raise UserError(
                "No prior is on: nothing would train the lifter. Set priors.NAME.use and priors.NAME.weight."
            )
        # What only a student learns, a teacher has no outputs for.
        alone = dataclasses.replace(settings.lifter, spread=False, denoise=False)
        self.first = self._lifter(alone)
        if settings.init and not self.supervised and not (run and (run.checkpoints / "teacher.ckpt").is_file()):
            _start_from(self.first, settings.init)

    def train(self, run: RunFolder) -> Model:
        """Return the model after the last stage."""
        settings = self.settings
        start = time.monotonic()
        lifter, chosen = self.first, dataclasses.replace(settings.lifter, spread=False, denoise=False)
        if not self.supervised:
            lifter = self._run("teacher", self._teacher(), 0, run, time.monotonic() - start)
        for number in range(1, len(self.rounds) + 1):
            start = time.monotonic()
            poses = self._poses(lifter, number)
            chosen = student_settings(
                settings, noisy=poses.noise is not None and settings.student.noise, last=number == len(self.rounds)
            )
            torch.manual_seed(settings.seed + number)
            fresh = self._lifter(chosen)
            if settings.student.warm and number > 1:
                _go_on(fresh, lifter)
            if self.supervised and settings.init:  # there is no teacher to start from it
                _start_from(fresh, settings.init)
            student = StudentTraining(
                fresh,
                poses,
                settings.student,
                settings.views,
                settings.seed + number,
                settings.data.labelled.share,
            )
            lifter = self._run(f"student_{number}", student, number, run, time.monotonic() - start)
        return Model(lifter.cpu().eval(), self.skeleton, chosen)

    def _poses(self, lifter: Lifter, number: int) -> PseudoPoses:
        """Return what a student learns from: the truth where all of it is known, else what ``lifter`` makes of the frames."""
        student = self.settings.student
        if self.supervised:
            return true_poses(self.data, self.first.camera, tilted=lifter.tilt != "level")
        return lift_all(lifter, self.data.some(student.frames, self.settings.seed + number), student.refine)

    def _lifter(self, chosen: LifterSettings) -> Lifter:
        """Return an untrained lifter that knows how large the labelled bodies are."""
        lifter = build_lifter(chosen, self.skeleton)
        if self.bone_mm is not None:
            lifter.bone_mm.copy_(self.bone_mm.nan_to_num())
        return lifter

    def _run(self, name: str, module: LifterTraining, place: int, run: RunFolder, before: float = 0.0) -> Lifter:
        """Train one stage and return its lifter; ``before`` are the seconds of the budget its data took."""
        clock = run_stage(name, module, self.settings.trainer, self.budgets[place], run.path, before, run.link_last)
        self.spent[name] = clock.spent
        return module.final

    def _teacher(self) -> AdversarialTraining:
        settings = self.settings
        for name, prior in self.priors.items():
            with blame(name, prior, "prepare"):
                prior.prepare(self.data)
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
        """Return the labelled frames as poses to show from everywhere; None without any."""
        labelled = self.data.labelled
        if not bool(labelled.any()):
            return None
        return true_poses(self.data.part(labelled), self.first.camera, tilted=self.first.tilt != "level")


def training_frames(loaded: Loaded, skeleton: Skeleton, settings: Settings) -> TrainingSet:
    """Return the training frames of all files in the model's units, with those labels that may be used."""
    frames = with_labels(frames_of(loaded.train, skeleton, settings.lifter), loaded.train)
    if loaded.more is None:
        return frames
    return joined(frames, with_labels(frames_of(loaded.more, skeleton, settings.lifter), loaded.more))


def _go_on(fresh: Lifter, last: Lifter) -> None:
    """Give a new round's lifter the weights of the last round's, where the networks are alike."""
    shapes = [[(key, value.shape) for key, value in lifter.state_dict().items()] for lifter in (fresh, last)]
    if shapes[0] == shapes[1]:
        fresh.load_state_dict(last.state_dict())


def _useful(priors: dict[str, Any], data: TrainingSet) -> dict[str, Any]:
    """Return the priors without those for labels that are on ``if_possible`` where no frame has one."""
    if bool(data.labelled.any()):
        return priors
    return {n: spec for n, spec in priors.items() if not (n == "labelled" and spec.get("if_possible"))}


def student_settings(settings: Settings, *, noisy: bool, last: bool) -> LifterSettings:
    """Return the lifter settings of a student: the teacher's, with what only students have.

    ``noisy`` says whether its poses tell that the keypoints are, ``last`` whether it is the last student.
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
    """Load the weights of another run's lifter; labels of this fit still say how large bodies are."""
    other, told = load_poses(run), lifter.bone_mm.clone()
    if other.skeleton.joints != lifter.skeleton.joints:
        raise UserError(
            f"init={run} was trained on skeleton '{other.skeleton.name}' ({len(other.skeleton.joints)} joints), "
            f"this fit is for '{lifter.skeleton.name}' ({len(lifter.skeleton.joints)} joints)."
        )
    try:
        lifter.load_state_dict(other.lifter.state_dict())
    except RuntimeError as error:
        raise UserError(f"init={run} has another network: {str(error).splitlines()[0]}") from error
    if told.any():
        lifter.bone_mm.copy_(told)
