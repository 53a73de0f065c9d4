"""The ``key=value`` words of a command: which it takes, and what they are."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from uplift.errors import UserError, did_you_mean, nearest

if TYPE_CHECKING:
    from uplift.data.formats.base import ReadOptions

__all__ = [
    "EVALUATE_KEYS", "POSE_KEYS", "PREDICT_KEYS", "READ_KEYS", "SHAPE_KEYS", "SIMULATE_KEYS", "Keys", "keyed",
]  # fmt: skip

READ_KEYS = ("format", "layout", "image_size", "fps", "focal_px", "min_confidence")
"""What any command that reads keypoints takes, as `uplift.data.formats.base.ReadOptions` has it."""
POSE_KEYS = (
    "refine", "frames", "seed", "bones", "bone", "bone_mm", "camera_height_mm", *READ_KEYS[1:], "data.name", "data.root",
)  # fmt: skip
"""What predict takes for keypoints alone."""
SHAPE_KEYS = ("border", "pieces", "category", "most", "unit", "length_mm", "smooth", "together", "items")
"""What predict takes for masks alone."""
PREDICT_KEYS = ("run", "input", "output", "page", "images", "axes", "format", "height_mm", *POSE_KEYS, *SHAPE_KEYS)
SIMULATE_KEYS = ("skeleton", "output", "frames", "seed", "clip_seconds", "noise_px", "missing", "tracker")
EVALUATE_KEYS = ("run", "poses", "data.test", "skeleton", "refine", "items")


class Keys(dict[str, str]):
    """The ``key=value`` words of a verb, and its plain words; its methods raise UserError for an invalid value."""

    def __init__(self, verb: str, values: Mapping[str, str], plain: Sequence[str] = ()):
        super().__init__(values)
        self.verb, self.plain = verb, list(plain)

    def one_of(self, key: str, values: Collection[str]) -> str:
        """Return the value of ``key``, one of ``values``, by default the first."""
        value = self.get(key, next(iter(values)))
        if value not in values:
            raise UserError(f"{self.verb}: {key}={value!r}, expected {' or '.join(values)}.{nearest(value, values)}")
        return value

    def number(
        self,
        key: str,
        default: Any = None,
        *,
        least: int | float = -math.inf,
        above: int | float = -math.inf,
        most: int | float = math.inf,
        kind: type[int] | type[float] = float,
    ) -> Any:
        """Return the finite number of ``key`` within these limits, ``default`` where it is not given."""
        if key not in self:
            return default
        try:
            value = kind(self[key])
        except ValueError:
            value = math.nan
        if not (least <= value <= most and value > above and abs(value) < math.inf):
            bounds = {"of at least": least, "above": above, "and at most": most}
            limits = "".join(f" {name} {bound:,}" for name, bound in bounds.items() if abs(bound) < math.inf)
            what = "a whole number" if kind is int else "a number"
            raise UserError(f"{self.verb}: {key}={self[key]!r}, expected {what}{limits}.")
        return value

    def whole(self, key: str, default: int | None = None, **limits: int) -> Any:
        """Return the integer of ``key`` as `number` does."""
        return self.number(key, default, kind=int, **limits)

    def given(self, **kinds: type) -> dict[str, Any]:
        """Return those of these keys that are given, each of its kind: ``int``, ``float`` or ``str``."""
        found = {key: kind for key, kind in kinds.items() if key in self}
        return {key: self[key] if kind is str else self.number(key, kind=kind) for key, kind in found.items()}

    def listed(self, key: str) -> list[str]:
        """Return the comma-separated parts of ``key``."""
        return [part.strip() for part in self.get(key, "").split(",") if part.strip()]

    def reading(self) -> ReadOptions:
        """Return the `uplift.data.formats.base.ReadOptions` of those `READ_KEYS` that are given."""
        from uplift.data.formats.base import ReadOptions, size_of

        given = self.given(format=str, layout=str, fps=float, focal_px=float, min_confidence=float)
        return ReadOptions(**given, image_size=size_of(self["image_size"]) if "image_size" in self else None)


def keyed(
    verb: str,
    words: Sequence[str],
    known: Sequence[str],
    needed: Sequence[str] = (),
    *,
    prefixes: tuple[str, ...] = (),
    plain: bool = False,
) -> Keys:
    """Return the words of a verb; keys that start with one of ``prefixes`` are taken as they are.

    Raises:
        UserError: a word without "=" unless ``plain`` ones are allowed, an unknown key, one without a value or given
            twice, one missing.
    """
    from uplift.config.loading import split_words  # loads yaml, which `uplift --help` does without

    others, found = split_words(words, known if plain else None)
    if others and not plain:
        raise UserError(f"{verb}: '{others[0]}' is not one of its settings.{did_you_mean(others[0], known)}")
    for key, value in found.items():
        if key not in known and not key.startswith(prefixes):
            raise UserError(f"{verb}: '{key}={value}' is not one of its settings.{did_you_mean(key, known)}")
        if not value:
            raise UserError(f"{verb}: '{key}=' has no value.")
    for key in needed:
        if key not in found:
            raise UserError(f"{verb} needs {key}=... (uplift {verb} --help)")
    return Keys(verb, found, others)
