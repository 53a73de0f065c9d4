"""What enters training and prediction: finite numbers, honest confidence, a root in every frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.skeleton import Skeleton

__all__ = ["JUMP", "MIN_VISIBLE", "clean", "fill_root", "joint_neighbours", "jump_of"]

JUMP = 0.3
"""Frames that mostly move by more than this, in sizes of the body, are not a video: each was seen by another camera."""
_MOST_ROWS, _MOST_PAIRS = 200_000, 20_000


def jump_of(data: PoseData) -> float:
    """Return the median over neighbours in time of how far joints move about the body's middle, in sizes of the body; 0 without any."""
    data = data.select(slice(0, _MOST_ROWS)) if len(data) > _MOST_ROWS else data
    order = data.in_order()
    ordered = data if (np.diff(order) > 0).all() else data.select(order)
    later = np.flatnonzero(ordered.follows())
    if "frame" not in ordered.identity or not len(later):
        same = ordered.clips()
        later = np.flatnonzero(same[1:] == same[:-1]) + 1
    later = later[:: max(1, len(later) // _MOST_PAIRS)]
    if not len(later):
        return 0.0
    one, other = (ordered.keypoints[rows].astype(np.float64) for rows in (later - 1, later))
    both = (ordered.confidence[later - 1] > 0) & (ordered.confidence[later] > 0)
    weight = (both / np.maximum(both.sum(1, keepdims=True), 1))[..., None]
    one, other = (points - (points * weight).sum(1, keepdims=True) for points in (one, other))
    size = np.sqrt((weight[..., 0] * (one**2).sum(-1)).sum(1))
    moved = (weight[..., 0] * np.linalg.norm(other - one, axis=-1)).sum(1)
    usable = (both.sum(1) >= 3) & (size > 0)
    return float(np.median(moved[usable] / size[usable])) if usable.any() else 0.0


MIN_VISIBLE = 3
_BLOCK = 4096


@dataclass(frozen=True)
class _CleanReport:
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
    jump: float = 0.0
    """How far joints mostly move between neighbours in time, in sizes of the body (`uplift.data.clean`)."""

    def lines(self) -> list[str]:
        """Return the findings worth reporting, one sentence each."""
        jump = (
            f"frames of one sequence jump (by {self.jump:.1f} of the body's size from one to the next): they are not "
            "a video of one camera, and each is a clip of its own"
        )
        of = f"of {self.frames:,} frames dropped"
        found = {
            f"{self.too_few:,} {of}: fewer than {MIN_VISIBLE} visible joints": self.too_few,
            f"{self.all_equal:,} {of}: all visible joints in one point": self.all_equal,
            f"{self.missing_joints:,} joints are missing (NaN or confidence 0)": self.missing_joints,
            f"{self.roots_filled:,} frames had no root joint: filled from its visible neighbours": self.roots_filled,
            jump: self.jump > JUMP,
        }
        return [text for text, holds in found.items() if holds]


def clean(
    data: PoseData, skeleton: Skeleton, *, drop: bool = True, jumps: bool = True
) -> tuple[PoseData, _CleanReport]:
    """Return ``data`` with finite keypoints, confidence 0 where missing, and a root in every frame.

    ``data`` has the skeleton's joints in the skeleton's order. NaN, infinite and confidence 0 mean
    missing. A missing root is put at the mean of its nearest visible neighbours over the bones, for
    the others to be measured from, and flagged in `PoseData.root_filled`; its confidence stays 0, and
    the lifter says where it really is. Sequences whose frames jump are `PoseData.stills`. With ``drop`` off, frames that cannot be lifted stay, with
    every confidence 0, so that an output keeps its rows. With ``jumps`` off, sequences are what ``data`` says of them.

    Raises UserError: no frame is left, or no keypoint in the whole file is visible.
    """
    where = f"{data.source}: " if data.source else ""
    if len(data) == 0:
        raise UserError(f"{where}no frames in the file.")
    keypoints, confidence, seen, extent, largest = _examine(data.keypoints, data.confidence)
    if not seen.any():
        raise UserError(
            f"{where}no keypoint in {len(data):,} frames is visible: all are NaN, infinite or of confidence 0."
        )
    too_few = seen < MIN_VISIBLE
    all_equal = ~too_few & (extent <= 1e-6 * (1 + largest))
    bad = too_few | all_equal
    if bad.all():
        raise UserError(
            f"{where}none of {len(data):,} frames can be used: {too_few.sum():,} have fewer than {MIN_VISIBLE} "
            f"visible joints, {all_equal.sum():,} have all joints in one point."
        )
    confidence[bad] = 0
    keypoints[bad] = 0
    keypoints, filled = fill_root(keypoints, confidence, skeleton)
    data = replace(data, keypoints=keypoints, confidence=confidence, root_filled=filled)
    jump = jump_of(data) if jumps and "sequence" in data.identity and not data.stills else 0.0
    data = replace(data, stills=data.stills or jump > JUMP)
    if drop and bad.any():
        data = data.select(~bad)
    missing = int((keypoints.shape[1] - seen[~bad]).sum())
    counts = len(bad), int(too_few.sum()), int(all_equal.sum()), missing, int(filled[~bad].sum())
    return data, _CleanReport(*counts, jump)


def _examine(
    keypoints: np.ndarray, confidence: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return both with what is missing as 0, and (frames,) how many joints are visible, the larger side of the box
    around them, px, and its farthest coordinate.

    Block by block, with the frames last: NumPy is slow over a short last axis and over what the caches do not hold.
    """
    frames = len(keypoints)
    points, trusted = np.empty(keypoints.shape, np.float32), np.empty(confidence.shape, np.float32)
    seen = np.empty(frames, np.int64)
    extent, largest = np.empty(frames, np.float32), np.empty(frames, np.float32)
    for start in range(0, frames, _BLOCK):
        rows = slice(start, start + _BLOCK)
        trust = np.fmin(np.fmax(np.ascontiguousarray(confidence[rows].T), 0), 1)  # NaN is 0
        place = np.ascontiguousarray(keypoints[rows].transpose(1, 2, 0), np.float32)
        finite = np.abs(place) < 1e7  # which NaN is not, either
        visible = finite[:, 0] & finite[:, 1] & (trust > 0)
        seen[rows] = visible.sum(0)
        points[rows], trusted[rows] = keypoints[rows], trust.T
        low, high = place, place
        if not visible.all():
            points[rows][~visible.T] = 0
            trusted[rows][~visible.T] = 0
            low, high = (np.where(visible[:, None], place, far) for far in (np.float32(np.inf), np.float32(-np.inf)))
        low, high = low.min(0), high.max(0)
        none = seen[rows] == 0
        low[:, none] = high[:, none] = 0
        extent[rows] = (high - low).max(0)
        largest[rows] = np.maximum(np.abs(low), np.abs(high)).max(0)
    return points, trusted, seen, extent, largest


def joint_neighbours(skeleton: Skeleton) -> list[Sequence[int]]:
    """Return, nearest first, the joints at 1, 2, 3, ... bones from the root, as index lists."""
    rings: list[Sequence[int]] = []
    ring = seen = {skeleton.root_index}
    while ring:
        near = {int(j) for bone in skeleton.bone_indices for i, j in (bone, bone[::-1]) if i in ring}
        ring, seen = near - seen, near | seen
        rings += [sorted(ring)] if ring else []
    return rings


def fill_root(keypoints: np.ndarray, confidence: np.ndarray, skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
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
