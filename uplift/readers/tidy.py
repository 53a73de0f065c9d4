"""What readers do to keypoints and names alike: mark what is missing, tell equal names apart."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TypeVar

import numpy as np
from jaxtyping import Float32, Num

__all__ = ["as_float32", "distinct", "pairs_of", "same_or_none", "video_name", "visible_only"]

_T = TypeVar("_T")


def visible_only(
    keypoints: Num[np.ndarray, "... 2"], score: Num[np.ndarray, "..."]
) -> tuple[Float32[np.ndarray, "... 2"], Float32[np.ndarray, "..."]]:
    """Return keypoints with NaN, and confidence 0..1 with 0, where a coordinate is no number or the score is not over 0.

    Scores over 1 are clipped: heat maps peak a little over it.
    """
    score = as_float32(score)
    seen = np.isfinite(as_float32(keypoints)).all(-1) & (score > 0)
    keypoints = np.where(seen[..., None], as_float32(keypoints), np.float32(np.nan))
    return keypoints, np.where(seen, np.minimum(score, np.float32(1)), np.float32(0))


def as_float32(values: Num[np.ndarray, "..."]) -> Float32[np.ndarray, "..."]:
    """Return numbers as float32; those too large for it are infinite."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32, copy=False)


def video_name(path: str) -> str:
    """Return the name of a video, without folders (of any system) and ending."""
    name = re.split(r"[\\/]", path.strip().rstrip("\\/"))[-1]
    return re.sub(r"(?<=.)\.[A-Za-z0-9]{1,5}$", "", name)


def distinct(names: Iterable[str]) -> list[str]:
    """Return the names, a later one that has been there before with ``#2``, ``#3`` ... behind it."""
    given: list[str] = []
    count: dict[str, int] = {}
    for name in names:
        new = name
        while new in count:
            count[name] += 1
            new = f"{name}#{count[name]}"
        count[new] = 1
        given.append(new)
    return given


def pairs_of(pairs: Iterable[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Return pairs of partners of which none is in two."""
    found: dict[str, str] = {}
    for a, b in pairs:
        if a != b and not {a, b} & (set(found) | set(found.values())):
            found[a] = b
    return tuple(found.items())


def same_or_none(values: Iterable[_T | None]) -> _T | None:
    """Return the value that all are; None where they differ, or there are none."""
    found = list(dict.fromkeys(values))
    return found[0] if len(found) == 1 else None
