"""The second stage: a new lifter learns from pseudo labels, augmented and seen from all sides."""

from __future__ import annotations

import torch
from torch import Tensor

from uplift.config.settings import StudentSettings, ViewSettings
from uplift.models.lifter import Lifted, Lifter
from uplift.training.augmentation import TILT_WEIGHT, ShownViews, ViewMaker, depth_error, tilt_error
from uplift.training.base import LifterTraining, stream_seed
from uplift.training.objective import Logged
from uplift.training.pseudo_labels import PseudoPoses

__all__ = ["StudentTraining"]

_BATCHES_AT_ONCE = 16
"""Batches of views that are made together: a single one is mostly overhead."""
_UNCERTAINTY_WEIGHT = 0.05


class StudentTraining(LifterTraining[Lifter, PseudoPoses]):
    """Lift random augmented views of the teacher's poses back to those poses.

    The teacher saw each pose from one side only; the student sees it from all sides, with limbs of other poses,
    and generalises better. It learns from nothing but what the teacher made of 2D keypoints.
    """

    settings: StudentSettings

    def __init__(
        self,
        lifter: Lifter,
        data: PseudoPoses,
        settings: StudentSettings,
        views: ViewSettings,
        seed: int,
        labelled_share: float | None = None,
    ):
        super().__init__(lifter, data, settings, seed)
        self.labelled_share, self.views = labelled_share, views
        self._made: tuple[int, ShownViews] | None = None

    def on_fit_start(self) -> None:
        """Move the poses to the model's device and split them into limbs."""
        super().on_fit_start()
        count_root, share = self.views.count_root, self.labelled_share
        self.maker = ViewMaker(
            self.data, self.lifter.camera, self.settings, count_root=count_root, labelled_share=share
        )

    def objective(self) -> tuple[Tensor, Logged]:
        """Return the error of the depths, and of the keypoints, uncertainty and tilt where the lifter predicts them."""
        views, lifter = self._batch(), self.lifter
        lifted = lifter(views.input, views.confidence, views.distance)
        known = views.weight.sum().clamp_min(1)
        loss = depth_error(lifted, views)
        logged: Logged = {"depth": loss.detach()}
        if lifter.denoise or (lifter.fill and self.settings.occlude):
            # Visible joints that the lifter leaves in place do not count, unless the root is missing.
            hidden = views.confidence == 0
            moved = hidden | hidden[:, self.data.skeleton.root_index, None]
            weight = views.weight if lifter.denoise else views.weight * moved
            error = ((lifted.keypoints - views.keypoints).abs().sum(-1) * weight).sum()
            loss = loss + error / known
            logged["fill"] = error.detach() / weight.sum().clamp_min(1)
        if lifted.uncertainty is not None:
            loss = loss + _UNCERTAINTY_WEIGHT * _uncertainty_loss(lifted, views, lifted.uncertainty) / known
            logged["uncertainty"] = lifted.uncertainty.detach().mean()
        if lifter.tilt == "predicted":
            tilt = tilt_error(lifted, views)
            loss = loss + TILT_WEIGHT * tilt
            logged["tilt"] = tilt.detach()
        return loss, logged

    def _batch(self) -> ShownViews:
        """Return this step's views."""
        size = self.settings.batch_size
        chunk, place = divmod(self.global_step, _BATCHES_AT_ONCE)
        if self._made is None or self._made[0] != chunk:
            # Each chunk has its own random stream, so that a resumed fit makes the same one again.
            torch.manual_seed(stream_seed(self.seed + 1, self.global_rank, chunk))
            with torch.no_grad():
                self._made = (chunk, self.maker(size * _BATCHES_AT_ONCE))
            torch.manual_seed(stream_seed(self.seed, self.global_rank, self.global_step))
        return self._made[1].select(slice(place * size, (place + 1) * size))


def _uncertainty_loss(lifted: Lifted, views: ShownViews, uncertainty: Tensor) -> Tensor:
    """Return the sum of the negative log-likelihoods of the errors under Laplace distributions of scale ``uncertainty``.

    The error is that of the depth, or of the position where a joint is hidden. Poses do not learn from it.
    """
    scale = uncertainty.clamp_min(1e-6)
    difference = (lifted.pose - views.pose).detach()
    error = torch.where(views.confidence == 0, difference.norm(dim=-1), difference[..., 2].abs())
    return ((error / scale + scale.log()) * views.weight * (uncertainty > 0)).sum()
