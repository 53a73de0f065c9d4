"""The second stage: a fresh lifter learns from the teacher's own poses, mixed and turned everywhere."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.config import RefineSettings, StudentSettings, ViewSettings
from uplift.data.clean import MIN_VISIBLE
from uplift.data.tensors import TrainingSet
from uplift.lifter import Lifter
from uplift.normalise import renormalise
from uplift.pose import mirror
from uplift.skeleton import Skeleton
from uplift.training.base import LifterTraining, stream_seed
from uplift.training.mixing import LimbMixer
from uplift.training.refine import refine_depth, steady_tilt
from uplift.views import level, random_rotations, turn, views_about_gravity

__all__ = ["PseudoPoses", "StudentTraining", "lift_all"]

_BATCHES_AT_ONCE = 16


@dataclass(frozen=True)
class PseudoPoses:
    """The training frames as the teacher lifts them: poses without any label."""

    skeleton: Skeleton
    pose: Float[Tensor, "frames joints 3"]
    """Level frame where there is gravity, in units of the mean 2D radius."""
    tilt: Float[Tensor, " frames"]
    """The camera tilt the teacher found, radians."""
    distance: Float[Tensor, " frames"]
    """Of the camera to the root, in units."""
    confidence: Float[Tensor, "frames joints"]
    """Of the data; where it is 0 the joint is the teacher's guess and teaches nothing."""

    def __len__(self) -> int:
        return len(self.pose)

    def to(self, device: torch.device | str) -> PseudoPoses:
        """Return the same poses on ``device``."""
        return PseudoPoses(
            self.skeleton, *(getattr(self, f.name).to(device) for f in fields(self) if f.name != "skeleton")
        )


@torch.no_grad()
def lift_all(lifter: Lifter, data: TrainingSet, refine: RefineSettings, chunk: int = 8192) -> PseudoPoses:
    """Return every training frame lifted by ``lifter``, averaged with its mirror image and refined by clip."""
    device = next(lifter.parameters()).device
    data = data.to(device)
    parts = []
    for start in range(0, len(data), chunk):
        rows = slice(start, start + chunk)
        parts.append(lifter.lift_both_ways(data.keypoints[rows], data.confidence[rows], data.distance[rows]))
    pose, tilt, keypoints = (torch.cat(values) for values in zip(*parts, strict=True))
    if refine.iterations:
        depth = refine_depth(data, keypoints, pose[..., 2], lifter.camera, refine)
        pose = lifter.camera.unproject(keypoints, depth, data.distance)
        tilt = steady_tilt(data, tilt)
    if data.skeleton.gravity:
        pose = turn(pose, level(tilt))
    return PseudoPoses(data.skeleton, pose, tilt, data.distance, data.confidence)


@dataclass(frozen=True)
class _Views:
    """Turned views to learn from: what the network sees, and what it should say."""

    keypoints: Tensor
    confidence: Tensor
    """Of the poses they came from; 0 where there is nothing to learn."""
    shown: Tensor
    """The same with hidden joints at 0: what the network sees."""
    pose: Tensor
    tilt: Tensor
    distance: Tensor

    def part(self, place: int, size: int) -> _Views:
        rows = slice(place * size, (place + 1) * size)
        return _Views(*(getattr(self, f.name)[rows] for f in fields(self)))


class StudentTraining(LifterTraining):
    """Lift random turned views of the teacher's poses back to those poses.

    The teacher saw each pose from one side, with the limbs it came with; the student sees it from
    everywhere, with the limbs of others, and generalises better for it. Nothing enters but what the
    teacher made of 2D keypoints.
    """

    data: PseudoPoses  # type: ignore[assignment]
    settings: StudentSettings

    def __init__(self, lifter: Lifter, data: PseudoPoses, settings: StudentSettings, views: ViewSettings, seed: int):
        super().__init__(lifter, data, settings, seed)  # type: ignore[arg-type]
        self.views = views
        self._made: tuple[int, _Views] | None = None

    def on_fit_start(self) -> None:
        """Put the poses where the model is and take them apart into limbs."""
        super().on_fit_start()
        mixes = self.settings.mix > 0 and not self.data.skeleton.rigid
        self.mixer = LimbMixer(self.data.pose, self.data.skeleton) if mixes else None

    def objective(self) -> tuple[Tensor, dict[str, float | Tensor]]:
        """Return the mean depth error over the known joints, and what else the lifter can know."""
        views, lifter = self._batch(), self.lifter
        lifted = lifter(views.keypoints, views.shown, views.distance)
        error = (lifted.pose[..., 2] - views.pose[..., 2]).abs()
        loss = (error * views.confidence).sum() / views.confidence.sum().clamp_min(1)
        logged: dict[str, float | Tensor] = {"depth": loss.detach()}
        if lifter.fill and self.settings.hide:
            hidden = views.confidence * (views.shown == 0)
            filled = (lifted.keypoints - views.keypoints).abs().sum(-1) * hidden
            filled = filled.sum() / hidden.sum().clamp_min(1)
            loss = loss + self.settings.hide * filled
            logged["fill"] = filled.detach()
        if lifter.tilt == "predicted":
            tilt = (lifted.tilt - views.tilt).abs().mean()
            loss = loss + 0.1 * tilt
            logged["tilt"] = tilt.detach()
        return loss, logged

    def _batch(self) -> _Views:
        """Return this step's views. They are made many batches at once: one batch alone is all overhead."""
        size = self.settings.batch_size
        chunk, place = divmod(self.global_step, _BATCHES_AT_ONCE)
        if self._made is None or self._made[0] != chunk:
            # The chunk has a stream of its own, so that a resumed fit makes the same one again.
            torch.manual_seed(stream_seed(self.seed + 1, self.global_rank, chunk))
            with torch.no_grad():
                self._made = (chunk, self._make(size * _BATCHES_AT_ONCE))
            torch.manual_seed(stream_seed(self.seed, self.global_rank, self.global_step))
        return self._made[1].part(place, size)

    def _make(self, count: int) -> _Views:
        """Mix, mirror and turn ``count`` poses, and project them."""
        data, skeleton = self.data, self.data.skeleton
        rows = self.draw(count)
        if self.mixer is None:
            pose, sure = data.pose[rows], data.confidence[rows]
        else:
            pose, sure = self.mixer(rows, data.confidence, share=self.settings.mix, limb=self.settings.mix_limb)
        if self.mirrors:
            swap = self.lifter.mirror_permutation
            flip = torch.rand(count, device=rows.device) < 0.5
            pose = torch.where(flip[:, None, None], mirror(pose, swap), pose)
            sure = torch.where(flip[:, None], sure[:, swap], sure)
        tilt = data.tilt[self.draw(count)]
        if skeleton.gravity:
            azimuth = 2 * torch.pi * torch.rand(count, device=rows.device)
            pose = turn(pose, views_about_gravity(torch.zeros_like(tilt), azimuth, tilt))
        else:
            pose = turn(pose, random_rotations(count, rows.device))
        distance = data.distance[rows]
        projected = self.lifter.camera.project(pose, distance)
        shown = self._hide(sure)
        few = ((shown > 0).sum(1, keepdim=True)) < MIN_VISIBLE
        # The radius is that of the joints that are shown, as it will be of those that are seen. Where too few
        # are left to tell a size, the view teaches nothing.
        scaled_by = torch.where(few, torch.ones_like(shown), shown)
        sure = sure.masked_fill(few, 0)
        keypoints, radius = renormalise(projected, scaled_by, skeleton.root_index, count_root=self.views.count_root)
        return _Views(keypoints, sure, shown, pose / radius[:, None, None], tilt, distance / radius)

    def _hide(self, confidence: Tensor) -> Tensor:
        """Return the confidence with a random share of each pose's joints at 0, the root never."""
        if not self.settings.hide:
            return confidence
        share = self.settings.hide * 2 * torch.rand(len(confidence), 1, device=confidence.device)
        hidden = torch.rand(confidence.shape, device=confidence.device) < share
        hidden[:, self.data.skeleton.root_index] = False
        return confidence.masked_fill(hidden, 0)
