"""The ``key=value`` words of a command: which it takes, and what they are."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from uplift.errors import UserError, did_you_mean, nearest

if TYPE_CHECKING:
    from uplift.data.formats.base import ReadOptions

__all__ = [
    "EVALUATE_KEYS", "POSE_KEYS", "PREDICT_KEYS", "READ_KEYS", "SHAPE_KEYS", "SIMULATE_KEYS", "SIZE_KEYS", "check_keys", "keyed", "number", "one_of", "read_options",
    "whole",
]  # fmt: skip

READ_KEYS = ("format", "layout", "image_size", "fps", "focal_px", "min_confidence")
"""What any command that reads keypoints takes, as `uplift.data.formats.base.ReadOptions` has it."""
SIZE_KEYS = ("height_mm", "bone", "bone_mm", "camera_height_mm")
"""What tells how large a body is, as `uplift.models.metric_scale.size_from` has it."""
POSE_KEYS = (
    "refine", "frames", "seed", "bones", "bone", "bone_mm", "camera_height_mm", *READ_KEYS[1:], "data.name", "data.root",
)  # fmt: skip
"""What predict takes for keypoints alone."""
SHAPE_KEYS = ("border", "pieces", "category", "most", "unit", "length_mm", "smooth", "together", "items")
"""What predict takes for masks alone."""
PREDICT_KEYS = ("run", "input", "output", "page", "images", "axes", "format", "height_mm", *POSE_KEYS, *SHAPE_KEYS)
SIMULATE_KEYS = ("skeleton", "output", "frames", "seed", "clip_seconds", "noise_px", "missing", "tracker")
EVALUATE_KEYS = ("run", "poses", "data.test", "skeleton", "refine", "items")


def keyed(
    verb: str, words: Sequence[str], known: Sequence[str], needed: Sequence[str] = (), open_below: Sequence[str] = ()
) -> dict[str, str]:
    """Return the ``key=value`` words as a dict; keys ``open_below`` a prefix are taken as they are.

    Raises:
        UserError: not key=value, a key the command does not take, one without a value or twice, one missing.
    """
    from uplift.config.loading import split_words  # loads yaml, which `uplift --help` does without

    plain, found = split_words(words)
    for word in plain:
        raise UserError(f"{verb}: '{word}' is not one of its settings.{did_you_mean(word, known)}")
    check_keys(verb, found, known, open_below)
    for key in needed:
        if key not in found:
            raise UserError(f"{verb} needs {key}=... (uplift {verb} --help)")
    return found


def check_keys(verb: str, keys: Mapping[str, str], known: Sequence[str], open_below: Sequence[str] = ()) -> None:
    """Refuse a key that the command does not take, and one without a value."""
    for key, value in keys.items():
        if key not in known and not key.startswith(tuple(open_below) or ("=",)):
            raise UserError(f"{verb}: '{key}={value}' is not one of its settings.{did_you_mean(key, known)}")
        if not value:
            raise UserError(f"{verb}: '{key}=' has no value.")


def one_of(verb: str, keys: dict[str, str], key: str, values: Collection[str], default: str) -> str:
    """Return the value of ``key``, one of ``values``."""
    value = keys.get(key, default)
    if value not in values:
        raise UserError(f"{verb}: {key}={value!r}, expected {' or '.join(values)}.{nearest(value, values)}")
    return value


def whole(verb: str, keys: dict[str, str], key: str) -> int | None:
    """Return the whole number of ``key``; None where it is not given."""
    if key not in keys:
        return None
    try:
        return int(keys[key])
    except ValueError:
        raise UserError(f"{verb}: {key}={keys[key]!r}, expected a whole number.") from None


def number(verb: str, keys: dict[str, str], key: str) -> float | None:
    """Return the number of ``key``; None where it is not given."""
    if key not in keys:
        return None
    try:
        return float(keys[key])
    except ValueError:
        raise UserError(f"{verb}: {key}={keys[key]!r}, expected a number.") from None


def read_options(verb: str, keys: dict[str, str]) -> ReadOptions:
    """Return the `uplift.data.formats.base.ReadOptions` of those `READ_KEYS` that are given."""
    from uplift.data.formats.base import ReadOptions, size_of

    told = {
        "format": keys.get("format"),
        "layout": keys.get("layout"),
        "image_size": size_of(keys["image_size"]) if "image_size" in keys else None,
        "fps": number(verb, keys, "fps"),
        "focal_px": number(verb, keys, "focal_px"),
        "min_confidence": number(verb, keys, "min_confidence"),
    }
    return ReadOptions(**{key: value for key, value in told.items() if value is not None})
