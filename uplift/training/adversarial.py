"""Train a lifter from 2D alone: lift, rotate, and apply the priors (Kudo et al. 2018, generalised)."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from uplift.config.settings import StudentSettings, TeacherSettings, ViewSettings
from uplift.data.tensors import Batch, TrainingSet
from uplift.geometry.rotation import random_rotations, views_about_gravity
from uplift.models.lifter import Lifted, Lifter
from uplift.priors.base import Lift, Prior
from uplift.training.augmentation import TILT_WEIGHT, ViewMaker, depth_error, tilt_error
from uplift.training.base import LifterTraining
from uplift.training.objective import Logged, Objective
from uplift.training.pseudo_labels import PseudoPoses
from uplift.training.sampler import LabelledSampler

__all__ = ["AdversarialTraining", "draw_views", "make_lift"]


class AdversarialTraining(LifterTraining[Lifter, TrainingSet]):
    """Weighted priors over lifted poses and one random view of each.

    ``truth`` are the labelled poses: with the ``labelled`` prior the lifter also learns from random views of
    them. ``labelled_share`` is the share of labelled frames in a batch.
    """

    settings: TeacherSettings

    def __init__(
        self,
        lifter: Lifter,
        data: TrainingSet,
        settings: TeacherSettings,
        views: ViewSettings,
        priors: Mapping[str, Prior],
        weights: Mapping[str, float],
        seed: int,
        labelled_share: float | None = None,
        truth: PseudoPoses | None = None,
    ):
        super().__init__(lifter, data, settings, seed, Objective(priors, weights), settings.prior_learning_rate)
        self.truth, self.views, self.labelled_share = truth, views, labelled_share
        self.maker: ViewMaker | None = None
        self.sampler = LabelledSampler(data.labelled, labelled_share)

    def on_fit_start(self) -> None:
        """Move the frames to the model's device."""
        super().on_fit_start()
        self.sampler = LabelledSampler(self.data.labelled, self.labelled_share)
        if self.truth is not None and "labelled" in self.priors:
            truth = self.truth.to(self.device)
            self.maker = ViewMaker(truth, self.lifter.camera, StudentSettings(), count_root=self.views.count_root)

    def objective(self) -> tuple[Tensor, Logged]:
        """Return the weighted sum of all terms for one batch, and each term."""
        batch = self._batch()
        lift = self.last_lift = make_lift(self.lifter, batch, self.views, self.settings.hide)
        judged, losses = self.terms.judge(lift, self.global_step)
        real = batch if self.settings.same_real else self._batch()
        own, critic_losses = self.terms.train_adversaries(
            real.keypoints, lift.reprojected.detach() * lift.visible.unsqueeze(-1)
        )
        total, logged = judged + own, {**losses, **critic_losses}
        if self.maker is not None:
            term = self.sampler.share * self._labelled_views_loss(self.maker)
            total = total + self.terms.weights["labelled"] * term
            logged["labelled_views"] = term.detach()
        return total, logged

    def _labelled_views_loss(self, maker: ViewMaker) -> Tensor:
        """Return the error on random views of the labelled poses: a few frames show a body from a few sides only."""
        with torch.no_grad():
            views = maker(self.settings.batch_size)
        lifted = self.lifter(views.input, views.confidence, views.distance)
        loss = depth_error(lifted, views)
        if self.lifter.tilt == "predicted":
            loss = loss + TILT_WEIGHT * tilt_error(lifted, views)
        return loss

    def _batch(self) -> Batch:
        """Return a random batch, half of it mirrored if the skeleton has a mirror image."""
        batch = self.data.draw(self.sampler(self.settings.batch_size))
        if not (self.settings.mirror and self.lifter.skeleton.has_mirror_image):
            return batch
        which = torch.rand(len(batch), device=self.device) < 0.5
        return batch.mirrored(which, self.lifter.mirror_permutation)


def make_lift(lifter: Lifter, batch: Batch, views: ViewSettings, hide: float = 0.0) -> Lift:
    """Return the lifted batch with one random view each; a share ``hide`` of joints is hidden from the lifter."""
    hidden = torch.zeros_like(batch.confidence, dtype=torch.bool)
    if hide:
        hidden = (torch.rand_like(batch.confidence) < hide) & (batch.confidence > 0)
        hidden[:, lifter.skeleton.root_index] = False
    lifted = lifter(batch.keypoints, batch.confidence.masked_fill(hidden, 0), batch.distance)
    return Lift(
        skeleton=lifter.skeleton,
        keypoints=batch.keypoints,
        confidence=batch.confidence,
        hidden=hidden,
        pose=lifted.pose,
        tilt=lifted.tilt,
        lifted_keypoints=lifted.keypoints,
        view=draw_views(lifted, views, lifter.skeleton.gravity),
        scale=batch.scale,
        distance=batch.distance,
        lifter=lifter,
        **batch.beside(),
        renormalise_views=views.renormalise,
        count_root=views.count_root,
    )


def draw_views(lifted: Lifted, views: ViewSettings, gravity: bool) -> Tensor:
    """Return a rotation to a random view for each pose of the batch."""
    count, device = len(lifted.tilt), lifted.tilt.device
    if not gravity:
        return random_rotations(count, device)
    low, high = (torch.pi / 180 * angle for angle in views.azimuth_deg)
    azimuth = low + (high - low) * torch.rand(count, device=device)
    new_tilt = lifted.tilt
    if views.elevation == "batch":  # the tilts of the batch (ElePose, Wandt et al. 2022), with gradients to both
        new_tilt = lifted.tilt[torch.randperm(count, device=device)]
    elif views.elevation == "normal":  # statistics of this rank's batch
        new_tilt = lifted.tilt.mean() + lifted.tilt.std() * torch.randn(count, device=device)
    return views_about_gravity(lifted.tilt, azimuth, new_tilt)
