"""The stages of a fit: a teacher, then students of its poses; the supervised student where all frames are labelled."""

from __future__ import annotations

import dataclasses
import logging
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException

from uplift.config.files import read_torch
from uplift.config.run import RunFolder
from uplift.config.settings import LifterSettings, Settings, TrainerSettings, seconds_of
from uplift.data.load import Loaded
from uplift.data.tensors import TrainingSet, frames_of, joined, mean_bones, with_labels
from uplift.errors import UserError
from uplift.models.lifter import Lifter
from uplift.models.model import Model, build_lifter, load_poses
from uplift.priors import build_priors
from uplift.skeleton import Skeleton
from uplift.training.adversarial import AdversarialTraining
from uplift.training.base import LifterTraining
from uplift.training.callbacks import Budget, Checkpoints, Interrupted, MetricsFile, Progress, Threads, check_checkpoint
from uplift.training.objective import prepare_priors
from uplift.training.pseudo_labels import PseudoPoses, lift_all, true_poses
from uplift.training.sampler import LabelledSampler
from uplift.training.student import StudentTraining

__all__ = ["Recipe", "StageBudget", "run_stage", "stage_budgets", "student_settings", "training_frames"]

# Run the stages of a fit, each with its budget, checkpoint and progress.


@dataclass(frozen=True)
class StageBudget:
    """What one stage may spend; at least one of the two is set."""

    steps: int | None
    seconds: float | None


def stage_budgets(trainer: TrainerSettings, shares: Sequence[float], frames: int, batch_size: int) -> list[StageBudget]:
    """Split the fit's steps and time over its stages by their shares."""
    total = sum(shares)
    steps = trainer.max_steps
    if trainer.max_epochs is not None:
        by_epochs = max(1, round(trainer.max_epochs * frames / batch_size))
        steps = by_epochs if steps is None else min(steps, by_epochs)
    seconds = None if trainer.max_time is None else seconds_of(trainer.max_time)
    if steps is not None and steps < sum(share > 0 for share in shares):
        raise UserError(f"{steps} steps are too few for {sum(s > 0 for s in shares)} stages: one each at least.")
    ends = [0] if steps is None else [round(steps * sum(shares[: i + 1]) / total) for i in range(len(shares))]
    return [
        StageBudget(
            None if steps is None else max(1, ends[i] - (ends[i - 1] if i else 0)),
            None if seconds is None else seconds * share / total,
        )
        for i, share in enumerate(shares)
    ]


def run_stage(
    name: str,
    module: LifterTraining,
    settings: TrainerSettings,
    budget: StageBudget,
    folder: Path,
    before: float = 0.0,
    on_save: Callable[[], None] | None = None,
) -> Budget:
    """Train ``module`` for its budget, or what is left of it where ``folder`` has a checkpoint of it.

    ``before`` are seconds of the budget that are spent already; ``on_save`` is called after each checkpoint.

    Raises:
        Interrupted: after Ctrl-C, with everything saved.
        UserError: a checkpoint that does not fit, settings that Lightning refuses.
    """
    path = folder / "checkpoints" / f"{name}.ckpt"
    clock = Budget(steps=budget.steps, seconds=budget.seconds, spent=min(before, 0.5 * (budget.seconds or 0)))
    resume = path.is_file()
    if resume and check_checkpoint(path, module) >= 1:
        state = read_torch(path, "checkpoint")
        module.load_state_dict(state["state_dict"])
        clock.load_state_dict(state["callbacks"][clock.state_key])
        return clock
    saver = Checkpoints(path, seconds=settings.checkpoint_every, steps=settings.checkpoint_steps, on_save=on_save)
    callbacks: list[L.Callback] = [
        clock,
        Progress(name, clock),
        MetricsFile(folder / "metrics.csv", name, settings.log_every),
        saver,
    ]
    if settings.threads is None and budget.steps is None:
        callbacks.append(Threads())
    with clock, _quiet():
        trainer = _trainer(settings, callbacks, folder)
        trainer.fit(module, ckpt_path=str(path) if resume else None, weights_only=True)
    if clock.interrupted:
        raise Interrupted(folder)
    return clock


def _trainer(settings: TrainerSettings, callbacks: list[L.Callback], folder: Path) -> L.Trainer:
    devices: int | str = int(settings.devices) if settings.devices.lstrip("-").isdigit() else settings.devices
    try:
        return L.Trainer(
            accelerator=settings.accelerator,
            devices=devices,
            precision=settings.precision,  # type: ignore[arg-type]
            logger=_logger(settings.logger, folder),
            callbacks=callbacks,
            max_epochs=-1,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            num_sanity_val_steps=0,
            use_distributed_sampler=False,
            default_root_dir=folder,
        )
    except (ValueError, TypeError, RuntimeError, MisconfigurationException) as error:
        raise UserError(
            f"Lightning refuses trainer.accelerator={settings.accelerator}, trainer.devices={settings.devices}, "
            f"trainer.precision={settings.precision}: {error}"
        ) from error


def _logger(name: str | None, folder: Path):
    if name in (None, "none", "csv"):
        return False
    from lightning.pytorch import loggers

    kinds = {"tensorboard": "TensorBoardLogger", "wandb": "WandbLogger"}
    if name not in kinds:
        raise UserError(
            f"trainer.logger={name!r}: expected one of {', '.join(kinds)}, or none (metrics.csv is always written)."
        )
    try:
        return getattr(loggers, kinds[name])(save_dir=str(folder), name=name)
    except ModuleNotFoundError as error:
        raise UserError(f"trainer.logger={name}: {str(error).splitlines()[0]}") from error


class _quiet:
    """Keep Lightning from telling what our own lines say better."""

    def __enter__(self) -> None:
        names = [n for n in logging.root.manager.loggerDict if n.split(".")[0] in ("lightning", "lightning_fabric")]
        self._levels = {name: logging.getLogger(name).level for name in names}
        for name in self._levels:
            logging.getLogger(name).setLevel(logging.ERROR)
        self._caught = warnings.catch_warnings()
        self._caught.__enter__()
        warnings.filterwarnings("ignore", module="lightning")
        warnings.filterwarnings("ignore", message=".*(num_workers|log_every_n_steps|litlogger|tensorboardX).*")

    def __exit__(self, *error: object) -> None:
        self._caught.__exit__(*error)  # type: ignore[arg-type]
        for name, level in self._levels.items():
            logging.getLogger(name).setLevel(level)


# The stages of a fit: a teacher, then students of its poses; the supervised student where all frames are labelled.


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
        labelled = (
            LabelledSampler(self.data.labelled, settings.data.labelled.share).share
            if self.data.labels is not None
            else 0.0
        )
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
