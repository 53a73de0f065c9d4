"""Individuals whose joints one model tracks under names of their own (``B_Nose``, ``W_Nose``), as bodies of one set of joints."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np

from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.skeleton import Skeleton
from uplift.skeleton.match import match_joints
from uplift.skeleton.propose import mirror_pairs, seen_in

__all__ = ["by_individuals"]

_FEWEST = 3
"""Joints of an individual: a pose needs a shape."""
_MOST_WORDS = 3
"""That the name of an individual has: black_mouse_1."""
_SEPARATORS = re.compile(r"[\s_.\-]+")
_PARTS = re.compile(
    r"(l|r|left|right|top|bot|bottom|side|front|fore|hind|rear|back|upper|lower|mid|middle|inner|outer|cam|camera|view|"
    r"head|face|eye|ear|nose|neck|spine|body|trunk|tail|arm|hand|finger|thumb|index|ring|pinky|little|leg|foot|feet|toe|"
    r"paw|claw|wing|antenna|antennae|knee|hip|shoulder|elbow|wrist|ankle)[\s_.\-]*\d*",
    re.IGNORECASE,
)
"""Sides, cameras and parts of a body, which are no individuals."""
_APART, _OFTEN = 1.0, 0.2
"""How far individuals are from each other, in sizes of a body, in what share of the frames."""
_AS_LARGE = 3.0

Groups = dict[str, dict[str, str]]
"""Individual -> joint -> its name in the file."""


def by_individuals(data: PoseData, skeleton: Skeleton | None = None) -> PoseData:
    """Return ``data`` with a row for each individual whose names of joints differ from another's in one word at either end.

    With a ``skeleton`` that is where it does not fit the names of the file and does fit those without that word; other
    names are then left out. Without one, the individuals have all of the file's names, are about as large as
    each other, and are apart in the image at times. Sides, cameras and parts of a body are no individuals. A file
    that has individuals, poses or masks stays as it is.
    """
    if "instance" in data.identity or data.pose is not None or data.masks is not None:
        return data
    if skeleton is not None and _fits(data.joint_names, skeleton):
        return data
    for groups in _groupings(data.joint_names):
        count, joints = len(groups), tuple(next(iter(groups.values())))
        others = len(data.joint_names) - count * len(joints)
        if (not others and _are_bodies(data, groups)) if skeleton is None else _fits(joints, skeleton):
            note = f"{count} individuals told apart by the names of their joints ({', '.join(groups)})"
            note += f"; {others} other joints left out" if others else ""
            return replace(_divided(data, groups, joints), notes=(*data.notes, note))
    return data


def _fits(names: Sequence[str], skeleton: Skeleton) -> bool:
    with suppress(UserError):
        return bool(match_joints(names, skeleton))
    return False


def _groupings(names: Sequence[str]) -> Iterator[Groups]:
    """Yield the ways in which names are those of several individuals with the same joints, the fewest words first."""
    for words in range(_MOST_WORDS + 1):
        for behind in (False, True):
            found: Groups = {}
            for name in names:
                individual, joint = _parted(name, words, behind)
                if individual and joint:
                    found.setdefault(individual, {}).setdefault(joint, name)
            alike: dict[frozenset[str], list[str]] = {}
            for individual, joints in found.items():
                alike.setdefault(frozenset(joints), []).append(individual)
            joints, who = max(
                alike.items(), key=lambda one: (len(one[1]) > 1, len(one[0]) * len(one[1])), default=((), [])
            )
            named = [joint for joint in joints if re.search(r"[^\W\d_]", joint)]
            shared = {_parted(joint, 1, behind)[0] for joint in joints}  # one word: it belongs to the individual
            if len(who) < 2 or len(named) < _FEWEST or (len(shared) == 1 and shared != {""}):
                continue
            if not mirror_pairs(who) and not any(map(_PARTS.fullmatch, who)):
                yield {individual: found[individual] for individual in who}


def _parted(name: str, words: int, behind: bool) -> tuple[str, str]:
    """Return the individual and the joint that a name is of: its first words, or the last; no words: a number at the end."""
    if not words:
        number = re.fullmatch(r"(.*[^\W\d_])(\d{1,3})", name) if behind else None
        return (number[2], number[1]) if number else ("", "")
    between = list(_SEPARATORS.finditer(name))
    if len(between) < words:
        return "", ""
    cut = between[-words if behind else words - 1]
    first, last = name[: cut.start()], name[cut.end() :]
    return (last, first) if behind else (first, last)


def _are_bodies(data: PoseData, groups: Groups) -> bool:
    """Return whether groups of joints are about as large as each other, and no two of them always near each other."""
    found = [_middles(data, list(joints.values())) for joints in groups.values()]
    for (middle, size), (other_middle, other_size) in combinations(found, 2):
        both = np.isfinite(size) & np.isfinite(other_size)
        if not both.any():
            return False
        sizes = np.median(size[both]), np.median(other_size[both])
        gap = np.linalg.norm(middle[both] - other_middle[both], axis=-1)
        if max(sizes) > _AS_LARGE * min(sizes) or np.mean(gap > _APART * np.mean(sizes)) < _OFTEN:
            return False
    return True


def _middles(data: PoseData, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return (frames, 2) middles of the joints that are seen, and (frames,) the larger side of their box; NaN without two."""
    places = [data.joint_names.index(name) for name in names]
    seen = seen_in(data.keypoints[:, places], data.confidence[:, places])
    low = np.where(seen[..., None], data.keypoints[:, places], np.inf).min(1)
    high = np.where(seen[..., None], data.keypoints[:, places], -np.inf).max(1)
    with np.errstate(invalid="ignore"):
        return (low + high) / 2, np.where(seen.sum(1) > 1, (high - low).max(-1), np.nan)


def _divided(data: PoseData, groups: Groups, joints: tuple[str, ...]) -> PoseData:
    """Return the rows of each individual that show it, one individual after the other."""
    parts = []
    for individual, names in groups.items():
        places = [data.joint_names.index(names[joint]) for joint in joints]
        given = {name: joint for joint, name in names.items()}
        pairs = {
            kind: tuple(
                (given[one], given[other]) for one, other in getattr(data, kind) if {one, other} <= given.keys()
            )
            for kind in ("bones", "mirror")
        }
        part = replace(
            data,
            keypoints=data.keypoints[:, places],
            confidence=data.confidence[:, places],
            joint_names=joints,
            identity=data.identity | {"instance": np.full(len(data), individual)},
            **pairs,
        )
        parts.append(part.select(seen_in(part.keypoints, part.confidence).any(1)))
    return PoseData.concat(parts)
