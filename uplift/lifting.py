"""Lift many frames: in chunks that fit the cache, then each clip as a whole."""

from __future__ import annotations

import torch

from uplift.camera import Camera
from uplift.config import RefineSettings
from uplift.data.tensors import TrainingSet
from uplift.gravity import clip_median, gravity_of, real_tilt
from uplift.lifter import Lifted, Lifter
from uplift.refine import refine_clips

__all__ = ["lift_frames", "refine_lifted"]

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


@torch.no_grad()
def refine_lifted(lifted: Lifted, frames: TrainingSet, camera: Camera, settings: RefineSettings) -> Lifted:
    """Return the frames of each clip with one body, a smooth motion and one tilt of the real camera."""
    pose = refine_clips(frames, lifted.keypoints, lifted.pose[..., 2], camera, settings)
    tilt = clip_median(real_tilt(lifted.tilt, frames.rotation), torch.ones_like(lifted.tilt), frames.clip)
    seen = gravity_of(tilt, frames.rotation)[:, 2].clamp(-1, 1).asin()
    return Lifted(pose, seen, camera.project(pose, frames.distance), lifted.spread)
