"""Train a lifter from 2D alone: lift, turn, and let the priors judge (Kudo et al. 2018, generalised)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn

from uplift.config.settings import StudentSettings, TeacherSettings, ViewSettings
from uplift.data.tensors import Batch, TrainingSet
from uplift.geometry.rotation import random_rotations, views_about_gravity
from uplift.models.lifter import Lifted, Lifter
from uplift.priors.base import Lift, Prior, PriorWatch
from uplift.training.augmentation import ViewMaker
from uplift.training.base import LifterTraining, Rows
from uplift.training.pseudo_labels import PseudoPoses

__all__ = ["AdversarialTraining", "draw_views", "make_lift"]

_TILT_WEIGHT = 0.1


class AdversarialTraining(LifterTraining):
    """Weighted priors over lifted poses and one random view of each.

    Terms train the lifter; a prior with an `own_loss` is held still meanwhile and then trained on
    detached views. All of it is one backward.
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
        super().__init__(lifter, data, settings, seed)
        self.truth = truth
        self.maker: ViewMaker | None = None
        self.labelled_share = labelled_share
        self.rows = Rows(data.labelled, labelled_share)
        self.views = views
        self.priors = nn.ModuleDict(priors)
        self.weights = dict(weights)
        self.adversarial = [name for name, p in priors.items() if type(p).own_loss is not Prior.own_loss]
        self.watch = PriorWatch(priors)

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return the lifter's group and one for each prior that has parameters."""
        groups = super().parameter_groups()
        for name, prior in self.priors.items():
            parameters = list(prior.parameters())
            if parameters:
                rate = self.settings.prior_learning_rate or self.settings.learning_rate
                groups.append({"params": parameters, "lr": rate, "name": name})
        return groups

    def on_fit_start(self) -> None:
        """Put the frames, and which of them are labelled, where the model is."""
        super().on_fit_start()
        self.rows = Rows(self.data.labelled, self.labelled_share)
        if self.truth is not None and "labelled" in self.priors:
            truth = self.truth.to(self.device)
            self.maker = ViewMaker(truth, self.lifter.camera, StudentSettings(), count_root=self.views.count_root)

    def draw(self, count: int) -> Tensor:
        """Return ``count`` random frame numbers, of which the set share is labelled."""
        return self.rows(count)

    def objective(self) -> tuple[Tensor, dict[str, float | Tensor]]:
        """Return the weighted sum of all terms for one batch."""
        batch = self._batch()
        lift = make_lift(self.lifter, batch, self.views, self.settings.hide)
        total, logged = lift.pose.new_zeros(()), {}
        with _held_still([self.priors[name] for name in self.adversarial]):
            for name in self.priors:
                term = self.watch.loss(name, lift, self.global_step)
                total = total + self.weights[name] * term
                logged[name] = term.detach()
        real = batch if self.settings.same_real else self._batch()
        visible = lift.visible.unsqueeze(-1)
        for name in self.adversarial:
            own = self.watch.own_loss(name, real.keypoints, lift.seen.detach() * visible)
            if own is not None:
                total = total + own
                logged[f"{name}_own"] = own.detach()
        if self.maker is not None:
            term = self.rows.share * self._on_true_views(self.maker)
            total = total + self.weights["labelled"] * term
            logged["labelled_views"] = term.detach()
        self.last_lift = lift
        return total, logged

    def _on_true_views(self, maker: ViewMaker) -> Tensor:
        """Return the error of the lifter on true poses with limbs of one another, seen from everywhere.

        Few labelled frames are seen from few sides; what is known of them is known from all.
        """
        with torch.no_grad():
            views = maker(self.settings.batch_size)
        lifted = self.lifter(views.given, views.shown, views.distance)
        error = (lifted.pose[..., 2] - views.pose[..., 2]).abs()
        loss = (error * views.sure).sum() / views.sure.sum().clamp_min(1)
        if self.lifter.tilt == "predicted":
            loss = loss + _TILT_WEIGHT * (lifted.tilt - views.tilt).abs().mean()
        return loss

    def _batch(self) -> Batch:
        """Return a random batch, half of it mirrored."""
        batch = self.data.draw(self.draw(self.settings.batch_size))
        if not self.mirrors:
            return batch
        which = torch.rand(len(batch), device=self.device) < 0.5
        return batch.mirrored(which, self.lifter.mirror_permutation)

    def gated_parameters(self) -> Iterator[nn.Parameter]:
        """Return the lifter's parameters or a prior's where a prior asked for it in this step."""
        for prior in self.priors.values():
            if prior.gate_itself:
                yield from prior.parameters()
            if prior.gate_lifter:
                yield from self.lifter.parameters()

    def more_metrics(self) -> dict[str, float]:
        """Return what the priors want logged of the last step."""
        with torch.no_grad():
            found = [self.watch.metrics(name, self.last_lift) for name in self.priors]
        return {key: value for one in found for key, value in one.items()}


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
    tilt = lifted.tilt
    if views.elevation == "batch":
        # New cameras tilt as the batch's own do (ElePose, Wandt et al. 2022), with gradients to both.
        return views_about_gravity(tilt, azimuth, tilt[torch.randperm(count, device=device)])
    if views.elevation == "normal":
        # Batch statistics: mean and spread over all ranks would be better still under DDP.
        new = tilt.mean() + tilt.std() * torch.randn(count, device=device)
        return views_about_gravity(tilt, azimuth, new)
    return views_about_gravity(tilt, azimuth, tilt)


@contextmanager
def _held_still(modules: list[nn.Module]) -> Iterator[None]:
    """Freeze the modules' parameters: their gradients are not computed, what flows through them is."""
    parameters = [p for module in modules for p in module.parameters() if p.requires_grad]
    for parameter in parameters:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in parameters:
            parameter.requires_grad_(True)
