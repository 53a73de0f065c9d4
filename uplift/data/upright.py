"""Whether bodies stand upright in their images: files whose y grows upwards, and films that were turned, are told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uplift.data.human import standing_human
from uplift.data.poses import PoseData
from uplift.skeleton import Skeleton

__all__ = ["upright_notes", "ups_of"]

_MOST = 0.6
"""The share of frames in which a body may lie or hang the same way before it is said."""
_MOST_FRAMES = 20_000
_WAYS = {
    "upside down": "where y grows upwards in the file add flip_y=true, where the film is upside down rotate=180",
    "lying, with their upper end to the right": "where the film is turned add rotate=270",
    "lying, with their upper end to the left": "where the film is turned add rotate=90",
}


def upright_notes(parts: Sequence[PoseData], skeleton: Skeleton) -> list[str]:
    """Return a warning for each way in which the bodies of most frames of a file do not stand upright, with the files.

    ``parts`` are the files' frames in the skeleton's joints. Nothing is known without gravity, nor of skeletons that
    are not human and have no facing direction ``up``.
    """
    found: dict[str, list[tuple[PoseData, int, int]]] = {way: [] for way in _WAYS}
    for part in parts:
        ups = ups_of(part, skeleton)
        shares = _ways_of(ups)
        way = max(shares, key=lambda way: shares[way])
        if len(ups) and shares[way] > _MOST * len(ups):
            found[way].append((part, shares[way], len(ups)))
    return [_warning(way, which, skeleton, len(parts)) for way, which in found.items() if which]


def _warning(way: str, found: list[tuple[PoseData, int, int]], skeleton: Skeleton, files: int) -> str:
    count, of = sum(one[1] for one in found), sum(one[2] for one in found)
    names = ", ".join(one[0].source for one in found[:3]) + (f" and {len(found) - 3} more" if len(found) > 3 else "")
    return (
        f"WARNING: in {count:,} of {of:,} frames{f' of {names}' if files > 1 else ''} the bodies are {way}, and "
        f"{skeleton.name} stands upright: {_WAYS[way]} (in a fit data.flip_y=, data.rotate=). "
        "If they really are so, leave it as it is"
    )


def _ways_of(ups: np.ndarray) -> dict[str, int]:
    """Return how many of these directions point down, right and left rather than up."""
    x, y = ups.T
    counts = (y > np.abs(x), (x >= np.abs(y)) & (x > 0), (-x >= np.abs(y)) & (x < 0))
    return {way: int(np.sum(pointing)) for way, pointing in zip(_WAYS, counts, strict=True)}


def ups_of(data: PoseData, skeleton: Skeleton) -> np.ndarray:
    """Return (frames, 2) where the body's upper end is from its lower end, px, of the frames that show it."""
    if not skeleton.gravity or not len(data):
        return np.zeros((0, 2))
    rows = slice(None, None, -(-len(data) // _MOST_FRAMES))
    keypoints, confidence = data.keypoints[rows].astype(np.float64), data.confidence[rows]
    seen = (confidence > 0) & np.isfinite(keypoints).all(-1)
    if "up" in skeleton.facing:
        ends = [[skeleton.index(joint) for joint in joints] for joints in skeleton.facing["up"]]
        low, high = (_mean(keypoints[:, end], seen[:, end]) for end in ends)
        ups = high - low
    else:
        ups = _by_height(keypoints, seen, -standing_human(skeleton)[:, 1])
    return ups[np.isfinite(ups).all(1) & ups.any(1)]


def _by_height(keypoints: np.ndarray, seen: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Return (frames, 2) the way in which joints that are high on a standing body, in ``height``, are from low ones."""
    seen = seen & np.isfinite(height)
    height = np.where(seen, height, 0)
    from_middle = np.where(seen, height - height.sum(1, keepdims=True) / np.maximum(seen.sum(1, keepdims=True), 1), 0)
    points = np.where(seen[..., None], keypoints - _mean(keypoints, seen)[:, None], 0)
    return (from_middle[:, None] @ points)[:, 0]


def _mean(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the mean of the visible points of each frame; NaN where none is."""
    count = seen.sum(1, keepdims=True)
    return np.where(count > 0, np.where(seen[..., None], points, 0).sum(1) / np.maximum(count, 1), np.nan)
