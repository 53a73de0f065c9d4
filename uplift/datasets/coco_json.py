"""Read a large JSON file of records one at a time: its text is in memory, never all of its objects."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from uplift.errors import UserError

__all__ = ["JsonText", "records"]

_SPACE = re.compile(r"[ \t\n\r]*")
_DECODER = json.JSONDecoder()


def records(path: Path, keys: Collection[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (key, record) of the lists that the file's object holds under ``keys``, in the order of the file.

    Raises:
        UserError: damaged JSON, a list in place of the object, a record that is none, a key that is absent.
    """
    text = JsonText(path)
    if text.next_sign() == "[":
        raise UserError(
            f"{path} is a list: results of a detector, which are another format. Expected annotations, such as "
            f"person_keypoints_val2017.json: an object with {', '.join(keys)}."
        )
    found = set()
    for key in text.members():
        if key not in keys:
            text.value()
            continue
        found.add(key)
        for record in text.records(f"'{key}'"):
            yield key, record
    absent = ", ".join(key for key in keys if key not in found)
    if absent:
        raise UserError(f"{path}: no {absent} in it. Expected annotations, such as person_keypoints_val2017.json.")


class JsonText:
    """The text of a JSON file and how far it has been read.

    Raises:
        UserError: (as every method does) no such file, no JSON, or damaged.
    """

    def __init__(self, path: Path):
        self.path = path
        self.at = 0
        try:
            self.text = path.read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            raise UserError(f"{path} cannot be read as JSON: {error}") from None
        if not self.next_sign():
            raise UserError(f"{path} is empty, expected JSON.")

    def next_sign(self) -> str:
        """Return the next character that is no space, without passing it; nothing at the end."""
        space = _SPACE.match(self.text, self.at)
        self.at = space.end() if space else self.at
        return self.text[self.at : self.at + 1]

    def value(self) -> Any:
        """Return the next value and pass it."""
        self.next_sign()
        try:
            found, self.at = _DECODER.raw_decode(self.text, self.at)
        except (ValueError, RecursionError):
            raise self._damaged() from None
        return found

    def members(self) -> Iterator[str]:
        """Yield each key of an object; the caller passes its value before it asks for the next."""
        self._pass("{")
        more = self.next_sign() != "}"
        while more:
            key = self.value()
            self._pass(":")
            yield key
            more = self._more("}")
        self._pass("}")

    def records(self, what: str) -> Iterator[dict[str, Any]]:
        """Yield each entry of a list of objects; ``what`` names the list in errors."""
        if self.next_sign() != "[":
            raise UserError(f"{self.path}: {what} is no list.")
        self._pass("[")
        more, count = self.next_sign() != "]", 0
        while more:
            found = self.value()
            if not isinstance(found, dict):
                raise UserError(f"{self.path}: entry {count} of {what} is {found!r:.60}, expected an object.")
            yield found
            more, count = self._more("]"), count + 1
        self._pass("]")

    def _more(self, end: str) -> bool:
        if self.next_sign() == ",":
            self.at += 1
            return True
        if self.next_sign() != end:
            raise self._damaged()
        return False

    def _pass(self, sign: str) -> None:
        if self.next_sign() != sign:
            raise self._damaged()
        self.at += 1

    def _damaged(self) -> UserError:
        near = self.text[self.at : self.at + 40]
        shown = f"near {near!r}" if near else "where the file ends: truncated?"
        return UserError(f"{self.path} is no whole JSON file: damaged at character {self.at:,}, {shown}.")
