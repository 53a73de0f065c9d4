"""Lift many frames: in chunks that fit the cache, then each clip as a whole."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.camera import Camera
from uplift.config import RefineSettings
from uplift.data.tensors import TrainingSet
from uplift.gravity import clip_median, gravity_of, real_tilt
from uplift.lifter import Lifted, Lifter
from uplift.refine import refine_clips

__all__ = ["as_measured", "lift_frames", "refine_lifted"]

_CHUNK = 8192


@torch.no_grad()
def lift_frames(lifter: Lifter, frames: TrainingSet, *, both_ways: bool = True) -> Lifted:
    """Return every frame lifted, averaged with its mirror image where ``both_ways``."""
    lift = lifter.lift_both_ways if both_ways else lifter
    parts: list[Lifted] = []
    for start in range(0, len(frames), _CHUNK):
        rows = slice(start, start + _CHUNK)
        parts.append(lift(frames.keypoints[rows], frames.confidence[rows], frames.distance[rows]))
    spreads = [part.spread for part in parts if part.spread is not None]
    return Lifted(
        torch.cat([part.pose for part in parts]),
        torch.cat([part.tilt for part in parts]),
        torch.cat([part.keypoints for part in parts]),
        torch.cat(spreads) if spreads else None,
    )


def as_measured(frames: TrainingSet, keypoints: Float[Tensor, "frames joints 2"]) -> Float[Tensor, "frames joints 2"]:
    """Return root-relative ``keypoints`` from where those of ``frames`` are measured: the stand-in of a missing root.

    The joints that are seen tell how far the two are apart: not at all where the root is seen.
    """
    seen = (frames.confidence > 0).unsqueeze(-1)
    apart = ((frames.keypoints - keypoints) * seen).sum(1, keepdim=True) / seen.sum(1, keepdim=True).clamp_min(1)
    gone = frames.confidence[:, frames.skeleton.root_index] == 0
    return keypoints + apart * gone[:, None, None]


@torch.no_grad()
def refine_lifted(lifted: Lifted, frames: TrainingSet, camera: Camera, settings: RefineSettings) -> Lifted:
    """Return the frames of each clip with one body, a smooth motion and one tilt of the real camera."""
    pose = refine_clips(frames, as_measured(frames, lifted.keypoints), lifted.pose[..., 2], camera, settings)
    tilt = clip_median(real_tilt(lifted.tilt, frames.rotation), torch.ones_like(lifted.tilt), frames.clip)
    seen = gravity_of(tilt, frames.rotation)[:, 2].clamp(-1, 1).asin()
    return Lifted(pose, seen, camera.project(pose, frames.distance), lifted.spread)
