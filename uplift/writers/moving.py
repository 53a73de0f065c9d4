"""What the moving formats share: one clip, its rate, and when each row is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from uplift.axes import FROM_LEVEL
from uplift.errors import UserError
from uplift.prediction import Prediction
from uplift.writers.clips import Clip, arrange
from uplift.writers.staging import beside

__all__ = ["frame_rate", "from_y_down", "known_points", "one_clip", "row_places", "seen_at", "steps"]


def one_clip(prediction: Prediction, path: str | Path, individuals: bool = True) -> Clip:
    """Return the only clip of a prediction; ``individuals``: there may be several in it.

    Raises UserError where there is none, where there are more, or more individuals than one and that is too many.
    """
    if not len(prediction):
        raise UserError(f"cannot write {path}: the prediction is empty. Check the input file.")
    clips = arrange(prediction.identity, len(prediction))
    if len(clips) > 1:
        names = ", ".join(clip.name for clip in clips[:3]) + (", ..." if len(clips) > 3 else "")
        raise UserError(f"cannot write {path}: a {Path(path).suffix} holds one clip, found {len(clips)}: {names}.")
    names = clips[0].individual_names
    if len(names) > 1 and not individuals:
        raise UserError(
            f"cannot write {path}: a {Path(path).suffix} holds one individual, found {len(names)}: "
            f"{', '.join(names[:5])}{', ...' if len(names) > 5 else ''}. Write one file for each."
        )
    return clips[0]


def frame_rate(prediction: Prediction, fps: int | float | None) -> float | None:
    """Return the frames a second that are asked for, or else the prediction's; None where neither is known.

    Raises UserError for an ``fps`` that is no positive number.
    """
    if fps is not None and not (np.isfinite(fps) and fps > 0):
        raise UserError(f"fps={fps:g}: expected frames a second, a number above 0.")
    found = prediction.fps if fps is None else fps
    return float(found) if found is not None and np.isfinite(found) and found > 0 else None


def steps(clip: Clip) -> Float[np.ndarray, " moments"]:
    """Return when each moment is, counted in frames of the rate from the first.

    The commonest step of the frame numbers is one frame, so that a wider step is a gap.
    """
    numbers = np.asarray(clip.frames, float)
    between = np.diff(numbers)
    if not len(between) or (between <= 0).any():
        return np.arange(len(numbers), dtype=float)
    sizes, count = np.unique(between, return_counts=True)
    return (numbers - numbers[0]) / sizes[np.argmax(count)]


def seen_at(when: Float[np.ndarray, " moments"], times: Float[np.ndarray, " times"]) -> Int[np.ndarray, " times"]:
    """Return the moment that is seen at each time: the last one that has come."""
    return np.maximum(np.searchsorted(when, times + 1e-6, side="right") - 1, 0)


def known_points(pose: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """Return the pose in float64 with every joint that is not finite NaN as a whole."""
    pose = np.array(pose, np.float64)
    pose[~np.isfinite(pose).all(-1)] = np.nan
    return pose


def held(values: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3"]:
    """Return values with NaN replaced by what was last known, at the start by what is known first, 0 without any."""
    known = np.isfinite(values).all(1)
    if not known.any():
        return np.zeros_like(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return values[np.where(last < 0, int(np.argmax(known)), last)]


def from_y_down(axes: str) -> Float[np.ndarray, "3 3"]:
    """Return the rotation from axes with x right, y down and z away to those of a name of `uplift.axes`."""
    return np.array(FROM_LEVEL.get(axes, FROM_LEVEL["level"]), float)


def row_places(prediction: Prediction, clip: Clip) -> Float[np.ndarray, "rows 3"]:
    """Return where the root of each row is, in the prediction's axes and unit, NaN where that is not known.

    The prediction's own root; else several individuals stand side by side as in the image, and one is at 0.
    """
    if prediction.root is not None:
        return known_points(prediction.root[:, None])[:, 0]
    found = np.zeros((len(prediction), 3))
    if len(clip.individual_names) > 1:
        turn = from_y_down(prediction.axes)
        seen = np.nan_to_num(np.asarray(prediction.confidence, float)) > 0
        pose = np.asarray(prediction.pose, float) @ turn
        found = beside(pose, np.asarray(prediction.keypoints, float), seen)[0] @ turn.T
    return found
