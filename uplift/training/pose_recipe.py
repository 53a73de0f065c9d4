"""`PoseRecipe`, the stages of a fit of keypoints: a teacher, then students of its pseudo labels."""

from __future__ import annotations

import dataclasses

from uplift.config.run import RunFolder
from uplift.config.settings import LifterSettings, Settings
from uplift.data.module import KeypointData
from uplift.data.sampler import LabelledSampler
from uplift.errors import UserError
from uplift.models.known_body import usual_errors
from uplift.models.lifter import Lifter
from uplift.models.model import Model
from uplift.models.networks import fitting_options
from uplift.training.base import plain_settings
from uplift.training.lifting import KeypointModule, LiftingModule
from uplift.training.stages import Recipe, module_class
from uplift.training.student import StudentModule, student_settings
from uplift.training.warm_start import WarmStart

__all__ = ["PoseRecipe"]


class PoseRecipe(Recipe):
    """A teacher, then students of its pseudo labels; one supervised student where all frames are labelled.

    All of them are built before any is trained, so that a setting that one of them refuses costs no training.
    """

    def __init__(self, settings: Settings, data: KeypointData, run: RunFolder | None, start: WarmStart | None = None):
        super().__init__(settings)
        self.data, self.skeleton = data, data.skeleton
        labelled = data.frames(settings.lifter).labelled
        self.supervised = bool(labelled.all())
        shares = self._shares(LabelledSampler(labelled, settings.data.labelled.share).share)
        self.share_budget(shares, data.sample_count)
        self.teacher = self._build_teacher(bool(labelled.any()))
        self.students = [self._build_student(number) for number in range(1, len(self.rounds) + 1)]
        self._add_notes()
        if start is not None:
            start.into(self.students[0] if self.supervised else self.teacher)

    def _shares(self, labelled: float) -> dict[str, float]:
        """Return each stage's share of the fit, where a share of ``labelled`` frames is in a batch."""
        settings, student = self.settings, self.settings.student
        self.rounds = student.rounds if student.share > 0 else []
        if self.supervised:  # no teacher: one student has all the time
            self.rounds = [1.0]
        shares = [(student.share or 1.0) * share / sum(self.rounds) for share in self.rounds]
        students = {f"student_{number}": share for number, share in enumerate(shares, 1)}
        # The teacher is not needed for labelled frames.
        return {"teacher": settings.teacher.share * (1 - labelled), **students}

    def _build_teacher(self, labelled: bool) -> LiftingModule:
        settings, priors = self.settings, self.settings.priors
        if priors.get("labelled", {}).get("if_possible") and not labelled:
            priors = {name: spec for name, spec in priors.items() if name != "labelled"}
        views = {key: value for key, value in dataclasses.asdict(settings.views).items() if key != "count_root"}
        build = module_class(settings.module, "module", LiftingModule)
        # A fit that starts from a trained lifter has networks like it in all stages.
        lifter = student_settings(settings, last=True) if settings.init else settings.lifter
        module = build(
            self.skeleton,
            priors=priors,
            lifter=self._options_that_fit("lifter", lifter),
            views=views,
            seed=settings.seed,
            **({"like_student": True} if settings.init else {}),
            **plain_settings(settings.teacher),
        )
        self.notes += module.notes
        return _checked(module)

    def _build_student(self, number: int) -> StudentModule:
        settings, last = self.settings, number == len(self.rounds)
        # The first one goes on from a teacher that started from a trained lifter too.
        warm = settings.student.warm and (number > 1 or (bool(settings.init) and not self.supervised))
        build = module_class(settings.student.module, "student.module", StudentModule)
        lifter = self._options_that_fit("student", student_settings(settings, last=last))
        plain = {**plain_settings(settings.student), "warm": warm}
        return _checked(build(self.skeleton, lifter=lifter, seed=settings.seed + number, **plain))

    def _options_that_fit(self, where: str, lifter: LifterSettings) -> dict:
        """Return plain settings of a lifter without the options of another network, and note those."""
        kept, left_out = fitting_options(lifter.network, lifter.options)
        if left_out:
            options = f"{where}.options.{', '.join(left_out)}"
            self.notes.append(f"without {options}: of another network than {lifter.network}")
        return dataclasses.asdict(dataclasses.replace(lifter, options=kept))

    def _add_notes(self) -> None:
        skeleton, self.notes = self.skeleton, list(dict.fromkeys(self.notes))
        if self.supervised:
            self.notes.append("every frame is labelled: there is no teacher, and the priors have no effect")
        if not skeleton.has_mirror_image:
            why = f"its root '{skeleton.root}' is one of a pair" if skeleton.mirror else "it has no `mirror:` pairs"
            self.notes.append(f"no mirroring of skeleton '{skeleton.name}': {why}")

    def train(self, run: RunFolder) -> Model:
        """Return the model after the last stage."""
        module: KeypointModule = self.teacher
        if not self.supervised:
            self.stage(run, "teacher", module, self.data, self.settings.teacher.batch_size)
        for number, student in enumerate(self.students, 1):
            student.learn_from(module)
            module = student
            self.stage(run, f"student_{number}", module, self.data, self.settings.student.batch_size)
        return self.finished(module)

    def finished(self, module: KeypointModule) -> Model:
        """Return the model of the last stage's ``module``."""
        model = module.model()
        model = Model(model.lifter.cpu(), model.skeleton, model.settings)
        return dataclasses.replace(model, usual=usual_errors(model, self.data.train_samples))


def _checked(module):
    """Return the module; raises UserError where its lifter is not the one that its settings name."""
    expected = Lifter(module.skeleton, module.lifter_settings).state_dict()
    found = module.lifter.state_dict()
    if {key: value.shape for key, value in found.items()} != {key: value.shape for key, value in expected.items()}:
        raise UserError(
            f"{type(module).__name__}.configure_lifter returns another lifter than lifter.network and lifter.options "
            "name, so a file with its weights could not be read again. Name the network as lifter.network=file.py:Class."
        )
    return module
