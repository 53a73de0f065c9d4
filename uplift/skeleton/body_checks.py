"""Check the form of what a skeleton says about a body: proportions, rest pose and joint limits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from uplift.skeleton.checker import Checker

__all__ = ["BODY_KEYS", "check_body"]

BODY_KEYS = ("proportions", "rest", "limits")


def check_body(skeleton: dict[str, Any], check: Checker) -> None:
    """Check proportions (numbers > 0), rest (3-vectors, not zero) and limits (finite numbers) by joint.

    What they mean is for the simulator to say. Raises UserError.
    """
    for key in BODY_KEYS:
        if key not in skeleton:
            continue
        check.is_kind(skeleton[key], dict, "a mapping keyed by joint", (key,))
        for joint, value in skeleton[key].items():
            part = (key, joint)
            check.is_joint(joint, skeleton["joints"], part)
            if key == "proportions":
                _check_length(value, part, check)
            elif key == "rest":
                _check_vector(value, part, check)
            else:
                check.is_kind(value, (dict, list), "limits: a mapping or a list", part)
                _check_finite(value, part, check)


def _check_length(value: object, part: tuple, check: Checker) -> None:
    _check_number(value, part, check)
    assert isinstance(value, (int, float))
    if value <= 0:
        check.fail(part, f"found the length {value} for '{part[-1]}'; expected a number above 0.")


def _check_vector(value: object, part: tuple, check: Checker) -> None:
    check.is_kind(value, list, "a vector [x, y, z]", part)
    assert isinstance(value, list)
    if len(value) != 3:
        check.fail(part, f"found {len(value)} numbers for '{part[-1]}'; expected a vector [x, y, z].")
    for place, number in enumerate(value):
        _check_number(number, (*part, place), check)
    if not any(value):
        check.fail(part, f"found the vector {value} for '{part[-1]}'; expected one with a direction.")


def _check_finite(value: object, part: tuple, check: Checker) -> None:
    """Check every number inside nested lists and mappings; text is left to who reads it."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _check_finite(inner, (*part, key), check)
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            _check_finite(inner, (*part, place), check)
    elif not isinstance(value, str):
        _check_number(value, part, check)


def _check_number(value: object, part: tuple, check: Checker) -> None:
    if isinstance(value, bool):
        check.fail(part, f"found true or false in '{part[0]}'; expected a number.")
    check.is_kind(value, (int, float), "a number", part)
    assert isinstance(value, (int, float))
    if not math.isfinite(value) or abs(value) > 1e9:
        check.fail(part, f"found {value} in '{part[0]}'; expected a finite number.")
