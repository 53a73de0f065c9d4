"""What enters training and prediction: finite numbers, honest confidence, a root in every frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.skeleton import Skeleton

__all__ = ["MIN_VISIBLE", "CleanReport", "clean", "joint_neighbours"]

MIN_VISIBLE = 3


@dataclass(frozen=True)
class CleanReport:
    """What `clean` found, in counts."""

    frames: int
    """Frames that came in."""
    too_few: int
    """Frames dropped: fewer than three visible joints."""
    all_equal: int
    """Frames dropped: all visible joints in one point."""
    missing_joints: int
    """Joints without a keypoint in the frames that stay."""
    roots_filled: int
    """Frames that stay whose root was missing and was filled from its neighbours."""

    def lines(self) -> list[str]:
        """Return the findings worth telling, one sentence each; none when all was whole."""
        found = []
        if self.too_few:
            found.append(f"{self.too_few:,} of {self.frames:,} frames dropped: fewer than {MIN_VISIBLE} visible joints")
        if self.all_equal:
            found.append(f"{self.all_equal:,} of {self.frames:,} frames dropped: all visible joints in one point")
        if self.missing_joints:
            found.append(f"{self.missing_joints:,} joints are missing (NaN or confidence 0)")
        if self.roots_filled:
            found.append(f"{self.roots_filled:,} frames had no root joint: filled from its visible neighbours")
        return found


def clean(data: PoseData, skeleton: Skeleton, *, drop: bool = True) -> tuple[PoseData, CleanReport]:
    """Return ``data`` with finite keypoints, confidence 0 where missing, and a root in every frame.

    ``data`` has the skeleton's joints in the skeleton's order. NaN, infinite and confidence 0 mean
    missing. A missing root is put at the mean of its nearest visible neighbours over the bones, for
    the others to be measured from, and flagged in `PoseData.root_filled`; its confidence stays 0, and
    the lifter says where it really is. With ``drop`` off, frames that cannot be lifted stay, with
    every confidence 0, so that an output keeps its rows.

    Raises:
        UserError: no frame is left, or no keypoint in the whole file is visible.
    """
    where = f"{data.source}: " if data.source else ""
    if len(data) == 0:
        raise UserError(f"{where}no frames in the file.")
    confidence = np.fmin(np.fmax(data.confidence, 0), 1).astype(np.float32)  # NaN is 0
    finite = np.abs(data.keypoints) < 1e7  # which NaN is not, either
    visible = finite[..., 0] & finite[..., 1] & (confidence > 0)
    if not visible.any():
        raise UserError(
            f"{where}no keypoint in {len(data):,} frames is visible: all are NaN, infinite or of confidence 0."
        )
    keypoints = data.keypoints.astype(np.float32)
    if not visible.all():
        keypoints[~visible] = 0
        confidence[~visible] = 0
    seen = _count(visible)
    too_few = seen < MIN_VISIBLE
    extent, largest = _extent(keypoints, visible)
    all_equal = ~too_few & (extent <= 1e-6 * (1 + largest))
    bad = too_few | all_equal
    if bad.all():
        raise UserError(
            f"{where}none of {len(data):,} frames can be used: {too_few.sum():,} have fewer than {MIN_VISIBLE} "
            f"visible joints, {all_equal.sum():,} have all joints in one point."
        )
    confidence[bad] = 0
    keypoints[bad] = 0
    keypoints, filled = _fill_root(keypoints, confidence, skeleton)
    data = replace(data, keypoints=keypoints, confidence=confidence, root_filled=filled)
    if drop and bad.any():
        data = data.select(~bad)
    report = CleanReport(
        frames=len(bad),
        too_few=int(too_few.sum()),
        all_equal=int(all_equal.sum()),
        missing_joints=int((visible.shape[1] - seen[~bad]).sum()),
        roots_filled=int(filled[~bad].sum()),
    )
    return data, report


def _count(visible: np.ndarray) -> np.ndarray:
    """Return (frames,) how many joints are visible: joint by joint, as NumPy is slow over a short last axis."""
    count = np.zeros(len(visible), np.int64)
    for joint in range(visible.shape[1]):
        count += visible[:, joint]
    return count


def _extent(keypoints: np.ndarray, visible: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (frames,) the larger side, px, of the box around each frame's visible joints, and its farthest coordinate."""
    low = np.full((len(keypoints), 2), np.inf, np.float32)
    high = -low
    for joint in range(keypoints.shape[1]):
        seen = True if visible[:, joint].all() else visible[:, joint, None]
        np.minimum(low, keypoints[:, joint], out=low, where=seen)
        np.maximum(high, keypoints[:, joint], out=high, where=seen)
    some = high[:, 0] >= low[:, 0]
    low[~some] = high[~some] = 0
    side, largest = high - low, np.maximum(np.abs(low), np.abs(high))
    return np.maximum(side[:, 0], side[:, 1]), np.maximum(largest[:, 0], largest[:, 1])


def joint_neighbours(skeleton: Skeleton) -> list[Sequence[int]]:
    """Return, nearest first, the joints at 1, 2, 3, ... bones from the root, as index lists."""
    rings: list[Sequence[int]] = []
    seen = {skeleton.root_index}
    ring = [skeleton.root_index]
    while ring:
        near = {int(j) for bone in skeleton.bone_indices for i, j in (bone, bone[::-1]) if i in ring} - seen
        seen |= near
        ring = sorted(near)
        if ring:
            rings.append(ring)
    return rings


def _fill_root(keypoints: np.ndarray, confidence: np.ndarray, skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Return the keypoints with missing roots at the mean of their neighbours, and which those are."""
    root = skeleton.root_index
    missing = (confidence[:, root] == 0) & (confidence > 0).any(1)
    filled = missing.copy()
    for ring in joint_neighbours(skeleton):
        if not missing.any():
            break
        weight = (confidence[:, ring] > 0)[..., None]
        use = missing & weight.any((1, 2))
        mean = (keypoints[:, ring] * weight).sum(1) / np.maximum(weight.sum(1), 1)
        keypoints[use, root] = mean[use]
        missing &= ~use
    return keypoints, filled
