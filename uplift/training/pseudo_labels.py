"""Pseudo labels: the training frames as a lifter lifts them, refined."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from uplift.config.settings import RefineSettings
from uplift.data.samples import Samples
from uplift.data.tensors import TrainingSet
from uplift.geometry.camera import Camera
from uplift.geometry.rotation import body_tilt, clip_median, gravity_of, least_rotation, real_tilt, turn
from uplift.models.lifter import Lifter
from uplift.models.predict import as_measured, clip_gravity, lift_frames, with_estimated_distance
from uplift.models.refine import has_clips, refine_clips
from uplift.models.signs import solve_signs
from uplift.skeleton import Skeleton

__all__ = ["PseudoPoses", "lift_all", "true_poses"]

_NOISY = 1e-3
"""Mean distance, in units, between keypoints and refined poses above which keypoints count as noisy."""


@dataclass(frozen=True)
class PseudoPoses(Samples):
    """Poses for a student to learn from, as a teacher lifts the training frames."""

    skeleton: Skeleton
    pose: Float[Tensor, "frames joints 3"]
    """Level frame where there is gravity, in units of the mean 2D radius."""
    gravity: Float[Tensor, "frames 3"]
    """Its direction in the frame of the camera that looks at the root; (0, 1, 0) without gravity."""
    distance: Float[Tensor, " frames"]
    """From the camera to the root, in units."""
    confidence: Float[Tensor, "frames joints"]
    """Of the data; 0 where a joint is only the teacher's guess and is not learned from."""
    noise: Float[Tensor, "frames joints 2"] | None = None
    """Keypoints minus projections of the refined poses; None where that is negligible or unknown."""
    labelled: Bool[Tensor, " frames"] | None = None
    """Which poses are ground truth; None without any."""
    guessed: Bool[Tensor, " frames"] | None = None
    """Where `distance` is no more than a guess; None: nowhere."""


@torch.no_grad()
def lift_all(lifter: Lifter, data: TrainingSet, refine: RefineSettings) -> PseudoPoses:
    """Return every training frame lifted by ``lifter``, averaged with its mirror image, refined by clip, or its label.

    Depth signs are decided along clips where the lifter predicts them.
    """
    data = data.to(next(lifter.parameters()).device)
    lifted = lift_frames(lifter, data)
    data = with_estimated_distance(data, lifted)
    pose, refined = lifted.pose, bool(refine.iterations) and has_clips(data)
    if refined:
        pose = refine_clips(data, as_measured(data, lifted.keypoints), pose[..., 2], lifter.camera, refine)
    if lifted.signs is not None and refine.iterations:
        pose = solve_signs(data, pose, lifted.signs, lifter.camera, lifter.chains, lifted.uncertainty).pose
    if data.labels is not None:
        pose = torch.where(data.labels.isfinite(), data.labels, pose)
    if lifted.gravity is not None:
        gravity = clip_gravity(lifted, data)
    elif lifter.tilt == "predicted" and has_clips(data):
        gravity = gravity_of(_body_tilts(data, pose), data.rotation)
    else:
        gravity = gravity_of(real_tilt(lifted.tilt, data.rotation), data.rotation)
    noise = _noise(data, pose, data.confidence, lifter.camera) if refined else None
    return _levelled(data, pose, data.confidence, gravity, noise)


@torch.no_grad()
def true_poses(data: TrainingSet, camera: Camera, *, tilted: bool = True) -> PseudoPoses:
    """Return the labels of ``data``, which every frame has, in the form of pseudo labels.

    The noise is how far keypoints are from the labels. The camera's tilt is estimated from the bodies where it
    is not labelled; cameras that are not ``tilted`` are level.
    """
    assert data.labels is not None
    known = data.labels.isfinite().all(-1)
    pose = data.labels.nan_to_num()
    # The position of an invisible joint is known too; a joint without a label is not learned from.
    confidence = torch.where(data.confidence > 0, data.confidence, torch.ones_like(data.confidence)) * known
    tilt = _body_tilts(data, pose) if tilted else torch.zeros_like(data.distance)
    gravity = gravity_of(tilt, data.rotation)
    return _levelled(data, pose, confidence, gravity, _noise(data, pose, data.confidence * known, camera))


def _levelled(
    data: TrainingSet, pose: Tensor, confidence: Tensor, gravity: Tensor, noise: Tensor | None
) -> PseudoPoses:
    """Return poses in the level frame; ``gravity`` is as the cameras see it that look at the root, unless labelled."""
    labelled = None if data.labels is None else data.labelled
    if data.label_tilt is not None and data.skeleton.gravity:
        known = gravity_of(real_tilt(data.label_tilt, data.rotation), data.rotation)
        gravity = torch.where(known.isfinite(), known, gravity)
    if data.skeleton.gravity:
        pose = turn(pose, least_rotation(gravity, gravity.new_tensor([0.0, 1.0, 0.0])))
    guessed = data.guessed
    if guessed is None and data.rotation is None:
        guessed = torch.ones_like(data.follows)
    return PseudoPoses(data.skeleton, pose, gravity, data.distance, confidence, noise, labelled, guessed)


def _body_tilts(data: TrainingSet, pose: Tensor) -> Tensor:
    """Return the tilt of each frame's real camera as estimated from the bodies, one for each clip."""
    tilt, weight = body_tilt(pose if data.rotation is None else turn(pose, data.rotation.mT))
    return clip_median(tilt, weight, data.clip)


def _noise(data: TrainingSet, pose: Tensor, confidence: Tensor, camera: Camera) -> Tensor | None:
    """Return how far visible keypoints are from projections of the poses; None if that is negligible."""
    noise = (data.keypoints - as_measured(data, camera.project(pose, data.distance))) * (confidence > 0).unsqueeze(-1)
    return noise if noise.norm(dim=-1).mean() > _NOISY else None
