"""Bridge short gaps: a joint that the frames around show is put where the mended pose has it, and seen from then on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from uplift.data.container import PoseData
from uplift.data.tensors import TrainingSet
from uplift.lifter import Lifted
from uplift.lifting import as_measured
from uplift.normalise import Intrinsics

__all__ = ["bridge_gaps", "bridged_joints"]


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
