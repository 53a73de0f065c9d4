"""Checks of single parts of a skeleton file, each failing with where the part stands."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NoReturn

from uplift.errors import UserError, did_you_mean
from uplift.yaml_file import Where

__all__ = ["Checker", "named"]

MAX_JOINTS = 1000


class Checker:
    """Checks of single parts; each raises UserError that begins with where the part stands."""

    def __init__(self, where: Where) -> None:
        self.where = where

    def fail(self, part: tuple, problem: str) -> NoReturn:
        raise UserError(f"{self.where(part)}: {problem}")

    def is_kind(self, value: object, kind: type | tuple, expected: str, part: tuple) -> None:
        if not isinstance(value, kind):
            self.fail(part, f"found {named(value)} for '{_path(part)}'; expected {expected}.")

    def is_text(self, value: object, part: tuple, blank: bool = False) -> None:
        if isinstance(value, bool):
            self.fail(part, "found a word that YAML reads as true or false; write it in quotes.")
        self.is_kind(value, str, "text", part)
        text = str(value)
        if (not text and not blank) or text != text.strip() or not text.replace("\n", " ").isprintable():
            self.fail(part, f"found {text!r} for '{_path(part)}'; expected text with no blanks around it.")

    def is_switch(self, value: object, part: tuple) -> None:
        self.is_kind(value, bool, "true or false", part)

    def joints(self, joints: object) -> None:
        self.is_kind(joints, list, "a list of joint names", ("joints",))
        assert isinstance(joints, list)
        if not 3 <= len(joints) <= MAX_JOINTS:
            self.fail(("joints",), f"found {len(joints)} joints; expected 3 to {MAX_JOINTS}.")
        first: dict[str, int] = {}
        for place, joint in enumerate(joints):
            self.is_text(joint, ("joints", place))
            if joint in first:
                self.fail(("joints", place), f"found joint '{joint}' twice; every joint has a name of its own.")
            first[joint] = place

    def is_joint(self, joint: object, joints: Iterable[str], part: tuple) -> None:
        self.is_text(joint, part)
        if str(joint) not in joints:
            self.fail(
                part,
                f"found '{joint}' in '{_path(part)}', which is no joint.{did_you_mean(str(joint), joints)}",
            )

    def pairs(self, pairs: object, joints: list[str], key: str, form: str) -> None:
        """Check a list of pairs of two different joints."""
        self.is_kind(pairs, list, f"a list of pairs {form}", (key,))
        assert isinstance(pairs, list)
        for place, pair in enumerate(pairs):
            part = (key, place)
            self.is_kind(pair, list, f"a pair {form}", part)
            if len(pair) != 2:
                self.fail(part, f"found {len(pair)} names {pair} in '{key}'; expected a pair {form}.")
            for end, joint in enumerate(pair):
                self.is_joint(joint, joints, (*part, end))
            if pair[0] == pair[1]:
                self.fail(part, f"found '{pair[0]}' paired with itself in '{key}'; expected two different joints.")

    def parts(self, parts: object, part: tuple, joints: Iterable[str] | None = None) -> list[str]:
        """Return one name or a list of different names (a mean) as a list; of ``joints`` where given."""
        if isinstance(parts, (str, bool)):
            parts = [parts]
        self.is_kind(parts, list, "a joint, or a list of joints (their mean)", part)
        assert isinstance(parts, list)
        if not parts:
            self.fail(part, f"found an empty list in '{_path(part)}'; expected a joint, or a list of joints.")
        for place, name in enumerate(parts):
            if joints is None:
                self.is_text(name, (*part, place))
            else:
                self.is_joint(name, joints, (*part, place))
            if name in parts[:place]:
                self.fail((*part, place), f"found '{name}' twice in one mean in '{_path(part)}'.")
        return [str(name) for name in parts]

    def map_of_parts(self, value: object, joints: list[str], part: tuple, own: bool = False) -> dict[str, list[str]]:
        """Return a mapping of our joints to lists of parts; with ``own`` the parts are joints of ours too."""
        self.is_kind(value, dict, "a mapping of joint: name, or joint: [name, name]", part)
        assert isinstance(value, dict)
        found: dict[str, list[str]] = {}
        for joint, parts in value.items():
            self.is_joint(joint, joints, (*part, joint))
            found[joint] = self.parts(parts, (*part, joint), joints if own else None)
            for name in found[joint] if own else ():
                if name in value:
                    self.fail((*part, joint), f"found midpoint '{joint}' made of '{name}', itself a midpoint.")
        if not found and not own:
            self.fail(part, f"found nothing in '{_path(part)}'; expected joint: name.")
        return found


def _path(part: tuple) -> str:
    return ".".join(str(step) for step in part if not isinstance(step, int)) or "skeleton"


def named(value: object) -> str:
    """Return a value as a user would name it."""
    kinds = {bool: "true or false", dict: "a mapping", list: "a list", type(None): "nothing"}
    for kind, name in kinds.items():
        if isinstance(value, kind):
            return name
    shown = str(value)
    shown = shown if len(shown) <= 40 else shown[:37] + "..."
    return f"the number {shown}" if isinstance(value, (int, float)) else f"the text '{shown}'"
