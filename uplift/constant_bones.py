"""Give the poses of one body the same bones: every bone keeps its direction and takes its usual length."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from uplift.errors import UserError
from uplift.skeleton import Skeleton

__all__ = ["with_constant_bones"]


def with_constant_bones(
    pose: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton, body: Int[np.ndarray, " frames"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Return the poses with, for each ``body``, one length of every bone, up to a size for each frame.

    The length is the median over the body's frames of the bone as a share of all its bones; the sum of
    all bones of a frame stays. Joints leave the lines of sight they were seen on by as much as bones
    were wrong.

    Raises:
        UserError: bones that close loops, which no such walk along them can keep.
    """
    if len(skeleton.bones) >= len(skeleton.joints):
        raise UserError(f"bones=constant: the bones of '{skeleton.name}' close loops and cannot be set one by one.")
    pairs = skeleton.bone_indices
    bones = pose[:, pairs[:, 1]] - pose[:, pairs[:, 0]]
    length = np.linalg.norm(bones, axis=-1)
    total = length.sum(1, keepdims=True)
    share = length / np.maximum(total, 1e-9)
    usual = share.copy()
    for one in np.unique(body):
        rows = body == one
        if np.isfinite(share[rows]).any():
            median = np.nanmedian(share[rows], axis=0)
            usual[rows] = median / median.sum()
    wanted = (bones / np.maximum(length, 1e-9)[..., None]) * (usual * total)[..., None]
    place = {child: at for at, (_, child) in enumerate(skeleton.bones)}
    result = pose.copy()
    for joint, parent in skeleton.parents.items():  # breadth first: a parent is set before its children
        if parent is not None:
            result[:, skeleton.index(joint)] = result[:, skeleton.index(parent)] + wanted[:, place[joint]]
    return result
