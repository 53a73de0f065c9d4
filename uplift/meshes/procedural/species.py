"""Proportions of four-legged animals, guessed by eye from how they look from the side: trunk length is 1."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

__all__ = ["SPECIES", "Build", "draw_build"]


@dataclass(frozen=True)
class Build:
    """One animal's proportions; lengths in lengths of its trunk, angles in degrees above level."""

    deep: int | float
    """The chest's height; `wide` its width; `hip` is the hips' size against the chest's."""
    wide: int | float
    hip: int | float
    leg: int | float
    """From the belly to the ground."""
    leg_thick: int | float
    neck: int | float
    neck_angle: int | float
    neck_thick: int | float
    head: int | float
    head_deep: int | float
    muzzle: int | float
    """The muzzle's end against the head's height."""
    head_angle: int | float
    ear: int | float
    tail: int | float
    tail_thick: int | float
    tail_angle: int | float
    horn: int | float = 0.0
    ears: str = "pointed"
    horns: str = "none"
    hump: int | float = 0.0
    snout: int | float = 0.0
    """How long a trunk hangs from the head."""


SPECIES: dict[str, Build] = {
    "horse": Build(0.48, 0.36, 0.97, 0.70, 0.16, 0.58, 48, 0.27, 0.46, 0.23, 0.5, -45, 0.12, 0.6, 0.07, -70),
    "donkey": Build(0.46, 0.36, 0.95, 0.58, 0.14, 0.46, 42, 0.24, 0.44, 0.22, 0.55, -40, 0.24, 0.5, 0.04, -75),
    "cow": Build(0.56, 0.44, 0.96, 0.46, 0.16, 0.38, 15, 0.34, 0.42, 0.26, 0.62, -40, 0.16, 0.6, 0.03, -82, 0.22, "side", "curved"),
    "deer": Build(0.42, 0.30, 0.92, 0.70, 0.11, 0.46, 55, 0.17, 0.32, 0.17, 0.42, -28, 0.18, 0.12, 0.06, -40, 0.5, "side", "antlers"),
    "antelope": Build(0.42, 0.30, 0.88, 0.66, 0.1, 0.44, 50, 0.17, 0.32, 0.17, 0.45, -32, 0.16, 0.3, 0.03, -75, 0.45, "side", "straight"),
    "dog": Build(0.42, 0.32, 0.82, 0.52, 0.12, 0.3, 45, 0.23, 0.4, 0.22, 0.42, -8, 0.16, 0.48, 0.06, 25, 0, "pointed"),
    "hound": Build(0.42, 0.30, 0.72, 0.60, 0.10, 0.32, 48, 0.19, 0.42, 0.19, 0.42, -10, 0.18, 0.5, 0.04, 5, 0, "hanging"),
    "fox": Build(0.34, 0.27, 0.88, 0.40, 0.09, 0.24, 35, 0.2, 0.38, 0.19, 0.25, -8, 0.17, 0.65, 0.14, -18),
    "cat": Build(0.36, 0.29, 0.92, 0.38, 0.11, 0.2, 38, 0.21, 0.26, 0.23, 0.55, -8, 0.12, 0.75, 0.06, 15),
    "lion": Build(0.42, 0.34, 0.85, 0.42, 0.14, 0.24, 25, 0.3, 0.34, 0.28, 0.6, -8, 0.08, 0.75, 0.04, -35, 0, "round"),
    "bear": Build(0.56, 0.48, 1.02, 0.38, 0.22, 0.24, 15, 0.38, 0.38, 0.29, 0.42, -10, 0.08, 0.06, 0.06, -45, 0, "round"),
    "pig": Build(0.56, 0.50, 1.0, 0.26, 0.15, 0.12, 0, 0.44, 0.42, 0.32, 0.45, -22, 0.15, 0.14, 0.03, 15),
    "sheep": Build(0.58, 0.54, 1.0, 0.34, 0.09, 0.24, 40, 0.26, 0.32, 0.2, 0.5, -32, 0.13, 0.14, 0.08, -65, 0.16, "side", "curled"),
    "goat": Build(0.48, 0.40, 0.97, 0.44, 0.1, 0.32, 50, 0.2, 0.32, 0.19, 0.48, -32, 0.15, 0.12, 0.06, 40, 0.3, "side", "swept"),
    "giraffe": Build(0.56, 0.38, 0.75, 1.2, 0.16, 1.3, 62, 0.25, 0.46, 0.2, 0.42, -28, 0.14, 0.7, 0.04, -80, 0.1, "side", "straight"),
    "elephant": Build(0.72, 0.60, 0.95, 0.52, 0.28, 0.18, 12, 0.46, 0.42, 0.48, 0.62, -55, 0.42, 0.5, 0.04, -80, 0.35, "fans", "tusks", 0, 0.85),
    "rhino": Build(0.62, 0.54, 1.0, 0.36, 0.23, 0.26, 2, 0.42, 0.5, 0.3, 0.6, -30, 0.13, 0.35, 0.04, -75, 0.22, "pointed", "nose"),
    "hippo": Build(0.66, 0.60, 1.0, 0.22, 0.2, 0.16, 2, 0.48, 0.54, 0.36, 0.9, -14, 0.06, 0.2, 0.04, -75, 0, "round"),
    "camel": Build(0.54, 0.42, 0.85, 0.85, 0.13, 0.75, 42, 0.22, 0.42, 0.21, 0.5, -15, 0.07, 0.4, 0.04, -75, 0, "round", "none", 0.3),
    "bison": Build(0.66, 0.48, 0.7, 0.38, 0.15, 0.26, -8, 0.44, 0.42, 0.32, 0.55, -50, 0.1, 0.4, 0.04, -75, 0.18, "side", "curved", 0.14),
    "rabbit": Build(0.5, 0.44, 1.12, 0.22, 0.14, 0.14, 40, 0.3, 0.36, 0.28, 0.5, -15, 0.42, 0.1, 0.1, 30),
}  # fmt: skip
"""Named after what they resemble: none is measured."""

_SPREAD = 0.1
_SPREAD_DEG = 6.0


def draw_build(rng: np.random.Generator) -> tuple[str, Build]:
    """Return a species and the proportions of one of it, every third mixed with another species."""
    names = list(SPECIES)
    name = names[int(rng.integers(len(names)))]
    own, other = SPECIES[name], SPECIES[names[int(rng.integers(len(names)))]]
    share = rng.uniform(0.0, 0.4) if rng.random() < 0.33 else 0.0
    values = {}
    for part in fields(Build):
        value = getattr(own, part.name)
        if isinstance(value, str):
            values[part.name] = value
            continue
        value = (1 - share) * value + share * getattr(other, part.name)
        is_angle = part.name.endswith("angle")
        values[part.name] = value + rng.normal(0, _SPREAD_DEG) if is_angle else value * np.exp(rng.normal(0, _SPREAD))
    if values["ears"] in ("pointed", "side") and rng.random() < 0.15:
        values["ears"] = "hanging"
    if values["horns"] in ("antlers", "curled", "curved", "swept") and rng.random() < 0.4:
        values["horns"] = "none"  # many females have none
    return name, Build(**values)
