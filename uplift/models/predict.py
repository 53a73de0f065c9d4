"""The steps of inference: lift, refine by clip, interpolate gaps, depth signs, constant bones, metric scale, level frame, windows of live use."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from uplift.config.settings import LifterSettings, RefineSettings
from uplift.config.threads import in_threads
from uplift.data.confidence import calibrated
from uplift.data.poses import USUAL_FPS, PoseData, previous_frames
from uplift.data.tensors import TrainingSet, intrinsics_of, to_training_set, undistorted
from uplift.errors import UserError
from uplift.geometry.camera import Camera
from uplift.geometry.lens import place_roots
from uplift.geometry.normalise import Intrinsics, normalise
from uplift.geometry.rotation import clip_direction, clip_median, gravity_of, least_rotation, real_tilt, turn
from uplift.models.lifter import Lifted, Lifter, mixed_networks
from uplift.models.metric_scale import (
    CameraHeight,
    Size,
    median_by_body,
    mm_by_camera_height,
    mm_per_unit,
    segment_lengths,
    size_of_skeleton,
)
from uplift.models.refine import refine_clips
from uplift.models.signs import Hypotheses, Solution, solve_signs, spread_hypotheses
from uplift.skeleton import Skeleton

__all__ = [
    "LAG_SECONDS",
    "InferredPoses",
    "as_measured",
    "causal_windows",
    "clip_gravity",
    "gap_joints",
    "infer",
    "interpolate_gaps",
    "lift_frames",
    "mm_per_pixel",
    "refine_lifted",
    "sign_logits",
    "to_level",
    "with_constant_bones",
    "with_estimated_distance",
]


@dataclass(frozen=True)
class InferredPoses:
    """Poses in pixels at the depth of the root, in the frame of the real camera."""

    pose: Float[Tensor, "frames joints 3"]
    gravity: Float[Tensor, "frames 3"]
    """Unit vectors."""
    gravity_by_frame: Float[Tensor, "frames 3"]
    """The same as each frame alone has it, where ``gravity`` is one for a clip."""
    uncertainty: Float[Tensor, "frames joints"] | None
    """The expected error of each depth, pixels."""
    mm_per_px: Float[Tensor, " frames"] | None
    """For bodies as large as the labelled ones; None without labels."""
    hypotheses: Hypotheses | None = None
    """Whole poses that are likely; None where they were not asked for."""
    focal_px: Float[Tensor, " frames"] | None = None
    """As estimated; None where it is given, or the lifter does not estimate it."""


def infer(
    lifter: Lifter,
    data: PoseData,
    settings: LifterSettings,
    *,
    refine: bool,
    hypotheses: int = 0,
    half: bool = False,
) -> InferredPoses:
    """Return the poses of cleaned ``data``, computed on the device of ``lifter``.

    Args:
        lifter, settings: what lifts.
        data: keypoints, cleaned.
        refine: whether clips are refined, short gaps interpolated, and depth signs decided by a lifter that predicts them.
        hypotheses: how many poses to return for each frame, beside the answer, by such a lifter.
        half: whether networks multiply in bfloat16; poses differ by 0.03 % of the body then.
    """
    seen = calibrated(undistorted(data, settings), lifter.skeleton, settings)
    frames = to_training_set(seen, lifter.skeleton, settings).to(next(lifter.parameters()).device)
    lift = partial(lift_frames, lifter, both_ways=settings.both_ways, half=half, with_signs=False)
    alone = lifted = lift(frames)
    if refine:
        frames, alone = _without_gaps(seen, frames, alone, lift, lifter.camera, settings)
        lifted = refine_lifted(alone, frames, lifter.camera, settings.refine)
    several = None
    if lifter.knows_signs and (refine or hypotheses):
        placed = frames if lifted.distance is None else replace(frames, distance=lifted.distance)
        signs = sign_logits(lifter, frames, both_ways=settings.both_ways, half=half)
        solution = solve_signs(placed, lifted.pose, signs, lifter.camera, lifter.chains, lifted.uncertainty)
        lifted = _solved(lifted, solution)
        several = _in_pixels(spread_hypotheses(solution, hypotheses), frames) if hypotheses else None
    pose = _to_real(lifted.pose * frames.scale[:, None, None], frames)
    gravity, by_frame = (_real_gravity(one, frames) for one in (lifted, alone))
    uncertainty = None if lifted.uncertainty is None else lifted.uncertainty * frames.scale[:, None]
    unit_mm = lifter.unit_mm(lifted.pose)
    mm_per_px = None if unit_mm is None else unit_mm / frames.scale
    focal_px = _focal_px(alone, frames, seen, settings)
    return InferredPoses(pose, gravity, by_frame, uncertainty, mm_per_px, several, focal_px)


_CLIP_UNCERTAINTY = 0.8
"""Of a pose with bones of its body and signs of its clip, beside that of a frame alone."""


def _solved(lifted: Lifted, solution: Solution) -> Lifted:
    """Return the poses with their depth signs decided, and the uncertainty that comes with those."""
    uncertainty = lifted.uncertainty
    if uncertainty is not None:
        uncertainty = _CLIP_UNCERTAINTY * (uncertainty.square() + solution.deviation.square()).sqrt()
    return replace(lifted, pose=solution.pose, uncertainty=uncertainty)


def _to_real(pose: Float[Tensor, "frames *any 3"], frames: TrainingSet) -> Float[Tensor, "frames *any 3"]:
    """Return poses or directions in the frame of the real camera."""
    return pose if frames.rotation is None else torch.einsum("f...x,fxy->f...y", pose, frames.rotation)


def _in_pixels(several: Hypotheses, frames: TrainingSet) -> Hypotheses:
    return replace(several, pose=_to_real(several.pose * frames.scale[:, None, None, None], frames))


def _focal_px(
    alone: Lifted, frames: TrainingSet, data: PoseData, settings: LifterSettings
) -> Float[Tensor, " frames"] | None:
    """Return each clip's focal length as the lifter estimates it; None where it is given, or the lifter does not."""
    guess = intrinsics_of(data, settings)
    if guess is None or alone.distance is None or frames.guessed is None or not frames.guessed.any():
        return None
    ratio = alone.distance / frames.distance  # at one size in the image, distance and focal length grow together
    return guess.focal_px * clip_median(ratio, torch.ones_like(ratio), frames.clip)


# Lift many frames, and refine those of each clip together.

_CHUNK, _CHUNK_ELSEWHERE = 512, 131_072
"""Frames lifted at a time: on the processor those that stay in its cache, on other devices enough to keep them busy."""


def lift_frames(
    lifter: Lifter, frames: TrainingSet, *, both_ways: bool = True, half: bool = False, with_signs: bool = True
) -> Lifted:
    """Return every frame lifted, averaged with its mirror image if ``both_ways``.

    The networks multiply in bfloat16 with ``half``. Depth signs are left out without ``with_signs``; of those that a
    lifter does not know there are none.
    """
    one_way = lifter.lift_both_ways if both_ways else lifter
    lift = partial(one_way, with_signs=with_signs and lifter.knows_signs)
    return Lifted.concat(_by_chunks(lift, frames, half, "lifting frames"))


def sign_logits(
    lifter: Lifter, frames: TrainingSet, *, both_ways: bool = True, half: bool = False
) -> Float[Tensor, "frames states"]:
    """Return what `Lifted.signs` are of every frame, by a lifter that knows depth signs."""
    say = lifter.signs_both_ways if both_ways else lifter.sign_logits
    return torch.cat(_by_chunks(say, frames, half, "reading depth signs"))


def _by_chunks(function: Callable[..., Any], frames: TrainingSet, half: bool, what: str) -> list[Any]:
    """Return what ``function`` of a lifter says of keypoints, chunk by chunk."""
    given = [frames.keypoints, frames.confidence, frames.distance]
    given += [] if frames.guessed is None else [frames.guessed]
    device = frames.keypoints.device
    size = _CHUNK if device.type == "cpu" else _CHUNK_ELSEWHERE
    chunks = list(zip(*(part.split(size) for part in given), strict=True))
    with mixed_networks(torch.bfloat16) if half else nullcontext():
        return in_threads(lambda chunk: function(*chunk), chunks, device, what)


def as_measured(frames: TrainingSet, keypoints: Float[Tensor, "frames joints 2"]) -> Float[Tensor, "frames joints 2"]:
    """Return root-relative ``keypoints`` relative to the origin of ``frames``, a stand-in where the root is missing.

    The offset is the mean over the visible joints; it is 0 where the root is visible.
    """
    seen = (frames.confidence > 0).unsqueeze(-1)
    offset = ((frames.keypoints - keypoints) * seen).sum(1, keepdim=True) / seen.sum(1, keepdim=True).clamp_min(1)
    root_missing = frames.confidence[:, frames.skeleton.root_index] == 0
    return keypoints + offset * root_missing[:, None, None]


@torch.no_grad()
def refine_lifted(lifted: Lifted, frames: TrainingSet, camera: Camera, settings: RefineSettings) -> Lifted:
    """Return poses of which each clip has one body, a smooth motion, and one gravity and focal length of its camera."""
    frames = with_estimated_distance(frames, lifted)
    pose = refine_clips(frames, as_measured(frames, lifted.keypoints), lifted.pose[..., 2], camera, settings)
    gravity = clip_gravity(lifted, frames)
    seen = gravity[:, 2].clamp(-1, 1).asin()
    return replace(
        lifted,
        pose=pose,
        tilt=seen,
        keypoints=camera.project(pose, frames.distance),
        gravity=None if lifted.gravity is None else gravity,
        distance=None if lifted.distance is None else frames.distance,
    )


def clip_gravity(lifted: Lifted, frames: TrainingSet) -> Float[Tensor, "frames 3"]:
    """Return gravity in the frames of the cameras that look at the root; a clip's real camera has one."""
    if lifted.gravity is None:
        tilt = clip_median(real_tilt(lifted.tilt, frames.rotation), torch.ones_like(lifted.tilt), frames.clip)
        return gravity_of(tilt, frames.rotation)
    gravity = clip_direction(_to_real(lifted.gravity, frames), frames.clip)
    return gravity if frames.rotation is None else turn(gravity[:, None], frames.rotation)[:, 0]


def with_estimated_distance(frames: TrainingSet, lifted: Lifted) -> TrainingSet:
    """Return ``frames`` at the distances that the lifter estimates: each clip's camera has one focal length."""
    if lifted.distance is None or frames.guessed is None:
        return frames
    ratio = lifted.distance / frames.distance
    pooled = clip_median(ratio, torch.ones_like(ratio), frames.clip)
    return replace(frames, distance=torch.where(frames.guessed, frames.distance * pooled, frames.distance))


def _real_gravity(lifted: Lifted, frames: TrainingSet) -> Tensor:
    """Return gravity in the frame of the real camera, unit vectors."""
    if lifted.gravity is None:
        return gravity_of(real_tilt(lifted.tilt, frames.rotation), None)
    return torch.nn.functional.normalize(_to_real(lifted.gravity, frames), dim=-1)


# Gap interpolation: a joint that a neighbouring frame shows is put where the refined pose has it.


def gap_joints(frames: TrainingSet) -> Bool[Tensor, "frames joints"]:
    """Return the missing joints that are visible in the frame before or after; none in frames without any joint."""
    seen, follows = frames.confidence > 0, frames.follows[:, None]
    near = torch.zeros_like(seen)
    near[1:] |= seen[:-1] & follows[1:]
    near[:-1] |= seen[1:] & follows[1:]
    return near & ~seen & seen.any(1, keepdim=True)


def _without_gaps(
    data: PoseData,
    frames: TrainingSet,
    alone: Lifted,
    lift: Callable[[TrainingSet], Lifted],
    camera: Camera,
    settings: LifterSettings,
) -> tuple[TrainingSet, Lifted]:
    """Return ``frames``, made of ``data``, with gaps where the refined poses have them, and lifted again where they had some."""
    gap = gap_joints(frames)
    rows = gap.any(1).nonzero()[:, 0]
    if not len(rows):
        return frames, alone
    placed = with_estimated_distance(frames, alone)
    clips = torch.zeros_like(frames.follows)  # there are as many as frames at most
    clips[frames.clip[rows]] = True
    measured, depth = as_measured(placed, alone.keypoints), alone.pose[..., 2]
    pose = refine_clips(placed, measured, depth, camera, settings.refine, clips[frames.clip])
    keypoints = camera.project(pose, placed.distance)
    intrinsics = intrinsics_of(data, settings)
    pixels = torch.from_numpy(data.keypoints).to(keypoints.device)
    frames = _measured_again(
        frames, rows, *interpolate_gaps(frames, pixels, keypoints, intrinsics), settings, intrinsics
    )
    # With fewer gaps, the visible joints are lifted better too.
    return frames, replace(alone, **_with_rows(alone, rows, vars(lift(frames.select(rows)))))


def interpolate_gaps(
    frames: TrainingSet,
    pixels: Float[Tensor, "frames joints 2"],
    lifted: Float[Tensor, "frames joints 2"],
    intrinsics: Intrinsics | None,
) -> tuple[Float[Tensor, "frames joints 2"], Float[Tensor, "frames joints"]]:
    """Return keypoints and confidences with `gap_joints` where the refined poses have them.

    Their confidence is the median of that of visible joints.

    Args:
        frames: normalised.
        pixels: the keypoints of ``frames`` as they were measured.
        lifted: those of the refined poses, root-relative, in units.
        intrinsics: of the camera.
    """
    gap, seen = gap_joints(frames), frames.confidence > 0
    found = _pixels_of(frames, as_measured(frames, lifted), pixels, intrinsics)
    usual = _middle(frames.confidence[seen])
    return torch.where(gap[..., None], found, pixels), torch.where(gap, usual, frames.confidence)


def _measured_again(
    frames: TrainingSet,
    rows: Int[Tensor, " some"],
    pixels: Float[Tensor, "frames joints 2"],
    confidence: Float[Tensor, "frames joints"],
    settings: LifterSettings,
    intrinsics: Intrinsics | None,
) -> TrainingSet:
    """Return ``frames`` with other keypoints, in pixels, and confidences in some ``rows``."""
    normal = normalise(
        pixels[rows],
        confidence[rows],
        frames.skeleton.root_index,
        count_root=settings.radius == "all",
        intrinsics=intrinsics,
        distance=settings.distance,
    )
    new = {"keypoints": normal.keypoints, "scale": normal.scale_px, "distance": normal.distance}
    new |= {"rotation": normal.rotation, "confidence": confidence[rows]}
    return replace(frames, **_with_rows(frames, rows, new))


def _with_rows(whole: Any, rows: Int[Tensor, " some"], new: dict[str, Any]) -> dict[str, Tensor]:
    """Return fields of ``whole``, by name, with ``new`` values in some rows."""
    return {name: getattr(whole, name).index_put((rows,), value) for name, value in new.items() if value is not None}


def _pixels_of(
    frames: TrainingSet, keypoints: Tensor, pixels: Tensor, intrinsics: Intrinsics | None
) -> Float[Tensor, "frames joints 2"]:
    """Return where root-relative ``keypoints``, in units, are in the image; ``pixels`` says where the root is."""
    if intrinsics is None or frames.rotation is None:
        return pixels[:, [frames.skeleton.root_index]] + keypoints * frames.scale[:, None, None]
    rays = torch.cat([keypoints / frames.distance[:, None, None], torch.ones_like(keypoints[..., :1])], -1)
    rays = rays @ frames.rotation  # row vectors times R: back to the real camera
    found = rays[..., :2] / rays[..., 2:].clamp_min(0.05) * intrinsics.focal_px
    return found + keypoints.new_tensor(intrinsics.centre_px)


def _middle(values: Float[Tensor, " values"]) -> Float[Tensor, ""]:
    """Return the median: the mean of the middle two of an even number."""
    return (values.median() - (-values).median()) / 2


# Constant bones: joints move as little as possible.

_ROUNDS = 30


def with_constant_bones(
    pose: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton, body: Int[np.ndarray, " frames"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Return the poses with the same bone proportions in all frames of a ``body``.

    A bone's share of the total bone length is the median over the body's frames; each frame keeps its total.
    Bone by bone, both ends are moved by half of the error, repeatedly (SHAKE: Ryckaert, Ciccotti and Berendsen
    1977); the rest is set exactly, from the root outwards. Joints leave their lines of sight by as much as bones
    were wrong.

    Raises:
        UserError: bones that form loops, which cannot be set one by one.
    """
    if len(skeleton.bones) >= len(skeleton.joints):
        raise UserError(f"bones=constant: the bones of '{skeleton.name}' form loops and cannot be set one by one.")
    pairs = skeleton.bone_indices
    length = segment_lengths(pose, pairs)
    total = length.sum(1, keepdims=True)
    usual = median_by_body(length / np.maximum(total, 1e-9), body)
    wanted = usual / usual.sum(1, keepdims=True) * total
    moved = pose.astype(np.float64)
    for _ in range(_ROUNDS):
        for bone, (one, other) in enumerate(pairs):
            along = moved[:, other] - moved[:, one]
            now = np.linalg.norm(along, axis=-1)
            step = along * ((now - wanted[:, bone]) / np.maximum(2 * now, 1e-9))[:, None]
            moved[:, one] += step
            moved[:, other] -= step
    return _exact(moved, skeleton, wanted).astype(pose.dtype)


def _exact(pose: np.ndarray, skeleton: Skeleton, lengths: np.ndarray) -> np.ndarray:
    """Return root-relative poses whose bones have the directions of ``pose`` and these lengths."""
    place = {child: at for at, (_, child) in enumerate(skeleton.bones)}
    result = np.zeros_like(pose)
    for joint, parent in skeleton.parents.items():  # breadth first: a parent is set before its children
        if parent is not None:
            child, before = skeleton.index(joint), skeleton.index(parent)
            along = pose[:, child] - pose[:, before]
            along = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
            result[:, child] = result[:, before] + along * lengths[:, place[joint], None]
    return result


# Metric scale and level frame.


def mm_per_pixel(
    inferred: InferredPoses,
    pose: Float[np.ndarray, "frames joints 3"],
    data: PoseData,
    skeleton: Skeleton,
    body: Int[np.ndarray, " frames"],
    size: Size | None,
) -> Float[np.ndarray, " frames"] | None:
    """Return mm per pixel at each root's depth: by ``size``, the skeleton's size, or that of labelled bodies.

    Raises:
        UserError: a camera height without a known camera, or with bodies that are above it.
    """
    size = size or size_of_skeleton(skeleton)
    if isinstance(size, CameraHeight):
        rays = data.rays()
        if rays is None:
            raise UserError(
                "camera_height_mm gives the scale only if the camera is known: add focal_px=... and image_size=WIDTHxHEIGHT."
            )
        positions = pose + place_roots(pose, rays, data.confidence)[:, None]
        return mm_by_camera_height(pose, positions, inferred.gravity.cpu().numpy(), skeleton, body, size)
    if size is not None:
        return mm_per_unit(pose, skeleton, body, size)
    return None if inferred.mm_per_px is None else inferred.mm_per_px.cpu().numpy()


def to_level(
    pose: Float[np.ndarray, "frames joints 3"], gravity: Float[Tensor, "frames 3"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Return poses rotated the least way that brings ``gravity`` to y; this undoes roll as well as tilt."""
    rotation = least_rotation(gravity, gravity.new_tensor([0.0, 1.0, 0.0])).cpu()
    return turn(torch.from_numpy(pose), rotation).numpy()


# Live use: no frame knows of others that come more than a fixed lag after it.

LAG_SECONDS = 0.5
"""How much later than a frame the last one is that may change its pose."""
_PAST_SECONDS = 3.0
"""Of a clip that is lifted together: bodies are learned from it, and a longer one changes little."""


def causal_windows(data: PoseData) -> tuple[PoseData, Int[np.ndarray, " frames"]]:
    """Return short clips of ``data``, and the row among theirs of each frame of ``data``.

    Each clip ends with at most `LAG_SECONDS` of frames behind the last one that is taken from it. Frames are taken from a clip
    several at a time, those that one step of half the lag brings, so the lag is between half and all of `LAG_SECONDS`.
    A clip is a body of its own; what is known of all clips together (their mean body, what confidences are worth) is
    that of the whole file. ``data`` are in the order of `PoseData.in_order`.
    """
    fps = data.fps or USUAL_FPS
    hop = max(1, round(LAG_SECONDS * fps / 2))
    past = max(hop, round(_PAST_SECONDS * fps))
    follows = previous_frames(data.clips(), data.identity.get("frame")) >= 0
    starts = np.append(np.flatnonzero(~follows), len(data))
    rows, windows, taken = [], [], np.zeros(len(data), np.int64)
    total = 0
    for first, stop in pairwise(starts.tolist()):
        for start in range(first, stop, hop):
            low, high = max(first, start + hop - past), min(stop, start + 2 * hop)
            end = min(stop, start + hop)
            taken[start:end] = total + np.arange(start, end) - low
            rows.append(np.arange(low, high))
            windows.append(np.full(high - low, len(windows)))
            total += high - low
    every = np.concatenate(rows) if rows else np.zeros(0, np.int64)
    found = data.select(every)
    identity = {key: found.identity[key] for key in ("camera", "frame", "instance") if key in found.identity}
    names = np.concatenate(windows).astype(str) if windows else np.zeros(0, "U1")
    return replace(found, identity={**identity, "sequence": names}), taken
