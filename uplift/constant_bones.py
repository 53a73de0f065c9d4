"""Give the poses of one body the same bones: joints move as little as it takes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from uplift.errors import UserError
from uplift.skeleton import Skeleton

__all__ = ["with_constant_bones"]

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
