"""Rows of a prediction as clips: moments in time, with one or several individuals in each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from uplift.config.files import without_folders
from uplift.errors import UserError, listed
from uplift.models.prediction import Prediction

__all__ = [
    "MOST_FILES", "Clip", "arrange", "clip_names", "evenly", "frame_rate", "one_body", "one_clip", "photos", "seen_at", "steps",
    "titled",
]  # fmt: skip

MOST_FILES = 500
"""That one prediction is written to."""
_CLIP_KEYS = ("subject", "action", "sequence", "camera")
_INSTANCE_KEYS = ("instance", "individual", "track")


@dataclass(frozen=True)
class Clip:
    """One clip; row ``rows[i]`` shows individual ``individual[i]`` at moment ``moment[i]``."""

    name: str
    rows: np.ndarray
    moment: np.ndarray
    individual: np.ndarray
    individual_names: tuple[str, ...]
    frames: tuple[int, ...]
    title: str = ""
    """The name for people: where a part of it is a number alone, it says of what."""

    def by_moment(self, values: np.ndarray) -> np.ndarray:
        """Return values of all rows (rows ...) as (moments individuals ...) floats, NaN where an individual is not there."""
        shape = len(self.frames), len(self.individual_names), *values.shape[1:]
        found = np.full(shape, np.nan, np.result_type(values, np.float32))
        found[self.moment, self.individual] = values[self.rows]
        return found

    def only(self, individual: str) -> Clip:
        """Return the clip with the rows of one individual, and the moments of all."""
        keep = self.individual == self.individual_names.index(individual)
        return Clip(
            self.name, self.rows[keep], self.moment[keep], np.zeros(keep.sum(), int), (individual,), self.frames
        )

    def first(self, moments: int) -> Clip:
        """Return the clip cut after so many moments."""
        keep = self.moment < moments
        parts = self.rows[keep], self.moment[keep], self.individual[keep]
        return Clip(self.name, *parts, self.individual_names, self.frames[:moments], self.title)


def arrange(identity: Mapping[str, Any], rows: int) -> list[Clip]:
    """Return the clips in the order of their first row, each sorted by individual, then time.

    Rows of one frame are drawn together only where an ``instance`` (``individual``, ``track``) tells
    them apart; otherwise they are different views of it and follow one another.
    """
    instance = next((key for key in _INSTANCE_KEYS if key in identity), None)
    # A subject may be what tells individuals apart, and then it does not part clips.
    keys = [key for key in _CLIP_KEYS if key in identity and not (instance and key == "subject")]
    if photos(identity):
        keys.append("image")
    labels = [np.asarray(identity[key]).astype(str) for key in keys]
    codes = _codes(labels, rows)
    order = np.argsort(codes, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(codes[order])) + 1) if rows else []
    names, titles = _names(labels, groups), _names(labels, groups, keys)
    who = np.asarray(identity[instance]).astype(str) if instance else None
    clips = [_clip(name, group, identity.get("frame"), who) for name, group in zip(names, groups, strict=True)]
    return [replace(clip, title=title) for clip, title in zip(clips, titles, strict=True)]


def clip_names(firsts: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the names that `arrange` gives clips which are together, of the identity of a row (1,) of each."""
    names = [""] * len(firsts)
    identity = {key: np.concatenate([one[key] for one in firsts]) for key in firsts[0]} if firsts else {}
    for clip in arrange(identity, len(firsts)):
        for row in clip.rows.tolist():
            names[row] = clip.name
    return names


_WORDS = {"sequence": "clip", "instance": "individual"}


def titled(key: str, value: object) -> str:
    """Return the value of an identity for people: "camera 0" where it is a number alone, which says nothing."""
    text = str(value)
    return f"{_WORDS.get(key, key)} {text}" if text.isdecimal() else text


def photos(identity: Mapping[str, Any]) -> bool:
    """Return whether the rows are seen in photos, not in the frames of a film."""
    return "image" in identity and not {"sequence", "frame"} & set(identity)


def _codes(labels: Sequence[np.ndarray], rows: int) -> np.ndarray:
    """Return one number per row, equal for equal labels, growing with first appearance."""
    codes = np.zeros(rows, np.int64)
    for label in labels:
        _, inverse = np.unique(label, return_inverse=True)
        codes = np.unique(codes * (inverse.max(initial=0) + 1) + inverse, return_inverse=True)[1]
    _, first, inverse = np.unique(codes, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]


def _names(labels: Sequence[np.ndarray], groups: Sequence[np.ndarray], keys: Sequence[str] = ()) -> list[str]:
    """Return a name per clip out of the labels that differ between clips; for people, where their ``keys`` are given."""
    firsts = [int(group[0]) for group in groups]
    telling = [place for place, label in enumerate(labels) if len(set(label[firsts])) > 1] or list(range(len(labels)))[
        :1
    ]

    def text(place: int, row: int) -> str:
        label = without_folders(str(labels[place][row]))
        return titled(keys[place], label) if keys else label

    return [" · ".join(text(place, row) for place in telling) or f"clip {n + 1}" for n, row in enumerate(firsts)]


def _clip(name: str, rows: np.ndarray, frame: np.ndarray | None, who: np.ndarray | None) -> Clip:
    number = np.arange(len(rows)) if frame is None else np.asarray(frame)[rows].astype(np.int64)
    if who is None:
        order = np.argsort(number, kind="stable")
        rows, number = rows[order], number[order]
        return Clip(name, rows, np.arange(len(rows)), np.zeros(len(rows), int), ("",), tuple(number.tolist()))
    names, individual = np.unique(who[rows], return_inverse=True)
    if frame is None:
        # Without frame numbers the n-th row of every individual is the n-th moment.
        order = np.argsort(individual, kind="stable")
        starts = np.searchsorted(individual[order], individual[order])
        number = np.empty(len(rows), np.int64)
        number[order] = np.arange(len(rows)) - starts
    frames, moment = np.unique(number, return_inverse=True)
    order = np.lexsort((moment, individual))
    parts = rows[order], moment[order], individual[order]
    return Clip(name, *parts, tuple(names.tolist()), tuple(frames.tolist()))


def one_clip(prediction: Prediction, path: str | Path) -> Clip:
    """Return the only clip of a prediction; raises UserError for none or several."""
    if not len(prediction):
        raise UserError(f"cannot write {path}: the prediction is empty. Check the input file.")
    clips = arrange(prediction.identity, len(prediction))
    if len(clips) > 1:
        names = listed((clip.name for clip in clips), 3)
        raise UserError(f"cannot write {path}: a {Path(path).suffix} holds one clip, found {len(clips)}: {names}.")
    return clips[0]


def one_body(prediction: Prediction, path: str | Path, individual: str | None = None) -> Clip:
    """Return the only clip of a prediction with the rows of ``individual``, unset: of its only one.

    The moments are those of all individuals: where one is seen in every second frame, frames are no farther apart.
    Raises UserError as `one_clip`, for several individuals, and for one that is not there.
    """
    clip = one_clip(prediction, path)
    names = clip.individual_names
    if individual is None and len(names) == 1:
        return clip
    if individual not in names:
        wanted = "holds one individual" if individual is None else f"of '{individual}' was asked for"
        raise UserError(
            f"cannot write {path}: a {Path(path).suffix} {wanted}, found {len(names)}: {listed(names, 5)}. Write one file for each."
        )
    return clip.only(str(individual))


_MOST_BLANK = 1_000_000


def evenly(clip: Clip, path: str | Path) -> tuple[Clip, int]:
    """Return the clip with a moment for every frame between its first and last, and how many frames are before the first.

    Frames are as far apart as the largest step that divides all distances of their numbers: thinned out films get no
    blank moments, and what is before the first counts in those steps, too. Raises UserError for an individual that is
    in a frame twice, and for numbers that leave nearly all moments blank.
    """
    numbers = np.asarray(clip.frames, np.int64)
    step = int(np.gcd.reduce(np.diff(numbers))) or 1
    place = (numbers - numbers[0]) // step
    moments = int(place[-1]) + 1
    if moments > _MOST_BLANK and moments > 100 * len(clip.rows):
        raise UserError(
            f"{path}: {len(clip.rows)} frames are numbered {numbers[0]} to {numbers[-1]}, which would make {moments} "
            "rows, nearly all blank. Expected 'frame' to count frames; write .csv to keep such numbers."
        )
    moment = place[clip.moment]
    _refuse_doubles(clip, moment, path)
    return replace(clip, moment=moment, frames=tuple(range(numbers[0], numbers[-1] + 1, step))), int(numbers[0]) // step


def _refuse_doubles(clip: Clip, moment: np.ndarray, path: str | Path) -> None:
    """Refuse several rows of an individual in one frame."""
    _, first, count = np.unique(
        moment * len(clip.individual_names) + clip.individual, return_index=True, return_counts=True
    )
    if len(first) == len(moment):
        return
    row = first[count.argmax()]
    name, frame = clip.individual_names[clip.individual[row]], clip.frames[clip.moment[row]]
    raise UserError(
        f"{path}: {count.max()} rows are frame {frame}{f' of {name!r}' if name else ''}. Expected one: name what tells "
        "them apart ('instance', 'camera' or 'sequence'), or write .csv."
    )


def frame_rate(prediction: Prediction, fps: int | float | None) -> float | None:
    """Return the frames a second asked for, or else the prediction's; None where neither is known.

    Raises UserError for an ``fps`` that is not above 0.
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
