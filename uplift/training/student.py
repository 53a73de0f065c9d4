"""`StudentModule`, the second stage: a new lifter learns from pseudo labels, augmented and seen from all sides."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from uplift.config import ranks
from uplift.config.plugins import blame, build
from uplift.config.settings import LifterSettings, Settings, StudentSettings
from uplift.config.trust import consents
from uplift.data.module import KeypointData, skeleton_of
from uplift.errors import UserError
from uplift.models.lifter import Lifted, Lifter
from uplift.models.model import Model
from uplift.skeleton import Skeleton
from uplift.training.augmentation import (
    TILT_WEIGHT,
    ShownViews,
    ViewMaker,
    depth_error,
    distance_error,
    gravity_error,
    tilt_error,
)
from uplift.training.base import plain_settings, seeded, stage_settings, stream_seed
from uplift.training.lifting import KeypointModule
from uplift.training.objective import Logged
from uplift.training.pseudo_labels import PseudoPoses, lift_all, true_poses

__all__ = ["BATCHES_AT_ONCE", "StudentLoss", "StudentModule", "student_settings"]

BATCHES_AT_ONCE = 16
"""Batches of views that are made together: a single one is mostly overhead."""
_UNCERTAINTY_WEIGHT = 0.05
_SIGN_WEIGHT = 0.05
"""Of the cross-entropy; Adam makes the learning of a network of its own nearly independent of it."""
_GRAVITY_WEIGHT = 0.3
_DISTANCE_WEIGHT = 0.05


class StudentLoss(nn.Module):
    """How far a student is from the poses it is shown: absolute errors; subclass it for another loss.

    A subclass is named as ``student.loss=my.py:MyLoss``; options are keyword arguments of ``__init__``, set below
    ``student.loss_options``.
    """

    def __init__(self, skeleton: Skeleton):
        super().__init__()
        self.skeleton = skeleton

    def forward(self, lifted: Lifted, views: ShownViews, lifter: Lifter) -> tuple[Tensor, Logged]:
        """Return one number, and the terms to log, by name.

        Depths count, and keypoints, uncertainty, depth signs, tilt or gravity, and distance where the lifter predicts them.

        Args:
            lifted: what the lifter makes of ``views.input``.
            views: the input and the true keypoints, poses, gravity and distances, in the same units.
            lifter: says what it predicts: ``fill``, ``denoise``, ``uncertainty``, ``tilt``.
        """
        turned, views = views, views.only_upright()
        known = ranks.total(views.weight.sum())[0].clamp_min(1)
        loss = depth_error(lifted, views)
        logged: Logged = {"depth": loss.detach()}
        hidden = views.confidence == 0
        if lifter.denoise or (lifter.fill and self.occludes):
            # Visible joints that the lifter leaves in place do not count, unless the root is missing.
            moved = hidden | hidden[:, self.skeleton.root_index, None]
            weight = views.weight if lifter.denoise else views.weight * moved
            error = ((lifted.keypoints - views.keypoints).abs().sum(-1) * weight).sum()
            error, moving = ranks.total(error, weight.sum())
            loss = loss + error / known
            logged["fill"] = (error / moving.clamp_min(1)).detach()
        if lifted.uncertainty is not None:
            (surprise,) = ranks.total(_uncertainty_loss(lifted, views, lifted.uncertainty))
            loss = loss + _UNCERTAINTY_WEIGHT * surprise / known
            (logged["uncertainty"],) = ranks.mean(lifted.uncertainty.detach().mean())
        if lifted.signs is not None:
            states = lifter.chains.states(turned.pose, turned.distance)
            (signs,) = ranks.mean(lifter.chains.loss(lifted.signs, states, turned.weight))
            loss = loss + _SIGN_WEIGHT * signs
            logged["signs"] = signs.detach()
        if lifted.gravity is not None:
            gravity = gravity_error(lifted, views)
            loss = loss + _GRAVITY_WEIGHT * gravity
            logged["gravity"] = gravity.detach()
        elif lifter.tilt == "predicted":
            tilt = tilt_error(lifted, views)
            loss = loss + TILT_WEIGHT * tilt
            logged["tilt"] = tilt.detach()
        if lifted.distance is not None:
            distance = distance_error(lifted, views)
            loss = loss + _DISTANCE_WEIGHT * distance
            logged["distance"] = distance.detach()
        return loss, logged

    occludes: bool = True
    """Whether views have hidden joints."""


def _uncertainty_loss(lifted: Lifted, views: ShownViews, uncertainty: Tensor) -> Tensor:
    """Return the sum of the negative log-likelihoods of the errors under Laplace distributions of scale ``uncertainty``.

    The error is that of the depth, or of the position where a joint is hidden. Poses do not learn from it.
    """
    scale = uncertainty.clamp_min(1e-6)
    difference = (lifted.pose - views.pose).detach()
    error = torch.where(views.confidence == 0, difference.norm(dim=-1), difference[..., 2].abs())
    return ((error / scale + scale.log()) * views.weight * (uncertainty > 0)).sum()


class StudentModule(KeypointModule):
    """Lift random augmented views of a teacher's poses back to those poses.

    The teacher saw each pose from one side only; the student sees it from all sides, with limbs of other poses,
    and generalises better. It learns from nothing but what the teacher made of 2D keypoints. Where every frame is
    labelled it learns from the labels, and needs no teacher.

    Example::

        student = uplift.StudentModule(data.skeleton, teacher=module)

    Hooks for subclasses: `configure_lifter`, `configure_loss`, `objective`, and those of Lightning.

    Args:
        skeleton: a `uplift.Skeleton`, a shipped name, or a YAML file.
        teacher: a trained module, a `uplift.Model`, or a run or file that `uplift.load` takes; or see `learn_from`.
            One with a network of its own is given as ``uplift.load(run, trust="my_nets.py")``.
            It is not part of the student's checkpoint.
        lifter: settings ``lifter.NAME`` by name; those of the default recipe's last student if None.
        seed: of the weights and of all random numbers.
        training: settings ``student.NAME`` by name: ``learning_rate``, ``occlude``, ``mix``, ``frames``, ...

    Raises:
        UserError: an unknown or invalid setting.
    """

    settings: StudentSettings
    frames: PseudoPoses | None = None

    @consents
    def __init__(
        self,
        skeleton: Skeleton | str | Path | Mapping[str, Any],
        *,
        teacher: Any = None,
        lifter: Mapping[str, Any] | None = None,
        seed: int = 0,
        **training: Any,
    ):
        super().__init__()
        self.skeleton = skeleton_of(skeleton)
        chosen = stage_settings("student", training, lifter=lifter, seed=seed)
        if lifter is None:
            self.lifter_settings = student_settings(chosen, last=True)
        else:
            cameras = chosen.lifter.cameras if "cameras" in lifter else _cameras(chosen)
            self.lifter_settings = dataclasses.replace(chosen.lifter, cameras=cameras)
        self.save_hyperparameters(
            {
                "skeleton": self.skeleton.to_dict(), "lifter": dataclasses.asdict(self.lifter_settings), "seed": seed,
                **plain_settings(chosen.student),
            }
        )  # fmt: skip
        self._denoise = self.lifter_settings.denoise
        self.learn_from(teacher)
        with seeded(seed):
            self.set_up(self.configure_lifter(), chosen.student, seed)
            self.loss = self.configure_loss()
        self._made: tuple[int, int, ShownViews] | None = None
        self._maker: ViewMaker | None = None

    def learn_from(self, teacher: Any) -> None:
        """Set the teacher, as the argument of that name does; None for none."""
        self._teacher = (teacher,)  # in a tuple it is no submodule: neither trained nor saved

    def configure_loss(self) -> nn.Module:
        """Return the loss: a `uplift.StudentLoss`, or any module that takes what it takes."""
        use, options = self.settings.loss, self.settings.loss_options
        if use is not None:
            return build(
                use, {}, options, "student.loss_options", StudentLoss, setting="student.loss", skeleton=self.skeleton
            )
        if options:
            raise UserError("student.loss_options are those of a class of your own: set student.loss=file.py:Class.")
        loss = StudentLoss(self.skeleton)
        loss.occludes = bool(self.settings.occlude)
        return loss

    def prepare(self, data: KeypointData | Any) -> None:
        """Take the teacher's poses of the training frames, or the labels if every frame has one."""
        data = self._checked(data)
        self._take_sizes(data)
        (given,) = self._teacher
        teacher = None if given is None else _lifter_of(given)
        any_camera = teacher is not None and teacher.any_camera
        frames = data.frames(dataclasses.replace(self.lifter_settings, cameras="any" if any_camera else "own"))
        frames = frames.to(self.device)
        if bool(frames.labelled.all()):
            poses = true_poses(frames, self.lifter.camera, tilted=self.lifter.tilt != "level")
        elif teacher is None:
            raise UserError(
                "StudentModule needs teacher=... (a trained module, a model or a run), or labels of every frame."
            )
        else:
            if self.device.type != "cpu":
                teacher = copy.deepcopy(teacher).to(self.device)
            with ranks.work_shared():
                poses = lift_all(teacher, frames.some(self.settings.frames, self.seed), self.settings.refine)
        if teacher is not None and self.settings.warm:
            self._start_from(teacher)
        self._set_denoise(noisy=poses.noise is not None and self.settings.noise)
        self.frames, self.labelled_share = poses, data.labelled_share
        self._made = self._maker = None

    def _start_from(self, teacher: Lifter) -> None:
        """Copy the weights of the teacher, if the networks are the same."""
        shapes = [[(key, value.shape) for key, value in one.state_dict().items()] for one in (self.lifter, teacher)]
        if shapes[0] == shapes[1]:
            for lifter in self.lifters():
                lifter.load_state_dict(teacher.state_dict())

    def _set_denoise(self, *, noisy: bool) -> None:
        """Let the lifter move visible joints, where that is set or the keypoints are ``noisy``."""
        denoise = noisy if self._denoise is None else self._denoise
        self.lifter_settings = dataclasses.replace(self.lifter_settings, denoise=denoise)
        self.hparams["lifter"]["denoise"] = denoise
        for lifter in self.lifters():
            lifter.denoise = bool(denoise) and lifter.fill

    @property
    def maker(self) -> ViewMaker:
        """What makes views of the teacher's poses, on the module's device."""
        if self.frames is None:
            raise UserError("the module has no poses to learn from: call module.prepare(data) first.")
        if self._maker is None or self._maker.poses.pose.device != self.device:
            count_root, share = self.lifter_settings.radius == "all", self.labelled_share
            frames, camera = self.frames.to(self.device), self.lifter.camera
            settings = self.settings if self.lifter.signs is not None else replace(self.settings, any_way=0.0)
            usual = self.lifter_settings.distance if self.lifter.any_camera else None
            self._maker = ViewMaker(
                frames, camera, settings, count_root=count_root, labelled_share=share, usual_distance=usual
            )
        return self._maker

    def objective(self, batch: int | ShownViews) -> tuple[Tensor, Logged]:
        """Return the loss of views and its terms.

        Args:
            batch: how many views of the teacher's poses to make, or views.
        """
        loss, logged = self.judge(batch if isinstance(batch, ShownViews) else self._views(batch))
        (loss,) = ranks.mean(loss) if isinstance(loss, Tensor) else (loss,)
        if not isinstance(loss, Tensor) or loss.shape != () or not loss.requires_grad:
            raise UserError(
                "student.loss must return one number (a tensor of shape ()) that depends on what was lifted."
            )
        if loss.device.type == "cpu" and not bool(torch.isfinite(loss)):
            raise UserError(
                f"student.loss: loss is {loss.item()} at step {self.global_step}: look for a division by 0."
            )
        return loss, logged

    def judge(self, views: ShownViews) -> tuple[Tensor, Logged]:
        """Return the loss of ``views`` and its terms, unchecked."""
        with self.mixed_networks():
            lifted = self.lifter(views.input, views.confidence, views.told, views.guessed)
            with blame("student.loss: forward", type(self.loss)):
                found = self.loss(lifted, views, self.lifter)
        return found if isinstance(found, tuple) else (found, {})

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return the optimiser's groups: the lifter's, and the loss's where it has parameters."""
        of_loss = list(self.loss.parameters())
        group = {"params": of_loss, "lr": self.settings.learning_rate, "name": "loss"}
        return [*super().parameter_groups(), *([group] if of_loss else [])]

    def _views(self, size: int) -> ShownViews:
        """Return this step's views."""
        chunk, place = divmod(self.stream_step, BATCHES_AT_ONCE)
        if self._made is None or self._made[:2] != (chunk, size):
            self._made = (chunk, size, self.make_views(chunk, size))
            torch.manual_seed(self.step_seed)
        start, stop, _ = ranks.my_rows().indices(size)
        return self._made[2].select(slice(place * size + start, place * size + stop))

    def rows_of(self, batch: int | ShownViews) -> int:
        """Return how many views are in a batch."""
        return batch if isinstance(batch, int) else len(batch)

    def make_views(self, chunk: int, size: int) -> ShownViews:
        """Return the views of `BATCHES_AT_ONCE` steps in a row, the ``chunk``-th so many, of ``size`` views each.

        Each chunk has its own random stream, so that a resumed fit makes the same one again.
        """
        torch.manual_seed(stream_seed(self.seed + 1, chunk))
        with torch.no_grad(), ranks.alone():
            return self.maker(size * BATCHES_AT_ONCE)


def _lifter_of(teacher: Any) -> Lifter:
    """Return the lifter of a module, a model, a run, or a lifter itself."""
    if isinstance(teacher, KeypointModule):
        return teacher.final
    if isinstance(teacher, Lifter):
        return teacher
    if not isinstance(teacher, Model):
        from uplift.models.model import load_poses

        teacher = load_poses(teacher)
    return teacher.lifter


def student_settings(settings: Settings, *, last: bool) -> LifterSettings:
    """Return the lifter settings of a student, the ``last`` one or not."""
    student, lifter = settings.student, settings.lifter
    options = lifter.options if student.network is None else {}
    return dataclasses.replace(
        lifter,
        cameras=_cameras(settings) if last or student.warm else "own",  # a warm round goes on with one network
        network=student.network or lifter.network,
        options={**options, **student.options, **(student.last_options if last else {})},
    )


def _cameras(settings: Settings) -> str:
    """Return which cameras the last student learns: its data's own where no others can be made of them.

    Parallel rays have no distance, and a tilt that is not predicted is that of the data's cameras.
    """
    lifter, student = settings.lifter, settings.student
    made = lifter.camera == "perspective" and lifter.tilt == "predicted" and student.turn
    return student.cameras if made else "own"
