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
    confidence = np.clip(np.nan_to_num(data.confidence, nan=0.0, posinf=1.0, neginf=0.0), 0, 1)
    finite = np.isfinite(data.keypoints).all(-1) & (np.abs(np.nan_to_num(data.keypoints)) < 1e7).all(-1)
    confidence = np.where(finite, confidence, 0).astype(np.float32)
    visible = confidence > 0
    if not visible.any():
        raise UserError(
            f"{where}no keypoint in {len(data):,} frames is visible: all are NaN, infinite or of confidence 0."
        )
    keypoints = np.where(visible[..., None], data.keypoints, 0).astype(np.float32)
    too_few = visible.sum(1) < MIN_VISIBLE
    all_equal = ~too_few & (_extent(keypoints, visible) <= 1e-6 * (1 + np.abs(keypoints).max((1, 2))))
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
        missing_joints=int((~visible[~bad]).sum()),
        roots_filled=int(filled[~bad].sum()),
    )
    return data, report


def _extent(keypoints: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Return (frames,) the larger side, px, of the box around each frame's visible joints."""
    low = np.where(visible[..., None], keypoints, np.inf).min(1)
    high = np.where(visible[..., None], keypoints, -np.inf).max(1)
    return np.where(visible.any(1), (high - low).max(-1), 0)


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
