"""Predictions as motion capture has them: markers of one trial, a row for every moment."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.prediction import Prediction
from uplift.writers.clips import Clip, arrange

__all__ = ["Trial", "marker_names", "trial_of"]

_LONGEST_BYTES = 120
"""Of a marker's name; C3D has room for 127."""
_MOST_BLANK = 1_000_000


@dataclass(frozen=True)
class Trial:
    """One clip: ``points`` (moments markers 3) in mm, NaN where missing; the first is frame ``start``, from 0."""

    names: tuple[str, ...]
    points: np.ndarray
    start: int
    fps: float


def trial_of(prediction: Prediction, path: str | Path, kind: str) -> Trial:
    """Return the markers of the only clip of ``prediction``, gaps between its frames as blank moments.

    Frames are as far apart as the largest step that divides all distances of their numbers: thinned out
    films have no blanks, and ``start`` counts in those steps. Markers are the joints; of several individuals
    each has its name before them, as ``INDIVIDUAL_JOINT``. ``kind`` is what the file is called in errors.

    Raises:
        UserError: poses that are not in mm, no frame rate, not exactly one clip, or rows that no
            individual tells apart.
    """
    if prediction.unit != "mm":
        raise UserError(
            f"{path}: {kind} holds mm, these poses are in {prediction.unit}. Say how large the body is "
            "(height_mm=1750, or bone=), or write .csv, .json or .npz: they say their unit."
        )
    fps = prediction.fps
    if fps is None or not math.isfinite(fps) or fps <= 0:
        found = "is not known" if fps is None else f"is {fps}"
        raise UserError(f"{path}: {kind} needs the frame rate, which {found}. Say it: fps=30.")
    clips = arrange(prediction.identity, len(prediction))
    if len(clips) != 1:
        named = ", ".join(f"'{clip.name}'" for clip in clips[:3]) + (", ..." if len(clips) > 3 else "")
        told = f"{len(clips)} clips ({named}). Write a file for each" if clips else "no frames. Write at least one"
        raise UserError(f"{path}: {kind} holds one clip, found {told}.")
    return _trial(prediction, clips[0], f"{path}: ", float(fps))


def _trial(prediction: Prediction, clip: Clip, where: str, fps: float) -> Trial:
    numbers = np.asarray(clip.frames, np.int64)
    step = int(np.gcd.reduce(np.diff(numbers))) or 1
    place = ((numbers - numbers[0]) // step)[clip.moment]
    moments, individuals = int(place.max()) + 1, len(clip.individual_names)
    if moments > _MOST_BLANK and moments > 100 * len(numbers):
        raise UserError(
            f"{where}{len(numbers)} frames are numbered {numbers[0]} to {numbers[-1]}, which would make {moments} "
            "rows, nearly all blank. Expected 'frame' to count frames; write .csv to keep such numbers."
        )
    _refuse_doubles(clip, place * individuals + clip.individual, where)
    source = prediction.points[clip.rows]
    joints = len(prediction.joint_names)
    points = np.full((moments, individuals, joints, 3), np.nan, np.result_type(source, np.float32))
    points[place, clip.individual] = source
    points[~np.isfinite(points).all(-1)] = np.nan
    owners = [f"{name}_" for name in clip.individual_names] if individuals > 1 else [""]
    names = marker_names([owner + joint for owner in owners for joint in prediction.joint_names])
    return Trial(names, points.reshape(moments, -1, 3), max(int(numbers[0]) // step, 0), fps)


def _refuse_doubles(clip: Clip, cell: np.ndarray, where: str) -> None:
    """Refuse several rows of one individual at one moment, which ``cell`` numbers."""
    _, first, count = np.unique(cell, return_index=True, return_counts=True)
    if len(first) == len(cell):
        return
    row = first[count.argmax()]
    frame, name = clip.frames[clip.moment[row]], clip.individual_names[clip.individual[row]]
    raise UserError(
        f"{where}{count.max()} rows are frame {frame}{f' of {name!r}' if name else ''}. Expected one: name what tells "
        "them apart ('instance', 'camera' or 'sequence'), or write .csv."
    )


def marker_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return names that programs for motion capture can read: no white space or control signs, not long, all different."""
    given: dict[str, None] = {}
    for name in names:
        short = (
            re.sub(r"[\s\x00-\x1f\x7f-\x9f\ud800-\udfff]+", "_", name).encode()[:_LONGEST_BYTES].decode(errors="ignore")
        )
        short, count = short or "_", 1
        fresh = short
        while fresh in given:
            count += 1
            fresh = f"{short}_{count}"
        given[fresh] = None
    return tuple(given)
