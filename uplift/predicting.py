"""From keypoints to a prediction: lift, mend by clip, bridge gaps, give size and place where they are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from uplift.bridging import bridge_gaps
from uplift.constant_bones import with_constant_bones
from uplift.data.clean import clean
from uplift.data.container import PoseData, codes_of
from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.gravity import gravity_of, real_tilt
from uplift.lifter import Lifted
from uplift.lifting import lift_frames, refine_lifted
from uplift.placing import place_roots
from uplift.prediction import Prediction
from uplift.seeing import as_seen, frames_of, intrinsics_of
from uplift.sizing import CameraHeight, Size, mm_by_camera_height, mm_per_unit, size_of_skeleton
from uplift.views import least_rotation, turn

if TYPE_CHECKING:
    from uplift.model import Model

__all__ = ["predict_poses"]


@dataclass
class _Poses:
    """Poses in pixels at the depth of the root, in the real camera's frame."""

    pose: Tensor
    gravity: Tensor
    """(frames 3)"""
    spread: Tensor | None
    scale: Tensor
    """Pixels per unit of the model."""
    unit_mm: Tensor | None
    """Of one unit of the model, for bodies as large as labelled ones."""


def predict_poses(
    model: Model,
    data: PoseData,
    title: str = "",
    *,
    refine: bool = True,
    size: Size | None = None,
    constant_bones: bool = False,
) -> Prediction:
    """Return what `uplift.model.Model.predict` does."""
    order = data.in_order()
    if (np.diff(order) < 0).any():  # frames of a clip are neighbours in time only where they are neighbours in the rows
        found = predict_poses(model, data.select(order), title, refine=refine, size=size, constant_bones=constant_bones)
        return found.select(np.argsort(order))
    data, _ = clean(data, model.skeleton, drop=False)
    lifted = _lifted(model, data, model.refines(data, refine))
    body = _bodies(data)
    pose = lifted.pose.cpu().numpy()
    if constant_bones:
        pose = with_constant_bones(pose, model.skeleton, body)
    per_px = _mm_per_px(model, data, lifted, pose, body, size)
    unit = "px" if per_px is None else "mm"
    spread = None if lifted.spread is None else (lifted.spread * lifted.scale[:, None]).cpu().numpy()
    if per_px is not None:
        pose = (pose * per_px[:, None, None]).astype(np.float32)
        spread = None if spread is None else (spread * per_px[:, None]).astype(np.float32)
    level_pose = _levelled(pose, lifted.gravity) if model.skeleton.gravity else pose.copy()
    blank = (data.confidence > 0).sum(1) == 0
    pose[blank], level_pose[blank] = np.nan, np.nan
    rays = data.rays() if unit == "mm" else None
    gravity = lifted.gravity
    return Prediction(
        pose=pose,
        level_pose=level_pose,
        unit=unit,
        keypoints=data.keypoints,
        confidence=data.confidence,
        joint_names=model.skeleton.joints,
        skeleton=model.skeleton,
        tilt_deg=gravity[:, 2].clamp(-1, 1).asin().rad2deg().cpu().numpy() if model.skeleton.gravity else None,
        identity=data.identity,
        fps=data.fps,
        image_size=data.image_size,
        truth=data.pose,
        truth_unit=data.unit,
        spread=spread,
        root=None if rays is None else place_roots(pose, rays, data.confidence).astype(np.float32),
        filled=data.confidence == 0,
        source=data.source,
        title=title,
        notes=data.notes,
    )


def _lifted(model: Model, data: PoseData, refine: bool) -> _Poses:
    """Return the poses of cleaned ``data``; mended by clip and with short gaps bridged where ``refine``."""
    seen = as_seen(data, model.settings)
    frames, lifted = _once(model, seen, refine)
    if refine:
        whole = bridge_gaps(seen, frames, lifted, intrinsics_of(seen, model.settings))
        if whole is not None:  # with fewer gaps, all that is seen is lifted better
            frames, lifted = _once(model, whole, refine)
    pose = lifted.pose * frames.scale[:, None, None]
    if frames.rotation is not None:
        pose = turn(pose, frames.rotation.mT)
    gravity = gravity_of(real_tilt(lifted.tilt, frames.rotation), None)
    return _Poses(pose, gravity, lifted.spread, frames.scale, model.lifter.unit_mm(lifted.pose))


def _once(model: Model, data: PoseData, refine: bool) -> tuple[TrainingSet, Lifted]:
    """Return cleaned ``data`` in the model's units and its poses."""
    frames = frames_of(data, model.skeleton, model.settings).to(next(model.lifter.parameters()).device)
    lifted = lift_frames(model.lifter, frames, both_ways=model.settings.both_ways)
    if refine:
        lifted = refine_lifted(lifted, frames, model.lifter.camera, model.settings.refine)
    return frames, lifted


def _mm_per_px(
    model: Model,
    data: PoseData,
    lifted: _Poses,
    pose: Float[np.ndarray, "frames joints 3"],
    body: Int[np.ndarray, " frames"],
    size: Size | None,
) -> Float[np.ndarray, " frames"] | None:
    """Return the mm of one pixel at each root's depth: by the size given, the skeleton's, or that of labelled bodies."""
    size = size or size_of_skeleton(model.skeleton)
    if isinstance(size, CameraHeight):
        rays = data.rays()
        if rays is None:
            raise UserError(
                "camera_height_mm tells the size only where the camera is known: give focal_px=... and image_size=WIDTHxHEIGHT."
            )
        places = pose + place_roots(pose, rays, data.confidence)[:, None]
        return mm_by_camera_height(pose, places, lifted.gravity.cpu().numpy(), model.skeleton, body, size)
    if size is not None:
        return mm_per_unit(pose, model.skeleton, body, size)
    return None if lifted.unit_mm is None else (lifted.unit_mm / lifted.scale).cpu().numpy()


def _bodies(data: PoseData) -> Int[np.ndarray, " frames"]:
    """Return (frames,) numbers of bodies: of subjects where they are named, else of clips, else one for all."""
    if "subject" in data.identity:
        both = [data.identity[key].astype(str) for key in ("subject", "instance") if key in data.identity]
        return codes_of(np.array([" ".join(names) for names in zip(*both, strict=True)]))[1]
    clips = data.clips()
    return clips if clips.max(initial=-1) + 1 < len(clips) else np.zeros_like(clips)


def _levelled(pose: np.ndarray, gravity: Tensor) -> Float[np.ndarray, "frames joints 3"]:
    """Return poses turned the least way that brings gravity to y: roll is undone with the tilt."""
    turned = least_rotation(gravity, gravity.new_tensor([0.0, 1.0, 0.0])).cpu()
    return turn(torch.from_numpy(pose), turned).numpy()
