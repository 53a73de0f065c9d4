"""Which of several layouts unnamed keypoints are in: the one whose bones are short."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

__all__ = ["bone_share", "likely_layout"]

_CLEARLY = 0.65
"""Another layout than the usual is taken where its bones are this much of the usual one's."""
_MOST_ROWS = 500


def likely_layout(
    keypoints: Float[np.ndarray, "rows keypoints 2"],
    confidence: Float[np.ndarray, "rows keypoints"],
    layouts: Sequence[tuple[str, tuple[str, ...]]],
) -> int:
    """Return which of ``layouts``, (shipped skeleton, names in order), the keypoints are in; the first unless another is clearly better.

    Names in a wrong order join a knee to an ear: the bones of the right layout are much the shortest,
    counted in sizes of the body.
    """
    step = max(1, len(keypoints) // _MOST_ROWS)
    shares = [bone_share(keypoints[::step], confidence[::step], *layout) for layout in layouts]
    best = int(np.argmin(shares))
    return best if shares[best] < _CLEARLY * shares[0] else 0


def bone_share(
    keypoints: Float[np.ndarray, "rows keypoints 2"],
    confidence: Float[np.ndarray, "rows keypoints"],
    skeleton: str,
    names: tuple[str, ...],
) -> float:
    """Return the median over bodies of the mean bone that is seen, as a share of the body's size; infinite where none is."""
    from uplift.skeleton import load_skeleton
    from uplift.skeleton.matching import build_joints

    shipped = load_skeleton(skeleton)
    points, sure, _ = build_joints(keypoints, confidence, names, shipped)
    one, other = shipped.bone_indices.T
    seen = (sure[:, one] > 0) & (sure[:, other] > 0)
    length = np.where(seen, np.linalg.norm(points[:, one] - points[:, other], axis=-1), 0)
    shown = np.isfinite(keypoints).all(-1) & (confidence > 0)
    low = np.where(shown[..., None], keypoints, np.inf).min(1)
    high = np.where(shown[..., None], keypoints, -np.inf).max(1)
    with np.errstate(invalid="ignore"):
        size = np.linalg.norm(high - low, axis=-1)
    usable = (seen.sum(1) >= 3) & np.isfinite(size) & (size > 0)
    if not usable.any():
        return float("inf")
    return float(np.median(length[usable].sum(1) / seen[usable].sum(1) / size[usable]))
