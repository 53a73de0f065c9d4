"""Rows of a prediction as clips: moments in time, with one or several individuals in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Clip", "arrange", "photos"]

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

    def first(self, moments: int) -> Clip:
        """Return the clip cut after so many moments."""
        keep = self.moment < moments
        parts = self.rows[keep], self.moment[keep], self.individual[keep]
        return Clip(self.name, *parts, self.individual_names, self.frames[:moments])


def arrange(identity: dict[str, np.ndarray], rows: int) -> list[Clip]:
    """Return the clips in the order of their first row, each sorted by individual, then time.

    Rows of one frame are drawn together only where an ``instance`` (``individual``, ``track``) tells
    them apart; else they are other views of it and follow one another.
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
    names = _names(labels, groups)
    who = np.asarray(identity[instance]).astype(str) if instance else None
    return [_clip(name, group, identity.get("frame"), who) for name, group in zip(names, groups, strict=True)]


def photos(identity: dict[str, np.ndarray]) -> bool:
    """Return whether the rows are seen in photos, not in the frames of a film."""
    return "image" in identity and not {"sequence", "frame"} & set(identity)


def _codes(labels: Sequence[np.ndarray], rows: int) -> np.ndarray:
    """Return one number per row, equal for equal labels, growing with first appearance."""
    codes = np.zeros(rows, np.int64)
    for label in labels:
        _, inverse = np.unique(label, return_inverse=True)
        codes = np.unique(codes * (inverse.max(initial=0) + 1) + inverse, return_inverse=True)[1]
    _, first, inverse = np.unique(codes, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse]


def _names(labels: Sequence[np.ndarray], groups: Sequence[np.ndarray]) -> list[str]:
    """Return a name per clip out of the labels that differ between clips."""
    firsts = [group[0] for group in groups]
    telling = [label for label in labels if len(set(label[firsts])) > 1] or list(labels[:1])
    return [" · ".join(str(label[row]) for label in telling) or f"clip {n + 1}" for n, row in enumerate(firsts)]


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
