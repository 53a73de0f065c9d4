"""True poses that training may learn from, brought into the model's units and camera."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from uplift.data.container import PoseData
from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.gravity import gravity_of
from uplift.pose import bone_lengths
from uplift.views import turn

__all__ = ["joined", "mean_bones", "with_labels"]


def with_labels(frames: TrainingSet, data: PoseData) -> TrainingSet:
    """Return ``frames``, which were made of ``data``, with the poses of its `labelled` frames; unchanged without any.

    A label and its keypoints agree: with a known camera and root by the true distance, else by the
    scale that fits the label to its 2D best.
    """
    if data.labelled is None or data.pose is None or not data.labelled.any():
        return frames
    labelled = torch.from_numpy(data.labelled)
    pose = torch.from_numpy(data.pose)
    if frames.rotation is not None:
        pose = turn(pose, frames.rotation)
    known = pose.isfinite().all(-1)
    unit = _own_unit(frames, pose.nan_to_num(), known, data.root)
    tilt = torch.full_like(unit, torch.nan)
    if data.tilt_deg is not None and frames.skeleton.gravity:
        real = torch.from_numpy(np.radians(data.tilt_deg).astype(np.float32))
        tilt = gravity_of(real, frames.rotation)[:, 2].clamp(-1, 1).asin()
    labels = (pose / unit[:, None, None]).where((labelled[:, None] & known)[..., None], torch.nan)
    return replace(
        frames,
        labels=labels,
        label_unit=unit.where(labelled, torch.nan),
        label_tilt=tilt.where(labelled, torch.nan),
    )


def _own_unit(
    frames: TrainingSet, pose: Tensor, known: Bool[Tensor, "frames joints"], root: np.ndarray | None
) -> Tensor:
    """Return how much of the pose's own unit one unit of the model is."""
    both = ((frames.confidence > 0) & known).unsqueeze(-1)
    flat = pose[..., :2] * both
    by_keypoints = flat.square().sum((1, 2)) / (flat * frames.keypoints).sum((1, 2)).clamp_min(1e-9)
    if frames.rotation is None or root is None:
        return by_keypoints
    by_distance = torch.from_numpy(root).norm(dim=-1) / frames.distance
    return torch.where(by_distance.isfinite() & (by_distance > 0), by_distance, by_keypoints)


def mean_bones(frames: TrainingSet) -> Float[Tensor, " bones"] | None:
    """Return the mean length of each bone over the labelled frames, in the labels' own unit; NaN where none shows it."""
    if frames.labels is None or frames.label_unit is None:
        return None
    bones = torch.as_tensor(frames.skeleton.bone_indices.copy())
    lengths = bone_lengths(frames.labels[frames.labelled], bones) * frames.label_unit[frames.labelled, None]
    return lengths.nanmean(0)


def joined(one: TrainingSet, other: TrainingSet) -> TrainingSet:
    """Return the frames of both; what only one knows is unknown for the other's."""
    sides = [frames.masks.shape[1] for frames in (one, other) if frames.masks is not None]
    if len(set(sides)) > 1:
        raise UserError(
            f"Labelled frames have masks of {sides[1]} px a side, the others of {sides[0]}: expected the same."
        )
    both = {}
    for field in fields(TrainingSet):
        if field.name == "skeleton":
            continue
        first, second = getattr(one, field.name), getattr(other, field.name)
        if field.name == "clip":
            second = second + (int(first.max()) + 1 if len(first) else 0)
        if first is None and second is None:
            both[field.name] = None
            continue
        first = _blank(field.name, second, len(one)) if first is None else first
        second = _blank(field.name, first, len(other)) if second is None else second
        both[field.name] = torch.cat([first, second])
    return replace(one, **both)


def _blank(name: str, like: Tensor, count: int) -> Tensor:
    """Return what stands for nothing known: no turn of the camera, no label."""
    if name == "rotation":
        return torch.eye(3).expand(count, 3, 3)
    if not like.is_floating_point():  # masks
        return like.new_zeros((count, *like.shape[1:]))
    return torch.full((count, *like.shape[1:]), torch.nan)
