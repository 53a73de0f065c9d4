"""A skeleton: joints by name with their bones, mirror pairs and facing directions."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from uplift.config.files import shipped, shipped_names
from uplift.config.yaml_file import read_yaml
from uplift.errors import UserError, did_you_mean
from uplift.skeleton.schema import BODY_KEYS
from uplift.skeleton.validate import check_skeleton, direction_weights, mirror_places

__all__ = [
    "CENTRE", "LEFT", "RIGHT", "Angle", "Skeleton", "Way", "bone_sides", "joint_sides", "load_skeleton", "mirrored_bones",
    "without_side",
]  # fmt: skip

Direction = tuple[tuple[str, ...], tuple[str, ...]]
Way = str | tuple[tuple[str, ...], ...]
"""A direction: one of the level frame by its name, from one mean of joints to another, or of three the normal of their plane."""


class Angle(NamedTuple):
    """An angle of the body; `uplift.biomechanics.angles` says how it is measured."""

    segment: Way
    start: Way | None = None
    """``from`` in the file."""
    about: Way | None = None
    towards: Way | None = None
    zero: float = 0.0
    """Degrees that are taken off."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data in the form of the YAML file."""
        ways = dict(zip(("segment", "from", "about", "towards"), self[:4], strict=True))
        plain = {
            key: way if isinstance(way, str) else list(map(list, way)) for key, way in ways.items() if way is not None
        }
        return plain | ({"zero": self.zero} if self.zero else {})

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Angle:
        """Return the angle of checked data."""
        ways = [data.get(key) for key in ("segment", "from", "about", "towards")]
        return cls(*(tuple(map(tuple, way)) if isinstance(way, list) else way for way in ways), data["zero"])  # type: ignore[arg-type]

    def mirrored(self, partner: Mapping[str, str]) -> Angle:
        """Return the angle that has the same value in a mirror, where joints have the names of their ``partner``.

        A mirror turns the sense of rotations round, and with it an axis and a normal.
        """
        about = None if self.about is None else _mirrored(self.about, partner, axis=True)
        others = (None if way is None else _mirrored(way, partner, axis=False) for way in (self.start, self.towards))
        start, towards = others
        return Angle(_mirrored(self.segment, partner, axis=False), start, about, towards, self.zero)


_REVERSED = {"up": "down", "down": "up", "image_right": "image_left", "image_left": "image_right"}


def _mirrored(way: Way, partner: Mapping[str, str], *, axis: bool) -> Way:
    """Return a direction in a mirror; an ``axis`` is reversed too. A mirror that stands upright leaves up where it is."""
    if isinstance(way, str):
        return _REVERSED[way] if axis == (way in ("up", "down")) else way
    ends = tuple(tuple(partner.get(joint, joint) for joint in end) for end in way)
    return (ends[0], *ends[:0:-1]) if len(ends) == 3 and not axis else ends[::-1] if len(ends) == 2 and axis else ends


@dataclass(frozen=True)
class Skeleton:
    """Joints by name and what is known about them; `load_skeleton` and `from_dict` check what they build."""

    name: str
    joints: tuple[str, ...]
    root: str
    bones: tuple[tuple[str, str], ...]
    mirror: tuple[tuple[str, str], ...] = ()
    facing: dict[str, Direction] = field(default_factory=dict)
    gravity: bool = True
    rigid: bool = False
    sources: dict[str, dict[str, tuple[str, ...]]] = field(default_factory=dict)
    body: dict[str, Any] = field(default_factory=dict)
    midpoints: dict[str, tuple[str, ...]] = field(default_factory=dict)
    size: dict[str, Any] = field(default_factory=dict)
    loops: bool = False
    contacts: tuple[str, ...] = ()
    description: str = ""
    trunk: Direction | tuple[()] = ()
    angles: dict[str, Angle] = field(default_factory=dict)
    """As they are written; `both_sides` has the others."""

    def __hash__(self) -> int:
        return hash((self.name, self.joints, self.root, self.bones))

    def index(self, name: str) -> int:
        """Return the index of joint ``name``; raises UserError with the nearest name where there is none."""
        try:
            return self._places[name]
        except KeyError:
            raise UserError(f"Skeleton '{self.name}' has no joint '{name}'.{did_you_mean(name, self.joints)}") from None

    @cached_property
    def _places(self) -> dict[str, int]:
        return {joint: place for place, joint in enumerate(self.joints)}

    @cached_property
    def root_index(self) -> int:
        """The index of the root joint."""
        return self.index(self.root)

    @cached_property
    def bone_indices(self) -> Int[np.ndarray, "bones 2"]:
        """Joint indices (parent, child), one row per bone."""
        return _read_only(np.array([[self.index(end) for end in bone] for bone in self.bones], dtype=np.int64))

    @cached_property
    def mirror_permutation(self) -> Int[np.ndarray, " joints"]:
        """For each joint the index of its mirror partner; its own where it has none."""
        return _read_only(mirror_places(self.joints, self.mirror))

    @cached_property
    def bone_mirror_permutation(self) -> Int[np.ndarray, " bones"]:
        """For each bone the index of its mirror image; its own where it has none."""
        places = {frozenset(bone): place for place, bone in enumerate(self.bone_indices.tolist())}
        images = self.mirror_permutation[self.bone_indices].tolist()
        return _read_only(np.array([places.get(frozenset(image), place) for place, image in enumerate(images)], int))

    @property
    def has_mirror_image(self) -> bool:
        """Whether a pose seen in a mirror is a pose again: there are pairs, and the root is on the mirror's plane.

        A root with a partner swaps with it: what was centred on one would be centred on the other.
        """
        return bool(self.mirror) and int(self.mirror_permutation[self.root_index]) == self.root_index

    @cached_property
    def parents(self) -> dict[str, str | None]:
        """The parent of each joint in the tree found breadth first from the root; None for the root."""
        return _tree_parents(self.joints, self.bones, self.root)

    def facing_matrix(self, direction: str) -> Float[np.ndarray, " joints"]:
        """Return weights with ``weights @ pose`` = the vector of ``direction`` (front, left or up).

        +1/n for the joints it points to, -1/n for those it comes from. Raises UserError where the
        skeleton does not give the direction.
        """
        if direction not in self.facing:
            hint = did_you_mean(direction, self.facing)
            raise UserError(f"Skeleton '{self.name}' gives no facing direction '{direction}'.{hint}")
        return direction_weights(self.facing[direction], self.joints)

    @cached_property
    def upright(self) -> Float[np.ndarray, " joints"] | None:
        """Weights with ``upright @ pose`` = the vector that points up when the body is upright: its trunk, else facing's up.

        None where the skeleton gives neither.
        """
        ends = self.trunk or self.facing.get("up")
        return _read_only(direction_weights(ends, self.joints)) if ends else None

    @cached_property
    def both_sides(self) -> dict[str, Angle]:
        """All `angles`: one whose name has the word right or left (or r, l) is followed by that of its other side, if unwritten."""
        partner = dict(self.mirror) | {other: one for one, other in self.mirror}
        found: dict[str, Angle] = {}
        for name, angle in self.angles.items():
            across, image = _across(name), angle.mirrored(partner)
            found[name] = angle
            if across and across not in self.angles and image != angle:
                found[across] = image
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return plain data in the form of the YAML file; `from_dict` turns it back."""
        return {
            "name": self.name, "description": self.description, "joints": list(self.joints), "root": self.root,
            "bones": [list(bone) for bone in self.bones], "loops": self.loops,
            "mirror": [list(pair) for pair in self.mirror],
            "facing": {name: [list(start), list(end)] for name, (start, end) in self.facing.items()},
            **({"trunk": [list(end) for end in self.trunk]} if self.trunk else {}),
            **({"angles": {name: angle.to_dict() for name, angle in self.angles.items()}} if self.angles else {}),
            "gravity": self.gravity, "rigid": self.rigid, "contacts": list(self.contacts), "midpoints": {joint: list(parts) for joint, parts in self.midpoints.items()},
            "from": {name: {joint: list(parts) for joint, parts in of.items()} for name, of in self.sources.items()},
            "size": dict(self.size), **{key: self.body[key] for key in BODY_KEYS if key in self.body},
        }  # fmt: skip

    @classmethod
    def from_dict(cls, data: object) -> Skeleton:
        """Return the skeleton of plain data, checked as a file is; raises UserError."""
        named = f"skeleton {data['name']!r}" if isinstance(data, Mapping) and "name" in data else "skeleton"
        return _from_checked(check_skeleton(data, lambda path: named))


def load_skeleton(name_or_path: str | Path) -> Skeleton:
    """Return a shipped skeleton by its name, or that of a YAML file; raises UserError with file and line."""
    if str(name_or_path) in shipped_names("skeletons"):
        return _load(shipped("skeletons") / f"{name_or_path}.yaml")
    return _load.__wrapped__(_skeleton_path(str(name_or_path)))  # a user's file may change


@cache
def _load(path: Path) -> Skeleton:
    data, where = read_yaml(path, "skeleton")
    if isinstance(data, dict):
        data.setdefault("name", path.stem)
    return _from_checked(check_skeleton(data, where))


def _skeleton_path(text: str) -> Path:
    path = Path(text).expanduser()
    if path.suffix.lower() in (".yaml", ".yml") or len(path.parts) != 1 or path.is_file():
        return path
    beside = path.with_name(path.name + ".yaml")
    if path.name and beside.is_file():
        raise UserError(f"There is no skeleton named '{text}', but a file {beside}. Write skeleton={beside}.")
    hint = did_you_mean(text, shipped_names("skeletons"))
    raise UserError(f"There is no skeleton named '{text}': expected a shipped name or the path of a YAML file.{hint}")


def _tree_parents(joints: tuple[str, ...], bones: tuple[tuple[str, str], ...], root: str) -> dict[str, str | None]:
    """Return the parent of every joint that bones connect to ``root``, found breadth first."""
    neighbours: dict[str, list[str]] = {joint: [] for joint in joints}
    for one, other in bones:
        neighbours[one].append(other)
        neighbours[other].append(one)
    parents: dict[str, str | None] = {root: None}
    queue = [root]
    for joint in queue:
        new = [other for other in neighbours[joint] if other not in parents]
        parents |= dict.fromkeys(new, joint)
        queue += new
    return parents


def _from_checked(data: dict[str, Any]) -> Skeleton:
    """Return the skeleton of checked data, each bone as (parent, child)."""
    joints, bones = tuple(data["joints"]), tuple(map(tuple, data["bones"]))
    parents = _tree_parents(joints, bones, data["root"])
    return Skeleton(
        **{key: data[key] for key in ("name", "root", "gravity", "rigid", "size", "loops", "description")},
        joints=joints,
        bones=tuple((other, one) if parents[one] == other else (one, other) for one, other in bones),
        mirror=tuple(map(tuple, data["mirror"])),
        contacts=tuple(data["contacts"]),
        facing={name: (tuple(start), tuple(end)) for name, (start, end) in data["facing"].items()},
        sources={name: {j: tuple(parts) for j, parts in of.items()} for name, of in data["from"].items()},
        body={key: data[key] for key in BODY_KEYS if key in data},
        midpoints={joint: tuple(parts) for joint, parts in data["midpoints"].items()},
        trunk=tuple(map(tuple, data["trunk"])),  # type: ignore[arg-type]
        angles={name: Angle.from_dict(angle) for name, angle in data["angles"].items()},
    )


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


CENTRE, LEFT, RIGHT = 0, 1, 2


def joint_sides(skeleton: Skeleton, joint_names: Sequence[str]) -> list[int]:
    """Return CENTRE, LEFT or RIGHT for every joint.

    From the names of a pair (lhip and rhip, HipL and HipR); else from the skeleton's ``left`` direction;
    else from the order in which the other pairs are written.
    """
    to_left = set(skeleton.facing["left"][1]) if "left" in skeleton.facing else set()
    found = {pair: _left_of(pair, to_left) for pair in skeleton.mirror}
    first = sum(left == pair[0] for pair, left in found.items() if left)
    known = sum(left is not None for left in found.values())
    usual = 0 if known and 2 * first > known else 1
    sides = dict.fromkeys(joint_names, CENTRE)
    for pair, left in found.items():
        left = left or pair[usual]
        sides |= {name: LEFT if name == left else RIGHT for name in pair}
    return [sides[name] for name in joint_names]


def bone_sides(sides: Sequence[int], bones: Sequence[Sequence[int]]) -> list[int]:
    """Return the side of every bone: that of its child."""
    return [sides[child] for _, child in bones]


def mirrored_bones(skeleton: Skeleton) -> Int[np.ndarray, "pairs 2"]:
    """Return the indices of bones that are each other's mirror image, each pair once."""
    pairs = [(place, other) for place, other in enumerate(skeleton.bone_mirror_permutation.tolist()) if place < other]
    return np.array(pairs, np.int64).reshape(-1, 2)


_OTHER_SIDE = {"right": "left", "r": "l"} | {"left": "right", "l": "r"}


def without_side(name: str) -> tuple[str, str]:
    """Return the words of a name but for the one that says its side, and "left", "right", or "" where none does."""
    words, place = _words(name)
    if place is None:
        return name, ""
    side = "left" if words[place].casefold() in ("left", "l") else "right"
    rest = "".join(words[:place] + words[place + 1 :])
    return re.sub(r"([^A-Za-z0-9])[^A-Za-z0-9]+", r"\1", rest).strip("_- "), side


def _words(name: str) -> tuple[list[str], int | None]:
    """Return a name's words and what is between them, and the place of the only one that says a side."""
    words = re.split(r"([^A-Za-z]+)", name)
    sides = [place for place, word in enumerate(words) if word.casefold() in _OTHER_SIDE]
    return words, sides[0] if len(sides) == 1 else None


def _across(name: str) -> str | None:
    """Return the name of the same on the other side; None for one without the word right or left, or r or l."""
    words, place = _words(name)
    if place is None:
        return None
    word = words[place]
    other = _OTHER_SIDE[word.casefold()]
    words[place] = other.upper() if word.isupper() else other.capitalize() if word[0].isupper() else other
    return "".join(words)


def _left_of(pair: tuple[str, str], to_left: set[str]) -> str | None:
    """Return the left joint of a pair; None where neither the names nor the ``left`` direction decide it."""
    for left_word, right_word in (("left", "right"), ("l", "r")):
        for name, other in (pair, pair[::-1]):
            left, right = name.lower(), other.lower()
            for at in re.finditer(left_word, left):
                if left[: at.start()] + right_word + left[at.end() :] == right:
                    return name
    ends = [name for name in pair if name in to_left]
    return ends[0] if len(ends) == 1 else None
