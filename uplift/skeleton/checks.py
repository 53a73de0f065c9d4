"""Check the plain data of a skeleton: names, bones, mirror pairs and the maps out of other layouts."""

from __future__ import annotations

from typing import Any

from uplift.errors import UserError, did_you_mean
from uplift.skeleton.body_checks import BODY_KEYS, check_body
from uplift.skeleton.checker import Checker, named
from uplift.skeleton.facing_checks import check_facing
from uplift.skeleton.size_checks import check_size
from uplift.yaml_file import Where

__all__ = ["BODY_KEYS", "check_skeleton"]

_REQUIRED = ("joints", "root", "bones")
_DEFAULTS: dict[str, Any] = {
    "description": "", "loops": False, "mirror": [], "facing": {}, "gravity": True, "rigid": False,
    "midpoints": {}, "from": {}, "size": {},
}  # fmt: skip
_KEYS = ("name", *_REQUIRED, *_DEFAULTS, *BODY_KEYS)


def check_skeleton(data: object, where: Where) -> dict[str, Any]:
    """Return the data with defaults filled in and single joints made lists.

    Raises UserError at the first fault, its message begun by ``where`` (file and line).
    """
    skeleton = _check_keys(data, where)
    check = Checker(where)
    for key in ("name", "description"):
        check.is_text(skeleton[key], (key,), blank=key == "description")
    for key in ("gravity", "rigid", "loops"):
        check.is_switch(skeleton[key], (key,))
    joints = skeleton["joints"]
    check.joints(joints)
    check.is_joint(skeleton["root"], joints, ("root",))
    check.pairs(skeleton["bones"], joints, "bones", "[parent, child]")
    _check_forest(skeleton, check)
    check.pairs(skeleton["mirror"], joints, "mirror", "[right, left]")
    _check_mirror(skeleton, check)
    skeleton["midpoints"] = check.map_of_parts(skeleton["midpoints"], joints, ("midpoints",), own=True)
    check.is_kind(skeleton["from"], dict, "a mapping of layouts", ("from",))
    skeleton["from"] = {
        layout: check.map_of_parts(parts, joints, ("from", layout)) for layout, parts in skeleton["from"].items()
    }
    skeleton["size"] = check_size(skeleton["size"], joints, check)
    skeleton["facing"] = check_facing(skeleton, check)
    check_body(skeleton, check)
    return skeleton


def _check_keys(data: object, where: Where) -> dict[str, Any]:
    if not isinstance(data, dict):
        found = named(data)
        raise UserError(f"{where(())}: found {found}; expected a skeleton, a mapping with joints, root and bones.")
    for key in data:
        if key not in _KEYS:
            raise UserError(f"{where((key,))}: found the unknown key '{key}'.{did_you_mean(key, _KEYS)}")
    for key in _REQUIRED:
        if key not in data:
            raise UserError(f"{where(())}: '{key}' is missing; a skeleton needs {', '.join(_REQUIRED)}.")
    return {"name": "skeleton"} | {key: _empty(value) for key, value in _DEFAULTS.items()} | data


def _empty(value: Any) -> Any:
    return type(value)() if isinstance(value, (list, dict)) else value


def _check_forest(skeleton: dict[str, Any], check: Checker) -> None:
    """Check that bones hold all joints together, each bone once, and close loops only where that is meant."""
    joints, bones = skeleton["joints"], skeleton["bones"]
    group = {joint: joint for joint in joints}

    def find(joint: str) -> str:
        while group[joint] != joint:
            group[joint] = joint = group[group[joint]]
        return joint

    seen: dict[frozenset, int] = {}
    for place, (one, other) in enumerate(bones):
        if frozenset((one, other)) in seen:
            check.fail(("bones", place), f"found the bone between '{one}' and '{other}' twice.")
        seen[frozenset((one, other))] = place
        if find(one) == find(other) and not skeleton["loops"]:
            check.fail(
                ("bones", place),
                f"found a cycle: the bone [{one}, {other}] joins joints that bones join already. "
                "Take one bone of the cycle out, or, if the thing closes on itself (a chair's seat), "
                "write loops: true.",
            )
        group[find(one)] = find(other)
    for place, joint in enumerate(joints):
        if find(joint) != find(skeleton["root"]):
            check.fail(("joints", place), f"no bones lead from the root '{skeleton['root']}' to joint '{joint}'.")


def _check_mirror(skeleton: dict[str, Any], check: Checker) -> None:
    """Check that no joint is in two pairs and that no limb is paired half way only."""
    partner: dict[str, str] = {}
    for place, pair in enumerate(skeleton["mirror"]):
        for joint in pair:
            if joint in partner:
                check.fail(
                    ("mirror", place),
                    f"found '{joint}' in a second mirror pair; it mirrors '{partner[joint]}' already.",
                )
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
