"""Simulated keypoints as a tracker gives them: a place and a likelihood for every joint, seen or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uplift.data.container import PoseData

__all__ = ["as_tracked"]

_SEEN, _GUESSED = (0.8, 1.0), (0.01, 0.3)


def as_tracked(data: PoseData, seed: int = 0) -> PoseData:
    """Return the 2D of ``data`` with the missing joints guessed, and likelihoods that tell them apart.

    A joint that is missing is put on another joint of the frame, as trackers mistake alike joints for
    each other, with a likelihood of 0.01 to 0.3; seen joints keep their place and have 0.8 to 1.
    """
    rng = np.random.default_rng([seed, 1])
    frames, joints = data.confidence.shape
    seen = data.confidence > 0
    # Every frame has a permutation of its joints with the seen ones first; guesses fall on those.
    order = np.argsort(rng.random((frames, joints)) + ~seen, axis=1)
    place = rng.integers(0, seen.sum(1).clip(1)[:, None], (frames, joints))
    other = np.take_along_axis(order, place, 1)
    guess = np.take_along_axis(data.keypoints, other[..., None], 1) + rng.normal(0, 5, data.keypoints.shape)
    likelihood = np.where(seen, rng.uniform(*_SEEN, (frames, joints)), rng.uniform(*_GUESSED, (frames, joints)))
    return replace(
        data.without_truth(),
        keypoints=np.where(seen[..., None], data.keypoints, guess).astype(np.float32),
        confidence=likelihood.astype(np.float32),
    )
