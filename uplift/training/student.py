"""The second stage: a fresh lifter learns from the teacher's own poses, mixed and turned everywhere."""

from __future__ import annotations

import torch
from torch import Tensor

from uplift.config.settings import StudentSettings, ViewSettings
from uplift.models.lifter import Lifter
from uplift.training.augmentation import ShownViews, ViewMaker
from uplift.training.base import LifterTraining, stream_seed
from uplift.training.pseudo_labels import PseudoPoses

__all__ = ["StudentTraining"]

_BATCHES_AT_ONCE = 16
_TILT_WEIGHT = 0.1
_SPREAD_WEIGHT = 0.05


class StudentTraining(LifterTraining):
    """Lift random turned views of the teacher's poses back to those poses.

    The teacher saw each pose from one side, with the limbs it came with; the student sees it from
    everywhere, with the limbs of others, and generalises better for it. Nothing enters but what the
    teacher made of 2D keypoints.
    """

    data: PseudoPoses  # type: ignore[assignment]
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
        super().__init__(lifter, data, settings, seed)  # type: ignore[arg-type]
        self.labelled_share = labelled_share
        self.views = views
        self._made: tuple[int, ShownViews] | None = None

    def on_fit_start(self) -> None:
        """Put the poses where the model is and take them apart into limbs."""
        super().on_fit_start()
        self.maker = ViewMaker(
            self.data,
            self.lifter.camera,
            self.settings,
            count_root=self.views.count_root,
            labelled_share=self.labelled_share,
        )

    def objective(self) -> tuple[Tensor, dict[str, float | Tensor]]:
        """Return the mean depth error over the known joints, and what else the lifter can know."""
        views, lifter = self._batch(), self.lifter
        lifted = lifter(views.given, views.shown, views.distance)
        known = views.sure.sum().clamp_min(1)
        error = (lifted.pose[..., 2] - views.pose[..., 2]).abs()
        loss = (error * views.sure).sum() / known
        logged: dict[str, float | Tensor] = {"depth": loss.detach()}
        if lifter.denoise or (lifter.fill and self.settings.occlude):
            # Joints that the lifter leaves where they were seen have no say in it, unless the root was not.
            hidden = views.shown == 0
            moved = hidden | hidden[:, self.data.skeleton.root_index, None]
            moves = views.sure if lifter.denoise else views.sure * moved
            off = ((lifted.keypoints - views.keypoints).abs().sum(-1) * moves).sum()
            loss = loss + off / known
            logged["fill"] = off.detach() / moves.sum().clamp_min(1)
        if lifted.spread is not None:
            # Laplace: its scale is the mean absolute error, of a hidden joint that of its whole place. Poses do not learn from it.
            scale = lifted.spread.clamp_min(1e-6)
            away = (lifted.pose - views.pose).detach().norm(dim=-1)
            off = torch.where(views.shown == 0, away, error.detach())
            surprise = (off / scale + scale.log()) * views.sure * (lifted.spread > 0)
            loss = loss + _SPREAD_WEIGHT * surprise.sum() / known
            logged["spread"] = lifted.spread.detach().mean()
        if lifter.tilt == "predicted":
            tilt = (lifted.tilt - views.tilt).abs().mean()
            loss = loss + _TILT_WEIGHT * tilt
            logged["tilt"] = tilt.detach()
        return loss, logged

    def _batch(self) -> ShownViews:
        """Return this step's views. They are made many batches at once: one batch alone is all overhead."""
        size = self.settings.batch_size
        chunk, place = divmod(self.global_step, _BATCHES_AT_ONCE)
        if self._made is None or self._made[0] != chunk:
            # The chunk has a stream of its own, so that a resumed fit makes the same one again.
            torch.manual_seed(stream_seed(self.seed + 1, self.global_rank, chunk))
            with torch.no_grad():
                self._made = (chunk, self.maker(size * _BATCHES_AT_ONCE))
            torch.manual_seed(stream_seed(self.seed, self.global_rank, self.global_step))
        return self._made[1].part(place, size)
