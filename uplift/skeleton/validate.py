"""Check the plain data of a skeleton file; every fault is reported with its line."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float, Int

from uplift.config.yaml_file import Where
from uplift.errors import UserError, did_you_mean
from uplift.skeleton.schema import (
    ANGLE_KEYS,
    BODY_KEYS,
    DEFAULTS,
    DIRECTIONS,
    KEYS,
    LEVEL,
    MAX_JOINTS,
    REQUIRED,
    SIZE_KEYS,
)

__all__ = ["check_skeleton", "direction_weights", "mirror_places"]


def check_skeleton(data: object, where: Where) -> dict[str, Any]:
    """Return the data with defaults filled in and single joints made lists.

    Raises UserError at the first fault, its message begun by ``where`` (file and line).
    """
    check = _Checker(where)
    skeleton = _check_keys(data, check)
    for key in ("name", "description"):
        check.text(skeleton[key], (key,), blank=key == "description")
    for key in ("gravity", "rigid", "loops"):
        check.kind(skeleton[key], bool, "true or false", (key,))
    joints = skeleton["joints"]
    _check_joints(joints, check)
    check.joint(skeleton["root"], joints, ("root",))
    check.pairs(skeleton["bones"], joints, "bones", "[parent, child]")
    _check_forest(skeleton, check)
    check.pairs(skeleton["mirror"], joints, "mirror", "[right, left]")
    _check_mirror(skeleton, check)
    _check_contacts(skeleton, check)
    skeleton["midpoints"] = check.map_of_parts(skeleton["midpoints"], joints, ("midpoints",), midpoints=True)
    check.kind(skeleton["from"], dict, "a mapping of layouts", ("from",))
    skeleton["from"] = {
        layout: check.map_of_parts(parts, joints, ("from", layout)) for layout, parts in skeleton["from"].items()
    }
    skeleton["size"] = _check_size(skeleton["size"], joints, check)
    skeleton["facing"] = _check_facing(skeleton, check)
    skeleton["trunk"] = _check_trunk(skeleton, check)
    skeleton["angles"] = _check_angles(skeleton, check)
    _check_body(skeleton, check)
    return skeleton


def _check_keys(data: object, check: _Checker) -> dict[str, Any]:
    if not isinstance(data, dict):
        check.fail((), f"found {_named(data)}; expected a skeleton, a mapping with joints, root and bones.")
    for key in data:
        if key not in KEYS:
            check.fail((key,), f"found the unknown key '{key}'.{did_you_mean(key, KEYS)}")
    for key in REQUIRED:
        if key not in data:
            check.fail((), f"'{key}' is missing; a skeleton needs {', '.join(REQUIRED)}.")
    return {"name": "skeleton"} | copy.deepcopy(DEFAULTS) | data


# Joints and bones: connected, and the same on both sides.


def _check_joints(joints: object, check: _Checker) -> None:
    names = check.kind(joints, list, "a list of joint names", ("joints",))
    if not 3 <= len(names) <= MAX_JOINTS:
        check.fail(("joints",), f"found {len(names)} joints; expected 3 to {MAX_JOINTS}.")
    seen: set[str] = set()
    for place, joint in enumerate(names):
        check.text(joint, ("joints", place))
        if joint in seen:
            check.fail(("joints", place), f"found joint '{joint}' twice; joint names must differ.")
        seen.add(joint)


def _check_forest(skeleton: dict[str, Any], check: _Checker) -> None:
    """Check that bones connect all joints, each bone once, and close loops only where that is meant."""
    joints, bones = skeleton["joints"], skeleton["bones"]
    group = {joint: joint for joint in joints}  # equal where bones join two joints so far
    seen: set[frozenset] = set()
    for place, (one, other) in enumerate(bones):
        if frozenset((one, other)) in seen:
            check.fail(("bones", place), f"found the bone between '{one}' and '{other}' twice.")
        seen.add(frozenset((one, other)))
        if group[one] == group[other] and not skeleton["loops"]:
            check.fail(
                ("bones", place),
                f"found a cycle: the bone [{one}, {other}] joins joints that are connected already. Take one bone of "
                "the cycle out, or, if the thing closes on itself (a chair's seat), write loops: true.",
            )
        gone = group[one]
        group = {joint: group[other] if name == gone else name for joint, name in group.items()}
    for place, joint in enumerate(joints):
        if group[joint] != group[skeleton["root"]]:
            check.fail(("joints", place), f"no bones lead from the root '{skeleton['root']}' to joint '{joint}'.")


def _check_mirror(skeleton: dict[str, Any], check: _Checker) -> None:
    """Check that no joint is in two pairs and that no limb is paired half way only."""
    partner: dict[str, str] = {}
    for place, pair in enumerate(skeleton["mirror"]):
        for joint in pair:
            if joint in partner:
                what = f"found '{joint}' in a second mirror pair; it mirrors '{partner[joint]}' already."
                check.fail(("mirror", place), what)
        partner[pair[0]], partner[pair[1]] = pair[1], pair[0]
    ends: dict[str, list[str]] = {joint: [] for joint in skeleton["joints"]}
    for one, other in skeleton["bones"]:
        ends[one].append(other)
        ends[other].append(one)
    for place, (one, other) in enumerate(skeleton["mirror"]):
        lone = [[end for end in ends[joint] if end not in partner] for joint in (one, other)]
        ours, theirs = ([end for end in side if end not in across] for side, across in (lone, lone[::-1]))
        if ours and theirs and skeleton["root"] not in ours + theirs:
            check.fail(
                ("mirror", place),
                f"'{one}' and '{other}' mirror each other, but the joints that hang from them, "
                f"'{ours[0]}' and '{theirs[0]}', are in no pair. Add [{ours[0]}, {theirs[0]}] to mirror.",
            )


def _check_contacts(skeleton: dict[str, Any], check: _Checker) -> None:
    """Check that what stands on the ground are joints beyond the root, each named once, under gravity."""
    contacts = check.kind(skeleton["contacts"], list, "a list of joints that stand on the ground", ("contacts",))
    if contacts and not skeleton["gravity"]:
        check.fail(("contacts",), "found contacts, but gravity is false: nothing stands on a ground without it.")
    for place, joint in enumerate(contacts):
        check.joint(joint, skeleton["joints"], ("contacts", place))
        if joint in contacts[:place]:
            check.fail(("contacts", place), f"found '{joint}' twice in 'contacts'.")
        if joint == skeleton["root"]:
            check.fail(("contacts", place), f"found the root '{joint}' in 'contacts'; expected ends of limbs.")


def _check_size(size: Any, joints: list[str], check: _Checker) -> dict[str, Any]:
    check.kind(size, dict, "a mapping: along and mm, or along and of_height", ("size",))
    if not size:
        return {}
    for key in size:
        if key not in SIZE_KEYS:
            check.fail(("size", key), f"found the unknown key '{key}'.{did_you_mean(str(key), SIZE_KEYS)}")
    along = check.kind(size.get("along"), list, "a list of two or more joints", ("size", "along"))
    if len(along) < 2:
        check.fail(("size", "along"), f"found {len(along)} joint; expected two or more, from one end to the other.")
    for place, joint in enumerate(along):
        check.joint(joint, joints, ("size", "along", place))
        if place and joint == along[place - 1]:
            check.fail(("size", "along", place), f"found '{joint}' twice in a row.")
    given = [key for key in ("mm", "of_height") if key in size]
    if len(given) != 1:
        found = " and ".join(given) or "neither mm nor of_height"
        check.fail(("size",), f"found {found}; expected one of mm, of_height.")
    value = size[given[0]]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1e9:
        check.fail(("size", given[0]), f"found {value!r}; expected a positive number.")
    return {"along": list(along), given[0]: float(value)}


def _check_facing(skeleton: dict[str, Any], check: _Checker) -> dict[str, list[list[str]]]:
    """Return facing with each end a list of joints; raises UserError where it cannot tell left from right."""
    given = check.kind(skeleton["facing"], dict, "a mapping of front, left and up", ("facing",))
    for direction in given:
        if direction not in DIRECTIONS:
            hint = did_you_mean(direction, DIRECTIONS)
            check.fail(("facing", direction), f"found the unknown facing direction '{direction}'.{hint}")
    facing = {name: _ends(given[name], skeleton["joints"], ("facing", name), check) for name in given}
    if not facing:
        return {}
    needed = ("front", "left") if skeleton["gravity"] else DIRECTIONS
    for direction in needed:
        if direction not in facing:
            why = "" if skeleton["gravity"] else " (up is needed where gravity is false)"
            check.fail(("facing",), f"'{direction}' is missing; facing needs {' and '.join(needed)}{why}.")
    weights = {name: direction_weights(ends, skeleton["joints"]) for name, ends in facing.items()}
    _check_independent(weights, check)
    if skeleton["mirror"]:
        _check_sides(weights, skeleton, check)
    return facing


def _check_trunk(skeleton: dict[str, Any], check: _Checker) -> list[list[str]]:
    """Return the trunk with each end a list of joints, empty where it is not given."""
    if "trunk" not in skeleton:
        return []
    ends = _ends(skeleton["trunk"], skeleton["joints"], ("trunk",), check)
    if np.abs(direction_weights(ends, skeleton["joints"])).max() < 1e-9:
        check.fail(("trunk",), "found 'trunk' from and to the same place; it has no direction.")
    return ends


def _ends(value: object, joints: list[str], part: tuple, check: _Checker) -> list[list[str]]:
    ends = check.kind(value, list, "[from, to], each a joint or a list of joints", part)
    if len(ends) != 2:
        check.fail(part, f"found {len(ends)} ends in '{part[-1]}'; expected two, [from, to].")
    return [check.parts(end, (*part, place), joints) for place, end in enumerate(ends)]


def direction_weights(ends: Sequence[Sequence[str]], joints: Sequence[str]) -> Float[np.ndarray, " joints"]:
    """Return +1/n for the joints that a direction points to, -1/n for those it comes from."""
    weights = np.zeros(len(joints))
    for sign, end in zip((-1.0, 1.0), ends, strict=True):
        for joint in end:
            weights[joints.index(joint)] += sign / len(end)
    return weights


def mirror_places(joints: Sequence[str], pairs: Iterable[Sequence[str]]) -> Int[np.ndarray, " joints"]:
    """Return for each joint the index of its mirror partner; its own where it has none."""
    places = np.arange(len(joints))
    for one, other in pairs:
        places[[joints.index(one), joints.index(other)]] = joints.index(other), joints.index(one)
    return places


def _check_independent(weights: dict[str, np.ndarray], check: _Checker) -> None:
    for count, name in enumerate(weights, 1):
        part = ("facing", name)
        if np.abs(weights[name]).max() < 1e-9:
            check.fail(part, f"found '{name}' from and to the same place; it has no direction.")
        if np.linalg.matrix_rank(np.stack(list(weights.values())[:count]), tol=1e-9) < count:
            before = " and ".join(list(weights)[: count - 1])
            check.fail(part, f"found '{name}' along {before}, whatever the pose; expected directions that differ.")


def _check_sides(weights: dict[str, np.ndarray], skeleton: dict[str, Any], check: _Checker) -> None:
    """Check against the mirror pairs: left must cross the body, front and up must not only cross it."""
    places = mirror_places(skeleton["joints"], skeleton["mirror"])
    for name, direction in weights.items():
        mirrored = direction[places]
        if name == "left" and np.allclose(mirrored, direction):
            check.fail(
                ("facing", name),
                "'left' is the same on both sides of the body, so it cannot tell left from right; "
                "expected [a joint on the right, its mirror partner on the left].",
            )
        if name != "left" and np.allclose(mirrored, -direction):
            check.fail(
                ("facing", name),
                f"'{name}' runs from one side of the body to the other, as 'left' should; "
                "expected joints on the midline, or means of both sides.",
            )


# Angles: a segment, and what it is measured from or towards.

_FORMS = "expected joints: [a, b, c], or segment: [from, to] with from: or towards:."


def _check_angles(skeleton: dict[str, Any], check: _Checker) -> dict[str, dict[str, Any]]:
    """Return the angles with every direction the name of a level one, or a list of ends, each a list of joints."""
    given = check.kind(skeleton["angles"], dict, "a mapping of names to angles", ("angles",))
    return {name: _check_angle(name, given[name], skeleton, check) for name in given}


def _check_angle(name: object, value: object, skeleton: dict[str, Any], check: _Checker) -> dict[str, Any]:
    part = ("angles", name)
    check.text(name, part)
    angle = dict(check.kind(value, dict, "a mapping such as {joints: [hip, knee, ankle]}", part))
    for key in angle:
        if key not in ANGLE_KEYS:
            check.fail((*part, key), f"found the unknown key '{key}' in '{name}'.{did_you_mean(str(key), ANGLE_KEYS)}")
    if "joints" in angle:
        ends = check.kind(angle.pop("joints"), list, "three joints, [a, b, c]", (*part, "joints"))
        if len(ends) != 3:
            check.fail((*part, "joints"), f"found {len(ends)} joints in '{name}'; expected three, [a, b, c].")
        if other := [key for key in ("segment", "from", "towards") if key in angle]:
            check.fail((*part, other[0]), f"found joints and {other[0]} in '{name}'; {_FORMS}")
        angle |= {"segment": ends[1:], "from": ends[:2]}
    ways = [key for key in ("segment", "from", "about", "towards") if key in angle]
    if "segment" not in angle or not {"from", "towards"} & set(angle):
        check.fail(part, f"found {', '.join(ways) or 'no direction'} in '{name}'; {_FORMS}")
    if "about" in angle and ("towards" in angle or "from" not in angle):
        check.fail((*part, "about"), f"found about and towards in '{name}'; about goes with from.")
    zero = angle.get("zero", 0.0)
    check.number(zero, (*part, "zero"))
    return {key: _check_way(angle[key], skeleton, (*part, key), check) for key in ways} | {"zero": float(zero)}


def _check_way(value: object, skeleton: dict[str, Any], part: tuple, check: _Checker) -> str | list[list[str]]:
    """Return a direction of an angle: a name of `LEVEL`, or its two ends, or three of a plane that it is normal to."""
    if isinstance(value, str):
        if value not in LEVEL:
            hint = did_you_mean(value, LEVEL)
            check.fail(
                part, f"found the direction '{value}' in '{_path(part)}'; expected [from, to], or a level one.{hint}"
            )
        if not skeleton["gravity"]:
            check.fail(part, f"found '{value}' in '{_path(part)}', but gravity is false: there is no level frame.")
        return value
    ends = check.kind(value, list, "[from, to], each a joint or a list of joints", part)
    if len(ends) not in (2, 3):
        check.fail(part, f"found {len(ends)} ends in '{_path(part)}'; expected [from, to], or three of a plane.")
    found = [check.parts(end, (*part, place), skeleton["joints"]) for place, end in enumerate(ends)]
    if len({tuple(sorted(end)) for end in found}) < len(found):
        check.fail(part, f"found two ends at the same place in '{_path(part)}'; it has no direction.")
    return found


def _check_body(skeleton: dict[str, Any], check: _Checker) -> None:
    """Check the simulator's proportions (numbers > 0), rest (3-vectors, not zero) and limits (finite numbers)."""
    for key in BODY_KEYS:
        for joint, value in check.kind(skeleton.get(key, {}), dict, "a mapping keyed by joint", (key,)).items():
            part = (key, joint)
            check.joint(joint, skeleton["joints"], part)
            if key == "proportions":
                check.number(value, part)
                if value <= 0:
                    check.fail(part, f"found the length {value} for '{joint}'; expected a number above 0.")
            elif key == "rest":
                vector = check.kind(value, list, "a vector [x, y, z]", part)
                if len(vector) != 3:
                    check.fail(part, f"found {len(vector)} numbers for '{joint}'; expected a vector [x, y, z].")
                for place, number in enumerate(vector):
                    check.number(number, (*part, place))
                if not any(vector):
                    check.fail(part, f"found the vector {vector} for '{joint}'; expected one with a direction.")
            else:
                check.kind(value, (dict, list), "limits: a mapping or a list", part)
                _check_finite(value, part, check)


def _check_finite(value: object, part: tuple, check: _Checker) -> None:
    """Check every number inside nested lists and mappings; the simulator reads the texts."""
    if isinstance(value, (dict, list)):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            _check_finite(inner, (*part, key), check)
    elif not isinstance(value, str):
        check.number(value, part)


class _Checker:
    """Checks of single values; raises UserError that begins with the file and line of a part."""

    def __init__(self, where: Where) -> None:
        self.where = where

    def fail(self, part: tuple, problem: str) -> NoReturn:
        raise UserError(f"{self.where(part)}: {problem}")

    def kind(self, value: object, kind: type | tuple, expected: str, part: tuple) -> Any:
        if not isinstance(value, kind):
            self.fail(part, f"found {_named(value)} for '{_path(part)}'; expected {expected}.")
        return value

    def text(self, value: object, part: tuple, blank: bool = False) -> None:
        if isinstance(value, bool):
            self.fail(part, "found a word that YAML reads as true or false; write it in quotes.")
        text = self.kind(value, str, "text", part)
        if (not text and not blank) or text != text.strip() or not text.replace("\n", " ").isprintable():
            self.fail(part, f"found {text!r} for '{_path(part)}'; expected text with no blanks around it.")

    def number(self, value: object, part: tuple) -> None:
        if isinstance(value, bool):
            self.fail(part, f"found true or false in '{part[0]}'; expected a number.")
        number = self.kind(value, (int, float), "a number", part)
        if not math.isfinite(number) or abs(number) > 1e9:
            self.fail(part, f"found {value} in '{part[0]}'; expected a finite number.")

    def joint(self, joint: object, joints: Iterable[str], part: tuple) -> None:
        self.text(joint, part)
        if str(joint) not in joints:
            hint = did_you_mean(str(joint), joints)
            self.fail(part, f"found '{joint}' in '{_path(part)}', which is not a joint.{hint}")

    def pairs(self, pairs: object, joints: list[str], key: str, form: str) -> None:
        """Check a list of pairs of two different joints."""
        for place, pair in enumerate(self.kind(pairs, list, f"a list of pairs {form}", (key,))):
            part = (key, place)
            self.kind(pair, list, f"a pair {form}", part)
            if len(pair) != 2:
                self.fail(part, f"found {len(pair)} names {pair} in '{key}'; expected a pair {form}.")
            for end, joint in enumerate(pair):
                self.joint(joint, joints, (*part, end))
            if pair[0] == pair[1]:
                self.fail(part, f"found '{pair[0]}' paired with itself in '{key}'; expected two different joints.")

    def parts(self, parts: object, part: tuple, joints: Iterable[str] | None = None) -> list[str]:
        """Return one name or a list of different names (a mean) as a list; of ``joints`` where given."""
        names = [parts] if isinstance(parts, (str, bool)) else parts
        names = self.kind(names, list, "a joint, or a list of joints (their mean)", part)
        if not names:
            self.fail(part, f"found an empty list in '{_path(part)}'; expected a joint, or a list of joints.")
        for place, name in enumerate(names):
            self.text(name, (*part, place)) if joints is None else self.joint(name, joints, (*part, place))
            if name in names[:place]:
                self.fail((*part, place), f"found '{name}' twice in one mean in '{_path(part)}'.")
        return list(names)

    def map_of_parts(
        self, value: object, joints: list[str], part: tuple, midpoints: bool = False
    ) -> dict[str, list[str]]:
        """Return a mapping of our joints to lists of parts; those of ``midpoints`` are joints of ours too."""
        given = self.kind(value, dict, "a mapping of joint: name, or joint: [name, name]", part)
        found: dict[str, list[str]] = {}
        for joint, parts in given.items():
            self.joint(joint, joints, (*part, joint))
            found[joint] = self.parts(parts, (*part, joint), joints if midpoints else None)
            for name in found[joint] if midpoints else ():
                if name in given:
                    self.fail((*part, joint), f"found midpoint '{joint}' made of '{name}', itself a midpoint.")
        if not found and not midpoints:
            self.fail(part, f"found nothing in '{_path(part)}'; expected joint: name.")
        return found


def _path(part: tuple) -> str:
    return ".".join(str(step) for step in part if not isinstance(step, int)) or "skeleton"


def _named(value: object) -> str:
    for kind, name in ((bool, "true or false"), (dict, "a mapping"), (list, "a list"), (type(None), "nothing")):
        if isinstance(value, kind):
            return name
    shown = str(value)
    shown = shown if len(shown) <= 40 else shown[:37] + "..."
    return f"the number {shown}" if isinstance(value, (int, float)) else f"the text '{shown}'"
