"""The second stage: a fresh lifter learns from the teacher's own poses, turned everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.config import StudentSettings, ViewSettings
from uplift.data.tensors import TrainingSet
from uplift.lifter import Lifter
from uplift.normalise import renormalise
from uplift.pose import mirror
from uplift.skeleton import Skeleton
from uplift.training.base import LifterTraining
from uplift.views import level, random_rotations, turn, views_about_gravity

__all__ = ["PseudoPoses", "StudentTraining", "lift_all"]


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

    def __len__(self) -> int:
        return len(self.pose)

    def to(self, device: torch.device | str) -> PseudoPoses:
        """Return the same poses on ``device``."""
        moved = (self.pose.to(device), self.tilt.to(device), self.distance.to(device))
        return PseudoPoses(self.skeleton, *moved)


@torch.no_grad()
def lift_all(lifter: Lifter, data: TrainingSet, chunk: int = 8192) -> PseudoPoses:
    """Return every training frame lifted by ``lifter``, averaged with its mirror image."""
    device = next(lifter.parameters()).device
    poses, tilts = [], []
    for start in range(0, len(data), chunk):
        rows = slice(start, start + chunk)
        lifted = lifter.lift_both_ways(
            data.keypoints[rows].to(device), data.confidence[rows].to(device), data.distance[rows].to(device)
        )
        pose = turn(lifted.pose, level(lifted.tilt)) if data.skeleton.gravity else lifted.pose
        poses.append(pose)
        tilts.append(lifted.tilt)
    return PseudoPoses(data.skeleton, torch.cat(poses), torch.cat(tilts), data.distance.to(device))


class StudentTraining(LifterTraining):
    """Lift random turned views of the teacher's poses back to those poses.

    The teacher saw each pose from one side; the student sees it from everywhere, and generalises
    better for it. Nothing enters but what the teacher made of 2D keypoints.
    """

    data: PseudoPoses  # type: ignore[assignment]
    settings: StudentSettings

    def __init__(
        self, lifter: Lifter, data: PseudoPoses, settings: StudentSettings, views: ViewSettings, seed: int
    ):
        super().__init__(lifter, data, settings, seed)  # type: ignore[arg-type]
        self.views = views

    def objective(self, rows: Tensor) -> tuple[Tensor, dict[str, float | Tensor]]:
        """Return the mean joint distance to the turned poses, and what else the lifter can know."""
        skeleton, lifter = self.data.skeleton, self.lifter
        pose = self.data.pose[rows]
        count, device = len(rows), rows.device
        if self.settings.mirror:
            flip = torch.rand(count, 1, 1, device=device) < 0.5
            pose = torch.where(flip, mirror(pose, lifter.mirror_permutation), pose)
        if skeleton.gravity:
            azimuth = 2 * torch.pi * torch.rand(count, device=device)
            tilt = self.data.tilt[torch.randint(len(self.data), (count,), device=device)]
            pose = turn(pose, views_about_gravity(torch.zeros_like(tilt), azimuth, tilt))
        else:
            tilt = None
            pose = turn(pose, random_rotations(count, device))
        distance = self.data.distance[rows]
        projected = lifter.camera.project(pose, distance)
        confidence = projected.new_ones(projected.shape[:2])
        keypoints, radius = renormalise(
            projected, confidence, skeleton.root_index, count_root=self.views.count_root
        )
        target = pose / radius[:, None, None]
        if self.settings.hide:
            hidden = torch.rand_like(confidence) < self.settings.hide * 2 * torch.rand(count, 1, device=device)
            hidden[:, skeleton.root_index] = False
            confidence = confidence.masked_fill(hidden, 0)
        lifted = lifter(keypoints, confidence, distance / radius)
        loss = ((lifted.pose - target).square().sum(-1) + 1e-12).sqrt().mean()
        logged: dict[str, float | Tensor] = {"pose": loss.detach()}
        if tilt is not None and lifter.tilt == "predicted":
            error = (lifted.tilt - tilt).abs().mean()
            loss = loss + 0.3 * error
            logged["tilt"] = error.detach()
        return loss, logged
