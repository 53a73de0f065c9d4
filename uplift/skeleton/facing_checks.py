"""Check a skeleton's facing directions: what tells a pose from its mirror image must be able to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from uplift.errors import did_you_mean

if TYPE_CHECKING:
    from uplift.skeleton.checker import Checker

__all__ = ["check_facing"]

_DIRECTIONS = ("front", "left", "up")


def check_facing(skeleton: dict[str, Any], check: Checker) -> dict[str, list[list[str]]]:
    """Return facing with each end a list of joints; raises UserError where it cannot tell left from right."""
    given = skeleton["facing"]
    check.is_kind(given, dict, "a mapping of front, left and up", ("facing",))
    for direction in given:
        if direction not in _DIRECTIONS:
            hint = did_you_mean(direction, _DIRECTIONS)
            check.fail(("facing", direction), f"found the unknown facing direction '{direction}'.{hint}")
    facing = {name: _ends(given[name], skeleton["joints"], ("facing", name), check) for name in given}
    if not facing:
        return {}
    needed = ("front", "left") if skeleton["gravity"] else _DIRECTIONS
    for direction in needed:
        if direction not in facing:
            why = "" if skeleton["gravity"] else " (up is needed where gravity is false)"
            check.fail(("facing",), f"'{direction}' is missing; facing needs {' and '.join(needed)}{why}.")
    weights = {name: _weights(ends, skeleton["joints"]) for name, ends in facing.items()}
    _check_independent(weights, check)
    _check_sides(weights, skeleton, check)
    return facing


def _ends(value: object, joints: list[str], part: tuple, check: Checker) -> list[list[str]]:
    check.is_kind(value, list, "[from, to], each a joint or a list of joints", part)
    assert isinstance(value, list)
    if len(value) != 2:
        check.fail(part, f"found {len(value)} ends in '{part[-1]}'; expected two, [from, to].")
    return [check.parts(end, (*part, place), joints) for place, end in enumerate(value)]


def _weights(ends: list[list[str]], joints: list[str]) -> np.ndarray:
    weights = np.zeros(len(joints))
    for sign, end in zip((-1.0, 1.0), ends, strict=True):
        for joint in end:
            weights[joints.index(joint)] += sign / len(end)
    return weights


def _check_independent(weights: dict[str, np.ndarray], check: Checker) -> None:
    for count, name in enumerate(weights, 1):
        if np.abs(weights[name]).max() < 1e-9:
            check.fail(("facing", name), f"found '{name}' from and to the same place; it has no direction.")
        if np.linalg.matrix_rank(np.stack(list(weights.values())[:count]), tol=1e-9) < count:
            before = " and ".join(list(weights)[: count - 1])
            check.fail(
                ("facing", name),
                f"found '{name}' along {before}, whatever the pose; expected directions that differ.",
            )


def _check_sides(weights: dict[str, np.ndarray], skeleton: dict[str, Any], check: Checker) -> None:
    """Check against the mirror pairs: left must cross the body, front and up must not only cross it."""
    if not skeleton["mirror"]:
        return
    places = np.arange(len(skeleton["joints"]))
    for pair in skeleton["mirror"]:
        one, other = (skeleton["joints"].index(joint) for joint in pair)
        places[[one, other]] = other, one
    for name, direction in weights.items():
        mirrored = direction[places]
        if name == "left" and np.allclose(mirrored, direction):
            check.fail(
                ("facing", name),
                "'left' is the same on both sides of the body, so it tells nothing of left and right; "
                "expected [a joint on the right, its mirror partner on the left].",
            )
        if name != "left" and np.allclose(mirrored, -direction):
            check.fail(
                ("facing", name),
                f"'{name}' runs from one side of the body to the other, as 'left' should; "
                "expected joints on the midline, or means of both sides.",
            )
