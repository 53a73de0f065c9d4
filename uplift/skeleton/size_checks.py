"""Check what a skeleton file says of the thing's size."""

from __future__ import annotations

from typing import Any

from uplift.errors import did_you_mean
from uplift.skeleton.checker import Checker

__all__ = ["check_size"]

_KEYS = ("along", "mm", "of_height")


def check_size(size: Any, joints: list[str], check: Checker) -> dict[str, Any]:
    """Return the checked ``size:``: a way along joints with its length in mm, or as a share of the body's height.

    Raises UserError with the place of the first fault.
    """
    check.is_kind(size, dict, "a mapping: along and mm, or along and of_height", ("size",))
    if not size:
        return {}
    for key in size:
        if key not in _KEYS:
            check.fail(("size", key), f"found the unknown key '{key}'.{did_you_mean(str(key), _KEYS)}")
    along = size.get("along")
    check.is_kind(along, list, "a list of two or more joints", ("size", "along"))
    if len(along) < 2:
        check.fail(("size", "along"), f"found {len(along)} joint; expected two or more, from one end to the other.")
    for place, joint in enumerate(along):
        check.is_joint(joint, joints, ("size", "along", place))
        if place and joint == along[place - 1]:
            check.fail(("size", "along", place), f"found '{joint}' twice in a row.")
    given = [key for key in ("mm", "of_height") if key in size]
    if len(given) != 1:
        check.fail(
            ("size",), f"found {' and '.join(given) or 'neither mm nor of_height'}; expected one of mm, of_height."
        )
    value = size[given[0]]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1e9:
        check.fail(("size", given[0]), f"found {value!r}; expected a positive number.")
    return {"along": list(along), given[0]: float(value)}
