"""Find the landmarks of bodies in whatever lists and objects stand around them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, TypeGuard

import numpy as np

from uplift.errors import UserError
from uplift.readers.mediapipe_landmarks import COUNTS

__all__ = ["bodies_in", "is_list_of_marks", "is_number", "plain_key", "values_of", "values_of_all"]

_BODIES = (
    "poselandmarks", "posenormalizedlandmarks", "landmarks", "landmark", "normalizedlandmarks", "keypoints", "pose",
    "poses", "people", "persons", "results", "handlandmarks", "multihandlandmarks", "facelandmarks", "data",
    "poseworldlandmarks", "worldlandmarks",
)  # fmt: skip
"""Keys that lead to landmarks, the image's before the world's."""
_SCORES = ("visibility", "score", "confidence")
_NAMES_IN_ORDER = ("name", "part", "landmark", "landmark_name", "label")
_NAMES = frozenset(_NAMES_IN_ORDER)
_LARGEST = 1e300
_DEEPEST = 6


def bodies_in(value: Any, where: str, depth: int) -> Iterator[list[tuple[str, Any]]]:
    """Yield the bodies in whatever lists and objects stand around their landmarks, as (name, landmark) each."""
    if depth > _DEEPEST:
        raise UserError(f"{where}: lists in lists, deeper than any landmarks are.")
    if value is None or value == [] or value == {}:
        return
    if isinstance(value, list):
        flat = _split(value)
        if flat is not None:
            value = flat
        if is_list_of_marks(value):
            yield [(_name(mark, place), mark) for place, mark in enumerate(value)]
            return
        for one in value:
            yield from bodies_in(one, where, depth + 1)
        return
    if isinstance(value, dict):
        keys = {plain_key(key): key for key in value}
        known = next((keys[key] for key in _BODIES if key in keys and value[keys[key]]), None)
        if known is not None:
            yield from bodies_in(value[known], where, depth + 1)
            return
        marks = {key: mark for key, mark in value.items() if _is_mark(mark)}
        if marks:
            yield list(marks.items())
        elif not any(key in keys for key in _BODIES):
            raise UserError(f"{where}: no landmarks among {', '.join(map(repr, list(value)[:6]))}.")
        return
    raise UserError(f"{where}: {value!r:.60}, expected landmarks.")


def _split(value: list[Any]) -> list[list[Any]] | None:
    """Return the landmarks of a list of bare numbers; None for any other list."""
    if len(value) < 42 or not all(is_number(one) for one in value):
        return None
    width = next((n for n in (4, 3, 2, 5) if len(value) % n == 0 and len(value) // n in COUNTS), None)
    return None if width is None else [value[at : at + width] for at in range(0, len(value), width)]


def is_list_of_marks(value: Any) -> bool:
    """Return whether a list begins with a landmark."""
    return isinstance(value, list) and bool(value) and _is_mark(value[0])


def _is_mark(value: Any) -> bool:
    if isinstance(value, dict):
        return "x" in value and "y" in value
    return isinstance(value, list) and 2 <= len(value) <= 5 and all(is_number(n) or n is None for n in value)


def _name(mark: Any, place: int) -> str:
    if isinstance(mark, dict) and not _NAMES.isdisjoint(mark):
        name = next((mark[key] for key in _NAMES_IN_ORDER if key in mark), None)
        if isinstance(name, str) and name:
            return name
    return str(place)


def values_of(mark: Any) -> tuple[float, float, float] | None:
    """Return x, y and visibility, NaN for what is null or not there; None where they are no numbers."""
    if isinstance(mark, dict):
        found = [mark.get("x"), mark.get("y"), next((mark[key] for key in _SCORES if key in mark), None)]
    elif isinstance(mark, list) and 2 <= len(mark) <= 5:
        found = [mark[0], mark[1], mark[3] if len(mark) > 3 else None]
    else:
        return None
    if not all(one is None or is_number(one) for one in found):
        return None
    x, y, score = (np.nan if one is None else min(max(float(one), -_LARGEST), _LARGEST) for one in found)
    return x, y, score


def values_of_all(marks: list[Any]) -> np.ndarray | None:
    """Return what `values_of` would of each, (marks, 3), where all are objects with numbers; None for any others."""
    try:
        flat = [value for mark in marks for value in (mark["x"], mark["y"], mark[_SCORES[0]])]
        if not set(map(type, flat)) <= {float, int}:
            return None
        values = np.array(flat, np.float64)
    except (KeyError, TypeError, OverflowError):
        return None
    return values.reshape(-1, 3) if (np.abs(values) < _LARGEST).all() else None


def is_number(value: Any) -> TypeGuard[int | float]:
    """Return whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e308


def plain_key(key: str) -> str:
    """Return the letters of a key, small."""
    return re.sub(r"[^a-z]", "", key.casefold())
