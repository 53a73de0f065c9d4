"""Match the joints of a file to a skeleton's by name, or build them out of another layout's."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from uplift.errors import UserError, listed, nearest
from uplift.skeleton.core import Skeleton

__all__ = ["JointMatch", "WrongJoints", "build_joints", "build_pose", "match_joints", "shared_joints"]

_MOST_LAYOUTS = 3

Find = Callable[[str], int | None]


class WrongJoints(UserError):
    """A file's joints do not fit a skeleton."""

    def __init__(self, message: str, names: Sequence[str]):
        super().__init__(message)
        self.names = tuple(names)
        """Of the file's joints."""


@dataclass(frozen=True)
class JointMatch:
    """How each joint of a skeleton is made from a file: the names it is the mean of, or nothing."""

    skeleton: str
    layout: str | None
    """The layout of the skeleton's `from:` that was used; None for a match by name."""
    parts: dict[str, tuple[str, ...]]
    """Joint to the file's names, in the skeleton's order; joints that cannot be made are absent."""
    missing: tuple[str, ...]
    """Joints that cannot be made from this layout."""
    unused: tuple[str, ...]
    """Names in the file that no joint is made from."""

    def __str__(self) -> str:
        text = "joints by name" if self.layout is None else f"joints built from: {self.layout}"
        means = [joint for joint, parts in self.parts.items() if len(parts) > 1]
        text += f"; means: {listed(means)}" if means else ""
        text += f"; missing: {listed(self.missing)}" if self.missing else ""
        return text + (f"; unused: {listed(self.unused)}" if self.unused else "")


def match_joints(names: Sequence[str], skeleton: Skeleton) -> JointMatch:
    """Return how to build the skeleton's joints out of ``names``.

    By name first, then by the layout of the skeleton's ``from:`` that makes the most joints; each
    first with exact names, then with capitals ignored, then with blanks, dashes and underscores
    ignored too. Midpoints that the file lacks are made of their parts. Raises UserError that lists
    what is missing where neither works, or where a name comes twice.
    """
    names = [str(name) for name in names]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise UserError(f"found joint '{twice[0]}' {Counter(names)[twice[0]]} times; names must differ.")
    for find in _finders(names):
        found = [(None, _by_name(skeleton, find))]
        found += [(layout, _from_layout(skeleton, layout, find)) for layout in skeleton.sources]
        fitting = [(layout, places) for layout, places in found if places is not None]
        if fitting:
            by_name = fitting[0][0] is None
            layout, places = fitting[0] if by_name else max(fitting, key=lambda fit: len(fit[1]))
            return _describe(names, skeleton, layout, places)
    raise WrongJoints(_refusal(names, skeleton), names)


def build_joints(
    keypoints: Float[np.ndarray, "frames theirs xy"],
    confidence: Float[np.ndarray, "frames theirs"] | None,
    names: Sequence[str],
    skeleton: Skeleton,
) -> tuple[Float[np.ndarray, "frames joints xy"], Float[np.ndarray, "frames joints"], JointMatch]:
    """Return keypoints and confidence in the skeleton's joints and order, and how they were matched.

    A mean has the least confidence of its parts. What is missing (NaN, confidence 0, or
    cannot be made) is 0 with confidence 0. Raises UserError as `match_joints` does.
    """
    _check_count(keypoints, names)
    match = match_joints(names, skeleton)
    if confidence is None:
        confidence = np.ones(keypoints.shape[:2], dtype=np.float32)
    seen = np.isfinite(keypoints).all(-1) & (confidence > 0)
    clean = np.where(seen[..., None], keypoints, 0)
    known = np.where(seen, confidence, 0)
    shape = (len(keypoints), len(skeleton.joints))
    built = np.zeros((*shape, keypoints.shape[2]), dtype=clean.dtype)
    built_confidence = np.zeros(shape, dtype=known.dtype)
    for joint, places in _places(match, names, skeleton):
        built_confidence[:, joint] = known[:, places].min(1)
        built[:, joint] = clean[:, places].mean(1)
    built[built_confidence == 0] = 0
    return built, built_confidence, match


def build_pose(
    pose: Float[np.ndarray, "frames theirs 3"], names: Sequence[str], skeleton: Skeleton
) -> Float[np.ndarray, "frames joints 3"]:
    """Return the pose in the skeleton's joints and order, origin unchanged; NaN where a joint cannot be made.

    Raises UserError as `match_joints` does.
    """
    _check_count(pose, names)
    match = match_joints(names, skeleton)
    dtype = np.result_type(pose.dtype, np.float32)
    built = np.full((len(pose), len(skeleton.joints), pose.shape[2]), np.nan, dtype=dtype)
    for joint, places in _places(match, names, skeleton):
        built[:, joint] = pose[:, places].mean(1)
    return built


def shared_joints(skeleton: Skeleton, other: Skeleton) -> dict[str, tuple[str, ...]]:
    """Return the joints of ``skeleton`` that ``other`` has too, each with those of ``other`` that it is the mean of.

    Matched by name, as `match_joints` finds names, or by a layout in the ``from:`` of either, whichever matches more
    joints. Joints that ``other`` lacks are absent.
    """
    find, find_back = _finders(list(other.joints))[-1], _finders(list(skeleton.joints))[-1]
    found: list[dict[str, tuple[str, ...]]] = [
        {joint: (other.joints[place],) for joint in skeleton.joints if (place := find(joint)) is not None}
    ]
    for layout in skeleton.sources.values():
        places = {joint: [find(part) for part in parts] for joint, parts in layout.items()}
        found.append(
            {j: tuple(other.joints[p] for p in at if p is not None) for j, at in places.items() if None not in at}
        )
    for layout in other.sources.values():
        alone = {parts[0]: joint for joint, parts in layout.items() if len(parts) == 1}
        found.append(
            {skeleton.joints[p]: (joint,) for part, joint in alone.items() if (p := find_back(part)) is not None}
        )
    most = max(found, key=len)
    return {joint: most[joint] for joint in skeleton.joints if joint in most}


def _finders(names: list[str]) -> list[Find]:
    """Return how to find names: exactly, then ignoring capitals, then blanks, dashes and underscores too."""
    letters = lambda name: re.sub(r"[\s_-]+", "", name).casefold()  # noqa: E731
    return [_found_by(names, fold) for fold in (str, str.casefold, letters)]


def _found_by(names: list[str], fold: Callable[[str], str]) -> Find:
    exact = {name: place for place, name in enumerate(names)}
    count = Counter(map(fold, names))
    folded = {fold(name): place for name, place in exact.items() if count[fold(name)] == 1}
    return lambda name: exact.get(name, folded.get(fold(name)))


def _by_name(skeleton: Skeleton, find: Find) -> dict[str, list[int]] | None:
    """Return joint to places where every joint but midpoints is found, None otherwise."""
    found = {joint: place for joint in skeleton.joints if (place := find(joint)) is not None}
    lacking = any(joint not in found and joint not in skeleton.midpoints for joint in skeleton.joints)
    if lacking or len(set(found.values())) < len(found):
        return None
    return _with_midpoints({joint: [place] for joint, place in found.items()}, skeleton)


def _from_layout(skeleton: Skeleton, layout: str, find: Find) -> dict[str, list[int]] | None:
    """Return joint to places where every name the layout uses is found, None otherwise."""
    places: dict[str, list[int]] = {}
    at: dict[int, str] = {}
    alone: dict[int, str] = {}
    for joint, parts in skeleton.sources[layout].items():
        places[joint] = []
        for part in parts:
            place = find(part)
            if place is None or at.setdefault(place, part) != part:  # two names for one joint of the file
                return None
            places[joint].append(place)
        if len(parts) == 1 and alone.setdefault(places[joint][0], joint) != joint:
            raise UserError(
                f"skeleton '{skeleton.name}', from: {layout}: both '{alone[places[joint][0]]}' and '{joint}' are made of "
                f"'{parts[0]}' alone. A name goes into one joint, or into means: take one of them out."
            )
    return _with_midpoints(places, skeleton)


def _with_midpoints(places: dict[str, list[int]], skeleton: Skeleton) -> dict[str, list[int]]:
    """Add the midpoints that are not there; places are repeated so that every part weighs the same."""
    made: dict[str, list[int]] = {}
    for joint, parts in skeleton.midpoints.items():
        if joint not in places and all(part in places for part in parts):
            shared = math.lcm(*(len(places[part]) for part in parts))
            made[joint] = [place for part in parts for place in places[part] * (shared // len(places[part]))]
    return places | made


def _describe(names: list[str], skeleton: Skeleton, layout: str | None, places: dict[str, list[int]]) -> JointMatch:
    used = {place for joint in places.values() for place in joint}
    return JointMatch(
        skeleton=skeleton.name,
        layout=layout,
        parts={j: tuple(names[place] for place in places[j]) for j in skeleton.joints if j in places},
        missing=tuple(joint for joint in skeleton.joints if joint not in places),
        unused=tuple(name for place, name in enumerate(names) if place not in used),
    )


def _check_count(array: np.ndarray, names: Sequence[str]) -> None:
    if array.ndim != 3 or array.shape[1] != len(names):
        raise UserError(f"found an array of shape {array.shape} for {len(names)} joint names.")


def _places(match: JointMatch, names: Sequence[str], skeleton: Skeleton) -> list[tuple[int, list[int]]]:
    at = {str(name): place for place, name in enumerate(names)}
    return [(skeleton.index(joint), [at[part] for part in parts]) for joint, parts in match.parts.items()]


def _refusal(names: list[str], skeleton: Skeleton) -> str:
    find = _finders(names)[-1]
    missing = [joint for joint in skeleton.joints if find(joint) is None and joint not in skeleton.midpoints]
    hints = listed((f"'{joint}'{nearest(joint, names)}" for joint in missing), 6)
    text = f"the joints do not fit skeleton '{skeleton.name}': missing {hints}. Found: {listed(names)}."
    lacking = {
        layout: list(dict.fromkeys(part for parts in joints.values() for part in parts if find(part) is None))
        for layout, joints in skeleton.sources.items()
    }
    closest = sorted(lacking, key=lambda layout: len(lacking[layout]))
    for layout in closest[:_MOST_LAYOUTS]:
        text += f" Not {layout} either: no {listed(lacking[layout], 3)}."
    if len(closest) > _MOST_LAYOUTS:
        text += f" Nor {', '.join(closest[_MOST_LAYOUTS:])}."
    return text + " Choose the skeleton the file was made with, or add a `from:` map to the skeleton's YAML."
