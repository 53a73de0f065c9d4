"""Keypoints that are far outside everything else in their file: slips of a tracker or of a hand, taken as missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uplift.data.poses import PoseData

__all__ = ["without_far"]

_OF_FILE, _OF_FRAME = 5, 20
"""How many times the spread of the file's keypoints, and of the frame's others, a keypoint is away."""
_MOST_POINTS = 1_000_000
_MOST_NAMED = 3


def without_far(data: PoseData) -> PoseData:
    """Return ``data`` without keypoints that are far outside, of confidence 0, and a note that names them.

    Far are those that are `_OF_FILE` times the range of nine tenths of the file's coordinates from their median, and
    `_OF_FRAME` times as far from the frame's other keypoints as these mostly are from each other. A body that is
    elsewhere as a whole is not.
    """
    seen = (data.confidence > 0) & np.isfinite(data.keypoints).all(-1)
    points = data.keypoints[seen]
    if not len(points):
        return data
    points = points[:: -(-len(points) // _MOST_POINTS)]
    low, middle, high = np.percentile(points, (5, 50, 95), axis=0)
    width = max(float((high - low).max()), 1e-6)
    outside = seen & (np.abs(data.keypoints - middle.astype(np.float32)) > _OF_FILE * width).any(-1)
    found = [] if not outside.any() else _far_of_frames(data, seen & ~outside, outside, 0.02 * width)
    if not found:
        return data
    confidence, keypoints = data.confidence.copy(), data.keypoints.copy()
    rows, joints = (np.array([one[place] for one in found]) for place in (0, 1))
    confidence[rows, joints], keypoints[rows, joints] = 0, 0
    return replace(data, confidence=confidence, keypoints=keypoints, notes=(*data.notes, _warning(data, found)))


Far = tuple[int, int, np.ndarray, float]
"""Row, joint, the middle of the frame's others, and how far these mostly are from it."""


def _far_of_frames(data: PoseData, others: np.ndarray, outside: np.ndarray, least: float) -> list[Far]:
    """Return which keypoints ``outside`` the file's range are far from the ``others`` of their frames, too."""
    found = []
    for row in np.flatnonzero(outside.any(1) & others.any(1)).tolist():
        points = data.keypoints[row, others[row]].astype(np.float64)
        middle = np.median(points, 0)
        spread = float(np.median(np.linalg.norm(points - middle, axis=-1)))
        away = np.linalg.norm(data.keypoints[row] - middle, axis=-1)
        far = np.flatnonzero(outside[row] & (away > _OF_FRAME * max(spread, least)))
        found += [(row, joint, middle, spread) for joint in far.tolist()]
    return found


def _warning(data: PoseData, found: list[Far]) -> str:
    """Return the note on keypoints that are far outside, the first by frame, joint and numbers."""
    when = next((data.identity[key] for key in ("image", "frame") if key in data.identity), np.arange(len(data)))
    told = [
        f"{data.joint_names[joint]} in frame {when[row]} at ({data.keypoints[row, joint, 0]:,.0f}, "
        f"{data.keypoints[row, joint, 1]:,.0f}), the frame's others about ({middle[0]:,.0f}, {middle[1]:,.0f}), mostly "
        f"within {spread:,.0f} px"
        for row, joint, middle, spread in found[:_MOST_NAMED]
    ]
    more = f"; and {len(found) - _MOST_NAMED:,} more" if len(found) > _MOST_NAMED else ""
    what = "1 keypoint is" if len(found) == 1 else f"{len(found):,} keypoints are"
    return f"WARNING: {what} far outside everything else and taken as missing: {'; '.join(told)}{more}"
