"""Poses to learn from that nobody labelled: the training frames as a lifter lifts them, mended."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.config import RefineSettings
from uplift.data.tensors import TrainingSet
from uplift.gravity import body_tilt, clip_median, gravity_of, real_tilt
from uplift.lifter import Lifter
from uplift.lifting import as_measured, lift_frames
from uplift.refine import has_clips, refine_clips
from uplift.skeleton import Skeleton
from uplift.views import least_rotation, turn

__all__ = ["PseudoPoses", "lift_all"]

_NOISY = 1e-3
"""Mean distance, in units, between keypoints and refined poses from which keypoints count as noisy."""


@dataclass(frozen=True)
class PseudoPoses:
    """The training frames as the teacher lifts them: poses without any label."""

    skeleton: Skeleton
    pose: Float[Tensor, "frames joints 3"]
    """Level frame where there is gravity, in units of the mean 2D radius."""
    gravity: Float[Tensor, "frames 3"]
    """Its direction as the camera that looks at the root sees it; (0, 1, 0) without gravity."""
    distance: Float[Tensor, " frames"]
    """Of the camera to the root, in units."""
    confidence: Float[Tensor, "frames joints"]
    """Of the data; where it is 0 the joint is the teacher's guess and teaches nothing."""
    noise: Float[Tensor, "frames joints 2"] | None = None
    """What the keypoints were off from the refined poses; None where they are exact or nothing tells."""

    def __len__(self) -> int:
        return len(self.pose)

    def to(self, device: torch.device | str) -> PseudoPoses:
        """Return the same poses on ``device``."""
        moved = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "skeleton"}
        return replace(self, **{k: None if v is None else v.to(device) for k, v in moved.items()})


@torch.no_grad()
def lift_all(lifter: Lifter, data: TrainingSet, refine: RefineSettings) -> PseudoPoses:
    """Return every training frame lifted by ``lifter``, averaged with its mirror image and refined by clip."""
    data = data.to(next(lifter.parameters()).device)
    lifted = lift_frames(lifter, data)
    pose, noise = lifted.pose, None
    if refine.iterations and has_clips(data):
        pose = refine_clips(data, as_measured(data, lifted.keypoints), pose[..., 2], lifter.camera, refine)
        noise = data.keypoints - as_measured(data, lifter.camera.project(pose, data.distance))
        noise = noise * (data.confidence > 0).unsqueeze(-1)
        noise = noise if noise.norm(dim=-1).mean() > _NOISY else None
    gravity = gravity_of(_tilts(lifter, data, pose, lifted.tilt), data.rotation)
    if data.skeleton.gravity:
        pose = turn(pose, least_rotation(gravity, gravity.new_tensor([0.0, 1.0, 0.0])))
    return PseudoPoses(data.skeleton, pose, gravity, data.distance, data.confidence, noise)


def _tilts(lifter: Lifter, data: TrainingSet, pose: Tensor, tilt: Tensor) -> Tensor:
    """Return the tilt of each frame's real camera: one for a clip, as the bodies in it tell, else the lifter's."""
    tilt = real_tilt(tilt, data.rotation)
    if lifter.tilt == "level" or not has_clips(data):
        return tilt
    if lifter.tilt == "predicted":
        tilt, trust = body_tilt(pose if data.rotation is None else turn(pose, data.rotation.mT))
        return clip_median(tilt, trust, data.clip)
    return tilt
