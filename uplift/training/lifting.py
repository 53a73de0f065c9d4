"""`LiftingModule`: learn to lift from 2D alone: lift, rotate, and apply the priors (Kudo et al. 2018, generalised)."""

from __future__ import annotations

import copy
import dataclasses
import warnings
import weakref
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.config import ranks
from uplift.config.files import refuse_existing
from uplift.config.settings import LifterSettings, Settings, StudentSettings, TeacherSettings, ViewSettings
from uplift.config.trust import consents
from uplift.data.module import KeypointData, skeleton_of
from uplift.data.poses import PoseData
from uplift.data.sampler import LabelledSampler
from uplift.data.stream import Resident
from uplift.data.tensors import Batch, TrainingSet
from uplift.errors import UserError
from uplift.geometry.normalise import normalise
from uplift.metrics.evaluate import evaluate_model
from uplift.metrics.score_2d import LEAST_FRAMES, score_2d
from uplift.models.lifter import Lifter
from uplift.models.model import Model, load_poses
from uplift.models.prediction import Prediction
from uplift.models.transfer import copy_weights
from uplift.priors import build_priors
from uplift.priors.base import Lift, Prior
from uplift.skeleton import Skeleton
from uplift.training.augmentation import TILT_WEIGHT, ViewMaker, depth_error, tilt_error
from uplift.training.base import (
    TrainingModule,
    add_given,
    plain_settings,
    prior_specs,
    saved_priors,
    seeded,
    stage_settings,
)
from uplift.training.objective import Logged, Objective, prepare_priors
from uplift.training.pseudo_labels import PseudoPoses, true_poses
from uplift.training.views import ViewFunction, build_views, checked_view

__all__ = ["KeypointModule", "LiftingModule", "make_lift"]


class KeypointModule(TrainingModule[Lifter, Any]):
    """What modules that train a lifter of keypoints share: the lifter's settings, inference, and figures."""

    prepares_anywhere: ClassVar[bool] = True
    skeleton: Skeleton
    lifter_settings: LifterSettings
    _sized: bool = False
    azimuth_deg: tuple[float, float] = (-180.0, 180.0)
    """The range of the turn about gravity that bodies are seen from."""

    def configure_lifter(self) -> Lifter:
        """Return the untrained lifter. A subclass may pass ``network=`` to `Lifter`, any module of its sizes."""
        return Lifter(self.skeleton, self.lifter_settings)

    def lifters(self) -> list[Lifter]:
        """Return the lifter, and the one of averaged weights where there is one."""
        return [self.lifter] if self.averaged is None else [self.lifter, self.final]

    def model(self) -> Model:
        """Return a copy of the trained lifter as people use it: call it on pixels, `predict`, `save`."""
        return Model(copy.deepcopy(self.final).eval(), self.skeleton, self.lifter_settings)

    def start_from(self, given: Model | str | Path) -> dict[str, tuple[str, ...]]:
        """Copy what a trained lifter has learned, joint by joint of the same name, before training.

        Args:
            given: a `uplift.Model`, or a run or file that `uplift.load` takes.

        Returns the joints that it knows, each with those of its own skeleton that they are made of.

        Raises:
            UserError: too few joints in common, or a network of another kind or size.
        """
        model = given if isinstance(given, Model) else load_poses(given)
        shared: dict[str, tuple[str, ...]] = {}
        for lifter in self.lifters():
            shared = copy_weights(lifter, model.lifter)
        return shared

    def save(self, path: str | Path) -> None:
        """Write `model` to one file, which `uplift.load` and the command line take; raises UserError where it exists."""
        refuse_existing(Path(path))
        self.model().save(Path(path))

    def to_batch(
        self, keypoints: Float[Tensor, "batch joints 2"], confidence: Float[Tensor, "batch joints"] | None = None
    ) -> Batch:
        """Return keypoints in pixels as a batch in the lifter's units; gradients reach the keypoints.

        Args:
            keypoints: joints as in ``self.skeleton.joints``.
            confidence: 0..1, 0 is missing; all 1 if None.
        """
        keypoints = keypoints.to(self.lifter.bone_mm.dtype)  # a network that finds them may be in mixed precision
        if confidence is None:
            confidence = torch.ones_like(keypoints[..., 0])
        known = keypoints.isfinite().all(-1)
        keypoints, confidence = keypoints.where(known[..., None], 0.0), confidence.where(known, 0.0)
        count_root = self.lifter_settings.radius == "all"
        root, distance = self.skeleton.root_index, self.lifter_settings.distance
        normal = normalise(keypoints, confidence, root, count_root=count_root, distance=distance)
        guessed = torch.ones_like(normal.distance, dtype=torch.bool)
        return Batch(normal.keypoints, confidence, normal.scale_px, normal.distance, guessed=guessed)

    def forward(
        self, keypoints: Float[Tensor, "batch joints 2"], confidence: Float[Tensor, "batch joints"] | None = None
    ) -> Float[Tensor, "batch joints 3"]:
        """Return poses relative to the root, in pixels at the root's depth; camera frame: x right, y down, z away.

        Gradients reach the keypoints and the lifter. Takes what `to_batch` takes.
        """
        batch = self.to_batch(keypoints, confidence)
        lifted = self.lifter(batch.keypoints, batch.confidence, batch.distance, batch.guessed)
        return lifted.pose * batch.scale[:, None, None]

    def predict_step(self, batch: PoseData, batch_idx: int) -> Prediction:
        """Return `Model.predict` of the frames, as ``uplift predict`` computes it."""
        with self.inference():
            return self.model().predict(batch)

    def figures(self, batch: PoseData) -> dict[str, float]:
        """Return every protocol by name where ``batch`` has true poses, and a score of the 2D alone where it has none."""
        if batch.pose is None:
            if len(batch) < LEAST_FRAMES:
                warnings.warn(
                    f"val: {len(batch)} frames are too few for a score without truth, expected {LEAST_FRAMES} or more: "
                    "hold out more (val=0.3), or none (val=0). Nothing is logged.",
                    stacklevel=1,
                )
                return {}
            return score_2d(self.model(), batch, azimuth_deg=self.azimuth_deg)
        return evaluate_model(self.model(), batch, batch.source).overall

    def _checked(self, data: Any) -> KeypointData:
        """Return the data module; raises UserError for none, or for another skeleton."""
        if not isinstance(data, KeypointData):
            raise UserError(
                f"{type(self).__name__} trains on a uplift.KeypointData, found {type(data).__name__}: "
                "trainer.fit(module, datamodule=data). With loaders of your own, call module.prepare(data) first."
            )
        if data.skeleton.joints != self.skeleton.joints:
            raise UserError(
                f"the data have skeleton '{data.skeleton.name}' ({len(data.skeleton.joints)} joints), the module "
                f"'{self.skeleton.name}' ({len(self.skeleton.joints)} joints): build it with data.skeleton."
            )
        self.prepared_with = weakref.ref(data)
        return data

    def _take_sizes(self, data: KeypointData) -> None:
        """Set the size of the labelled bodies, where it is known."""
        bone_mm = data.bone_mm(self.lifter_settings)
        if bone_mm is None and self._sized:  # those of other bodies
            bone_mm = torch.zeros_like(self.lifter.bone_mm)
        if bone_mm is not None:
            self._sized = True
            for lifter in self.lifters():
                lifter.bone_mm.copy_(bone_mm.nan_to_num())


class LiftingModule(KeypointModule):
    """Learn to lift from 2D alone: weighted priors judge lifted poses and one random view of each.

    With labelled frames, the ``labelled`` prior also learns from random views of them.

    Example::

        module = uplift.LiftingModule(data.skeleton, priors={"flow": 1.0, "bones": {"weight": 10.0}})

    Hooks for subclasses: `configure_lifter`, `configure_priors`, `configure_views`, `objective`, and those of
    Lightning. Random numbers of a step depend on ``seed`` and the step alone: several ranks share out one batch.

    Args:
        skeleton: a `uplift.Skeleton`, a shipped name, or a YAML file.
        priors: for each prior its weight, its settings (``use``, ``weight`` and options), its class or a
            `uplift.Prior`; those of the default recipe if None.
        lifter: settings ``lifter.NAME`` by name: ``network``, ``options``, ``camera``, ``tilt``, ...
        views: settings ``views.NAME`` by name.
        seed: of the weights and of all random numbers.
        like_student: the lifter also has the outputs that only students learn, so that it can start from one
            (`start_from`) and one can go on from it.
        training: settings ``teacher.NAME`` by name: ``learning_rate``, ``decay_from``, ``average``, ...

    Raises:
        UserError: an unknown or invalid setting, a prior that does not fit the skeleton.
    """

    settings: TeacherSettings
    frames: TrainingSet | None = None
    resident: Resident | None = None
    """What changes `frames` in training on more than memory holds."""

    @consents
    def __init__(
        self,
        skeleton: Skeleton | str | Path | Mapping[str, Any],
        *,
        priors: Mapping[str, Any] | None = None,
        lifter: Mapping[str, Any] | None = None,
        views: Mapping[str, Any] | None = None,
        seed: int = 0,
        like_student: bool = False,
        **training: Any,
    ):
        super().__init__()
        self.skeleton = skeleton_of(skeleton)
        specs, self._given_priors = prior_specs(priors)
        chosen = stage_settings("teacher", training, priors=specs, lifter=lifter, views=views, seed=seed)
        # Only students learn to predict the uncertainty and depth signs, to correct visible joints, and to estimate any camera.
        unused = {} if like_student else {"uncertainty": False, "signs": 0, "cameras": "own"}
        self.lifter_settings = dataclasses.replace(chosen.lifter, denoise=False, **unused)
        self.view_settings, self.prior_specs = chosen.views, chosen.priors
        self.azimuth_deg, self.prior_rate = chosen.views.azimuth_deg, chosen.teacher.prior_learning_rate
        self._keep_hyperparameters(chosen, like_student)
        self.notes: list[str] = []
        """What was left out of the priors, one sentence each."""
        with seeded(seed):
            terms = Objective(*self.configure_priors())
            lifter_module = self.configure_lifter()
            self._stream = torch.get_rng_state()
        self.draw_views = self.configure_views()
        self.truth: PseudoPoses | None = None
        self.maker: ViewMaker | None = None
        self.set_up(lifter_module, chosen.teacher, seed, terms)

    def _keep_hyperparameters(self, chosen: Settings, like_student: bool) -> None:
        """Save the arguments as plain data: a checkpoint holds nothing that can run."""
        views = {key: value for key, value in dataclasses.asdict(chosen.views).items() if key != "count_root"}
        self.save_hyperparameters(
            {
                "skeleton": self.skeleton.to_dict(),
                "priors": saved_priors(chosen.priors, self._given_priors),
                "lifter": dataclasses.asdict(self.lifter_settings),
                "views": views,
                "seed": chosen.seed,
                **({"like_student": True} if like_student else {}),
                **plain_settings(chosen.teacher),
            }
        )

    # Hooks.

    def configure_priors(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Return the priors by name, and their weights."""
        priors, weights, self.notes = build_priors(self.prior_specs, self.skeleton)
        add_given(priors, weights, self._given_priors, self.skeleton)
        if not priors:
            raise UserError(
                "No prior is on: nothing would train the lifter. Set priors.NAME.use and priors.NAME.weight."
            )
        return priors, weights

    def configure_views(self) -> ViewFunction:
        """Return what makes new views of lifted poses: a `uplift.Views`, or any function of `Lifted`."""
        return build_views(self.view_settings, self.skeleton)

    # Training.

    def prepare(self, data: KeypointData | Any) -> None:
        """Take the training frames, show them to the priors, and look at their labels."""
        data = self._checked(data)
        self._take_sizes(data)
        self.truth = self.maker = None
        frames = self.frames = data.frames(self.lifter_settings).to(self.device)
        self.labelled_share = data.labelled_share
        self.sampler = LabelledSampler(frames.labelled, self.labelled_share)
        labelled = bool(frames.labelled.any())
        unlabelled = not labelled and self.prior_specs.get("labelled", {}).get("if_possible")
        self.terms = Objective(dict(self.priors.items()), self.terms.weights)  # type: ignore[arg-type]
        if unlabelled:
            self.terms.leave_out("labelled")
        with seeded(0):
            torch.set_rng_state(self._stream)
            prepare_priors(self.terms.priors, frames)
        if labelled and "labelled" in self.terms.priors:
            truth = frames.select(frames.labelled)
            self.truth = true_poses(truth, self.lifter.camera, tilted=self.lifter.tilt != "level")

    def on_train_start(self) -> None:
        """Draw from what is resident in the first step, where the data are more than memory holds."""
        super().on_train_start()
        data: KeypointData | None = self.prepared_with() if self.prepared_with else None
        if data is None:
            return
        batch = data.batch_size * self.trainer.accumulate_grad_batches
        self.resident = data.resident(self.lifter_settings, self.device, batch=batch, step=self.global_step)
        if self.resident is not None:
            self.frames = self.resident.frames
            self.sampler = LabelledSampler(self.frames.labelled, self.labelled_share)

    def on_train_batch_start(self, *rest: Any) -> None:
        """Put other frames in the place of those that have been drawn from long enough."""
        if self.resident is not None:
            self.resident.advance(self.global_step)

    def on_train_end(self) -> None:
        """Read no more frames."""
        super().on_train_end()
        if self.resident is not None:
            self.resident.close()

    def objective(self, batch: Any) -> tuple[Tensor, Logged]:
        """Return the weighted sum of all terms, and each term; `last_lift` is what was judged.

        Args:
            batch: how many of `frames` to draw; or a `Batch`; or keypoints (batch joints 2) in pixels, alone, as
                (keypoints, confidence), or as a mapping with those names.
        """
        with self.mixed_networks():
            drawn = self._mirrored(self._batch(batch))
            lift = self.last_lift = self.lift(drawn)
            judged, losses = self.terms.judge(lift, self.global_step)
            again = isinstance(batch, int) and not self.settings.same_real
            real = self._mirrored(self._batch(batch)) if again else drawn
            own, critic_losses = self.terms.train_adversaries(
                real.keypoints, lift.reprojected.detach() * lift.visible.unsqueeze(-1)
            )
            total, logged = judged + own, {**losses, **critic_losses}
            if self.truth is not None and isinstance(batch, int):
                term = self.sampler.share * self._labelled_views_loss(batch)
                total = total + self.terms.weights["labelled"] * term
                logged["labelled_views"] = term.detach()
        return total, logged

    def rows_of(self, batch: Any) -> int:
        """Return how many frames are in a batch of any of the kinds that `objective` takes."""
        if isinstance(batch, (int, Batch)):
            return batch if isinstance(batch, int) else len(batch)
        first = batch["keypoints"] if isinstance(batch, Mapping) else batch
        return len(first[0] if isinstance(first, (tuple, list)) else first)

    def lift(self, batch: Batch) -> Lift:
        """Return the lifted batch with one new view of each pose."""
        return make_lift(self.lifter, batch, self.draw_views, self.view_settings, self.settings.hide)

    def _labelled_views_loss(self, count: int) -> Tensor:
        """Return the error on random views of the labelled poses: a few frames show a body from a few sides only."""
        if self.maker is None or self.maker.poses.pose.device != self.device:
            assert self.truth is not None
            truth, count_root = self.truth.to(self.device), self.view_settings.count_root
            self.maker = ViewMaker(truth, self.lifter.camera, StudentSettings(), count_root=count_root)
        with torch.no_grad(), ranks.alone():
            views = self.maker(count)
        views = views.select(ranks.my_rows())
        lifted = self.lifter(views.input, views.confidence, views.distance)
        loss = depth_error(lifted, views)
        if self.lifter.tilt == "predicted":
            loss = loss + TILT_WEIGHT * tilt_error(lifted, views)
        return loss

    def _batch(self, given: Any) -> Batch:
        """Return a random batch of ``given`` frames, or the batch that is given."""
        if isinstance(given, Batch):
            return given
        if isinstance(given, int):
            if self.frames is None:
                raise UserError("the module has no training frames: call module.prepare(data) first.")
            if self.frames.keypoints.device != self.device:
                self.frames = self.frames.to(self.device)
            if self.sampler.device != self.frames.keypoints.device:
                self.sampler = LabelledSampler(self.frames.labelled, self.labelled_share)
            return self.frames.draw(self.sampler(given)[ranks.my_rows()])
        if isinstance(given, Mapping):
            return self.to_batch(given["keypoints"], given.get("confidence"))
        return self.to_batch(*given) if isinstance(given, (tuple, list)) else self.to_batch(given)

    def _mirrored(self, batch: Batch) -> Batch:
        """Return the batch, half of it mirrored if the skeleton has a mirror image."""
        if not (self.settings.mirror and self.skeleton.has_mirror_image):
            return batch
        which = ranks.drawn(len(batch), partial(torch.rand, device=batch.keypoints.device)) < 0.5
        return batch.mirrored(which, self.lifter.mirror_permutation)


def make_lift(lifter: Lifter, batch: Batch, views: ViewFunction, settings: ViewSettings, hide: float = 0.0) -> Lift:
    """Return the lifted batch with one view of ``views`` each; a share ``hide`` of joints is hidden from the lifter."""
    hidden = torch.zeros_like(batch.confidence, dtype=torch.bool)
    if hide:
        joints, device = batch.confidence.shape[1], batch.confidence.device
        chance = ranks.drawn(len(batch), lambda rows: torch.rand(rows, joints, device=device))
        hidden = (chance < hide) & (batch.confidence > 0)
        hidden[:, lifter.skeleton.root_index] = False
    lifted = lifter(batch.keypoints, batch.confidence.masked_fill(hidden, 0), batch.distance)
    view = checked_view(views, lifted)
    return Lift(
        skeleton=lifter.skeleton,
        keypoints=batch.keypoints,
        confidence=batch.confidence,
        hidden=hidden,
        pose=lifted.pose,
        tilt=lifted.tilt,
        lifted_keypoints=lifted.keypoints,
        view=view,
        scale=batch.scale,
        distance=batch.distance,
        lifter=lifter,
        **batch.beside(),
        renormalise_views=settings.renormalise,
        count_root=settings.count_root,
    )
