"""Inference in steps: lift in chunks, refine clips, interpolate short gaps, keep bones constant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from uplift.config.settings import RefineSettings
from uplift.data.poses import PoseData
from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.geometry.camera import Camera
from uplift.geometry.normalise import Intrinsics
from uplift.geometry.rotation import clip_median, gravity_of, real_tilt
from uplift.models.lifter import Lifted, Lifter
from uplift.models.refine import refine_clips
from uplift.skeleton import Skeleton

__all__ = ["as_measured", "bridge_gaps", "bridged_joints", "lift_frames", "refine_lifted", "with_constant_bones"]

# Lift many frames: in chunks that fit the cache, then each clip as a whole.

_CHUNK = 8192


@torch.no_grad()
def lift_frames(lifter: Lifter, frames: TrainingSet, *, both_ways: bool = True) -> Lifted:
    """Return every frame lifted, averaged with its mirror image where ``both_ways``."""
    lift = lifter.lift_both_ways if both_ways else lifter
    parts: list[Lifted] = []
    for start in range(0, len(frames), _CHUNK):
        rows = slice(start, start + _CHUNK)
        parts.append(lift(frames.keypoints[rows], frames.confidence[rows], frames.distance[rows]))
    return Lifted.concat(parts)


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


# Bridge short gaps: a joint that the frames around show is put where the mended pose has it, and seen from then on.


def bridged_joints(data: PoseData) -> Bool[np.ndarray, "frames joints"]:
    """Return the missing joints that the frame before or after shows, in frames that show something."""
    seen = data.confidence > 0
    follows = data.follows()[:, None]
    near = np.zeros_like(seen)
    near[1:] |= seen[:-1] & follows[1:]
    near[:-1] |= seen[1:] & follows[1:]
    return near & ~seen & seen.any(1, keepdims=True)


def bridge_gaps(data: PoseData, frames: TrainingSet, lifted: Lifted, intrinsics: Intrinsics | None) -> PoseData | None:
    """Return ``data`` with bridged joints at the keypoints of ``lifted``; None where there are none.

    ``frames`` is the normalised ``data`` and ``lifted`` its poses, mended by clip. Their confidence is
    the median of what is seen.
    """
    gap = bridged_joints(data)
    if not gap.any():
        return None
    pixels = _pixels(data, frames, lifted, intrinsics).cpu().numpy()
    usual = np.median(data.confidence[data.confidence > 0])
    return replace(
        data,
        keypoints=np.where(gap[..., None], pixels, data.keypoints).astype(np.float32),
        confidence=np.where(gap, usual, data.confidence).astype(np.float32),
    )


def _pixels(
    data: PoseData, frames: TrainingSet, lifted: Lifted, intrinsics: Intrinsics | None
) -> Float[Tensor, "frames joints 2"]:
    """Return where the lifted joints are in the image."""
    keypoints = as_measured(frames, lifted.keypoints)
    if intrinsics is None or frames.rotation is None:
        origin = torch.from_numpy(data.keypoints[:, [frames.skeleton.root_index]]).to(keypoints)
        return origin + keypoints * frames.scale[:, None, None]
    rays = torch.cat([keypoints / frames.distance[:, None, None], torch.ones_like(keypoints[..., :1])], -1)
    rays = rays @ frames.rotation  # rows times R: back to the real camera
    return rays[..., :2] / rays[..., 2:].clamp_min(0.05) * intrinsics.focal_px + keypoints.new_tensor(
        intrinsics.centre_px
    )


# Give the poses of one body the same bones: joints move as little as it takes.

_ROUNDS = 30


def with_constant_bones(
    pose: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton, body: Int[np.ndarray, " frames"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Return the poses with, for each ``body``, one length of every bone, up to a size for each frame.

    The length is the median over the body's frames of the bone as a share of all its bones; the sum of
    all bones of a frame stays. Bone after bone, both ends are moved by half of what it is too long or too
    short, again and again (as SHAKE does: Ryckaert, Ciccotti and Berendsen 1977), and what is left of it
    is set exactly from the root outwards. Joints leave the lines of sight they were seen on by as much
    as bones were wrong.

    Raises:
        UserError: bones that close loops, which no such walk along them can keep.
    """
    if len(skeleton.bones) >= len(skeleton.joints):
        raise UserError(f"bones=constant: the bones of '{skeleton.name}' close loops and cannot be set one by one.")
    pairs = skeleton.bone_indices
    length = np.linalg.norm(pose[:, pairs[:, 1]] - pose[:, pairs[:, 0]], axis=-1)
    total = length.sum(1, keepdims=True)
    share = length / np.maximum(total, 1e-9)
    usual = share.copy()
    for one in np.unique(body):
        rows = body == one
        if np.isfinite(share[rows]).any():
            median = np.nanmedian(share[rows], axis=0)
            usual[rows] = median / median.sum()
    wanted = usual * total
    moved = pose.astype(np.float64)
    for _ in range(_ROUNDS):
        for bone, (one, other) in enumerate(pairs):
            way = moved[:, other] - moved[:, one]
            now = np.linalg.norm(way, axis=-1)
            step = way * ((now - wanted[:, bone]) / np.maximum(2 * now, 1e-9))[:, None]
            moved[:, one] += step
            moved[:, other] -= step
    return _exact(moved, skeleton, wanted).astype(pose.dtype)


def _exact(pose: np.ndarray, skeleton: Skeleton, lengths: np.ndarray) -> np.ndarray:
    """Return poses about the root whose bones have the directions of ``pose`` and these lengths."""
    place = {child: at for at, (_, child) in enumerate(skeleton.bones)}
    result = np.zeros_like(pose)
    for joint, parent in skeleton.parents.items():  # breadth first: a parent is set before its children
        if parent is not None:
            child, before = skeleton.index(joint), skeleton.index(parent)
            way = pose[:, child] - pose[:, before]
            way = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)
            result[:, child] = result[:, before] + way * lengths[:, place[joint], None]
    return result
