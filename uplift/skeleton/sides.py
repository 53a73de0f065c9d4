"""The two sides of a skeleton: which joint of a mirror pair is the left one, and which bones mirror each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uplift.skeleton import Skeleton

__all__ = ["CENTRE", "LEFT", "RIGHT", "bone_sides", "joint_sides", "mirrored_bones"]

CENTRE, LEFT, RIGHT = 0, 1, 2


def joint_sides(skeleton: Skeleton, joint_names: Sequence[str]) -> list[int]:
    """Return CENTRE, LEFT or RIGHT for every joint.

    The names of a pair tell (lhip and rhip, HipL and HipR); else the skeleton's ``left`` direction;
    else the order in which the pairs it does tell are written.
    """
    to_left = set(skeleton.facing["left"][1]) if "left" in skeleton.facing else set()
    told = {pair: _left_of(pair, to_left) for pair in skeleton.mirror}
    first = sum(left == pair[0] for pair, left in told.items() if left)
    known = sum(left is not None for left in told.values())
    usual = 0 if known and 2 * first > known else 1
    sides = dict.fromkeys(joint_names, CENTRE)
    for pair, left in told.items():
        left = left or pair[usual]
        sides |= {name: LEFT if name == left else RIGHT for name in pair}
    return [sides[name] for name in joint_names]


def bone_sides(sides: Sequence[int], bones: Sequence[Sequence[int]]) -> list[int]:
    """Return the side of every bone: that of its child."""
    return [sides[child] for _, child in bones]


def mirrored_bones(skeleton: Skeleton) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return the pairs of bones, as joint indices, that are each other's mirror image."""
    swap = skeleton.mirror_permutation
    bones = [(int(a), int(b)) for a, b in skeleton.bone_indices]
    pairs = []
    for first in bones:
        image = (int(swap[first[0]]), int(swap[first[1]]))
        second = next((bone for bone in bones if set(bone) == set(image)), None)
        if second is not None and set(second) != set(first) and (second, first) not in pairs:
            pairs.append((first, second))
    return pairs


def _left_of(pair: tuple[str, str], to_left: set[str]) -> str | None:
    """Return the left joint of a pair, or None where neither names nor the ``left`` direction tell."""
    for left_word, right_word in (("left", "right"), ("l", "r")):
        for left, right in (pair, pair[::-1]):
            if _differs_by(left.lower(), right.lower(), left_word, right_word):
                return left
    ends = [name for name in pair if name in to_left]
    return ends[0] if len(ends) == 1 else None


def _differs_by(left: str, right: str, left_word: str, right_word: str) -> bool:
    at = left.find(left_word)
    while at >= 0:
        if left[:at] + right_word + left[at + len(left_word) :] == right:
            return True
        at = left.find(left_word, at + 1)
    return False
