"""Whether a size that a user gives can be in millimetres, or is in metres or centimetres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uplift.data.human import standing_human
from uplift.models.metric_scale import CameraHeight, size_from
from uplift.skeleton import Skeleton

__all__ = ["odd_size", "small_size"]

_HUMAN_MM = (300.0, 3000.0)
"""Height of a human, newborns included."""
_CAMERA_MM = (50.0, 1e6)
"""Height of a camera above the ground that humans stand on."""
_SMALL_MM = 5.0
"""Below this a length of what is not known to be small may be in metres."""
_UNITS = {"metres": 1000.0, "centimetres": 10.0}


def odd_size(skeleton: Skeleton, given: Mapping[str, Any]) -> str | None:
    """Return a warning where a size, arguments of `uplift.models.metric_scale.size_from`, cannot be in mm; None otherwise.

    Of humans it is known how large they are. Of others a length below 5 mm is told.
    """
    name = next((key for key in ("height_mm", "bone_mm", "camera_height_mm") if given.get(key)), None)
    if name is None:
        return None
    value, size, human = float(given[name]), size_from(skeleton, **given), standing_human(skeleton)
    if not np.isfinite(human).any():
        return small_size({name: value})
    if isinstance(size, CameraHeight):
        return _warning(name, value, value, _CAMERA_MM, "has the camera {} above the ground that humans stand on")
    path = human[[skeleton.index(joint) for joint in size.along]] if size is not None else human[:0]
    share = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    if not share > 0:  # joints whose place on the body is not known
        return small_size({name: value})
    height = value if name == "height_mm" else value / share
    return _warning(name, value, height, _HUMAN_MM, f"makes {skeleton.name}, a human, {{}} high")


def small_size(given: Mapping[str, Any]) -> str | None:
    """Return a note on the first length, in mm by its name, that is so small that metres may be meant; None without any."""
    for name, value in given.items():
        if name.endswith("_mm") and value and value < _SMALL_MM:
            return f"WARNING: {name}={value:g} is {value:g} mm: if metres are meant, give {name}={1000 * value:g}"
    return None


def _warning(name: str, value: float, length: float, limits: tuple[float, float], makes: str) -> str | None:
    """Return the warning on a length outside the limits, in words with a gap for it; None within them."""
    low, high = limits
    if low <= length <= high:
        return None
    fits = [(unit, by) for unit, by in _UNITS.items() if low <= length * by <= high]
    meant = f": {fits[0][0]}? Then give {name}={value * fits[0][1]:g}" if fits else ""
    long = f"{length:,.0f} mm" if length >= 100 else f"{length:.3g} mm"
    return f"WARNING: {name}={value:g} {makes.format(long)}, expected {low:,.0f} to {high:,.0f} mm{meant}"
