"""Read untrusted JSON: records one at a time, the files of a folder, lists of numbers."""

from __future__ import annotations

import json
import os
import re
import reprlib
import sys
from collections.abc import Collection, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.parsers.files import encoding_of, read_bytes
from uplift.errors import UserError

__all__ = [
    "JSON_LINES", "JsonText", "Numbers", "entries", "in_order", "is_json", "is_text", "items", "json_files", "load_json", "members",
    "objects", "records", "shown", "texts", "whole_number",
]  # fmt: skip

# Large files of records: the text is in memory, never all of its objects.

JSON_LINES = "JSON lines hold one value a line: make one list of them (`jq -s . LINES.jsonl > LIST.json`)."
"""What to do with a file of several values."""
_SPACE = re.compile(r"[ \t\n\r]*")
_SCAN = json.JSONDecoder().raw_decode


def records(path: Path, keys: Collection[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (key, record) of the lists that the file's object holds under ``keys``, in the order of the file.

    Raises:
        UserError: damaged JSON, a list in place of the object, a record that is not an object, a key that is absent.
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
        for record in objects(text, f"'{key}'"):
            yield key, record
    absent = ", ".join(key for key in keys if key not in found)
    if absent:
        raise UserError(f"{path}: no {absent} in it. Expected annotations, such as person_keypoints_val2017.json.")


class JsonText:
    """The text of a JSON file and how far it has been read.

    Raises:
        UserError: (as every method does) no such file, not JSON, or damaged.
    """

    def __init__(self, path: Path):
        self.path = path
        self.at = 0
        try:
            content = read_bytes(path)
            self.text = content.decode(encoding_of(content[:4]))
        except UnicodeDecodeError as error:
            raise UserError(f"{path} cannot be read as JSON: {error}") from None
        if not self.next_sign():
            raise UserError(f"{path} is empty, expected JSON.")
        self.start = self.at

    def next_sign(self) -> str:
        """Return the next character that is not a space, without passing it; nothing at the end."""
        space = _SPACE.match(self.text, self.at)
        self.at = space.end() if space else self.at
        return self.text[self.at : self.at + 1]

    def value(self) -> Any:
        """Return the next value and pass it."""
        self.next_sign()
        try:
            found, self.at = _SCAN(self.text, self.at)
        except (ValueError, RecursionError):
            raise self.damaged() from None
        return found

    def members(self) -> Iterator[str]:
        """Yield each key of an object; the caller passes its value before it asks for the next."""
        self._pass("{")
        more = self.next_sign() != "}"
        while more:
            key = self.value()
            self._pass(":")
            yield key
            more = self.next_sign() == ","
            self.at += more
        self._pass("}")

    def end(self) -> None:
        """Raise UserError where anything follows."""
        if self.next_sign():
            near = self.text[self.at : self.at + 40]
            several = f" {JSON_LINES}" if near[0] in "{[" else ""
            raise UserError(
                f"{self.path} is not a complete JSON file: it ends at character {self.at:,}, and more follows: "
                f"{near!r}.{several}"
            )

    def _pass(self, sign: str) -> None:
        if self.next_sign() != sign:
            raise self.damaged()
        self.at += 1

    def damaged(self) -> UserError:
        """Return the error for text that is not JSON."""
        near = self.text[self.at : self.at + 40]
        shown = f"near {near!r}" if near else "where the file ends: truncated?"
        return UserError(f"{self.path} is not a complete JSON file: damaged at character {self.at:,}, {shown}.")


def json_files(path: Path) -> list[Path]:
    """Return a file itself, or the JSON files of a folder with their numbers in order.

    Raises:
        UserError: none in the folder.
    """
    if not path.is_dir():
        return [path]
    found = [Path(one) for one in os.scandir(path) if is_json(one.name) and one.is_file()]
    if not found:
        raise UserError(f"{path} has no *.json in it.")
    return sorted(found, key=lambda one: in_order(one.name))


def is_json(name: str) -> bool:
    """Return whether a file's name is that of JSON."""
    return name.lower().endswith(".json") and not name.startswith(".")


def load_json(path: Path) -> Any:
    """Return the one value of a JSON file.

    Raises:
        UserError: damaged, or more than one value.
    """
    text = JsonText(path)
    value = text.value()
    text.end()
    return value


def members(path: Path) -> Iterator[tuple[str, JsonText]]:
    """Yield each key of a file's object, with the text placed before its value, which the caller passes.

    Raises:
        UserError: damaged, or not an object.
    """
    text = JsonText(path)
    if text.next_sign() != "{":
        raise UserError(f"{path} begins {text.text[text.at : text.at + 20]!r}, expected an object: {{ ... }}.")
    for key in text.members():
        yield key, text
    text.end()


def entries(path: Path, what: str) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the number and object of each entry of a file's list; ``what`` names the list in errors.

    Raises:
        UserError: damaged, not a list, or an entry that is not an object.
    """
    return enumerate(objects(JsonText(path), what))


def objects(text: JsonText, what: str) -> Iterator[dict[str, Any]]:
    """Yield each object of the list that comes next in a text, one at a time.

    Raises:
        UserError: damaged, not a list, or an entry that is not an object.
    """
    for count, value in enumerate(items(text, what)):
        if type(value) is not dict:
            raise UserError(f"{text.path}: entry {count} of {what} is {shown(value)}, expected an object.")
        yield value


def items(text: JsonText, what: str) -> Iterator[Any]:
    """Yield each value of the list that comes next in a text, one at a time, and pass it.

    Raises:
        UserError: damaged, or not a list.
    """
    if text.next_sign() != "[":
        raise UserError(f"{text.path}: {what} is not a list.")
    outermost = text.at == text.start
    text.at += 1
    more = text.next_sign() != "]"
    content = text.text
    while more:
        try:
            value, text.at = _SCAN(content, text.at)
        except (ValueError, RecursionError):
            value = text.value()  # after spaces, or raises the error
        yield value
        if content.startswith(", ", text.at):  # as most write it
            text.at += 2
            continue
        more = text.next_sign() == ","
        if not more and text.next_sign() != "]":
            raise text.damaged()
        text.at += more
    text.at += 1
    if outermost:
        text.end()


def is_text(value: Any) -> bool:
    """Return whether a value of JSON names something: text that is not empty."""
    return isinstance(value, str) and bool(value)


def shown(value: Any) -> str:
    """Return a value of JSON for an error, short however large or deep it is."""
    return f"{reprlib.repr(value):.80}"


def whole_number(value: Any, where: str, what: str) -> int:
    """Return ``value`` as an integer from 0 up; raises UserError for anything else."""
    number = value
    if isinstance(value, str) and re.fullmatch(r"[0-9]{1,15}", value):
        number = int(value)
    if isinstance(value, float) and value.is_integer():
        number = int(value)
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**53:
        raise UserError(f"{where}: '{what}' is {shown(value)}, expected a whole number from 0 up.")
    return number


def in_order(name: str) -> list[tuple[int, int, str]]:
    """Return what sorts file names so that 2 comes before 10."""
    parts = filter(None, re.split(r"([0-9]+)", name))
    return [(0, int(part[:300]), part) if "0" <= part[0] <= "9" else (1, 0, part) for part in parts]


_LONGEST = 4000
_MOST = 500_000_000


def texts(path: Path, values: Sequence[str]) -> np.ndarray:
    """Return names of rows as an array of text, in which every name takes the space of the longest.

    Raises:
        UserError: a name so long that the array would not fit in memory.
    """
    longest = max(map(len, values), default=0)
    if longest > _LONGEST or longest * len(values) > _MOST:
        name = next(value for value in values if len(value) == longest)
        raise UserError(f"{path} has a name of {longest:,} characters ({name[:40]!r}...), expected short ones.")
    return np.array(values) if len(values) else np.empty(0, "U1")


_BLOCK = 4096
_KINDS = {int, float, type(None)}
_LARGEST = sys.float_info.max


class Numbers:
    """Lists of numbers, one a row and all of one length, that become one float32 array.

    ``what`` names them in errors. Lists may hold lists, which are taken one after the other.
    """

    def __init__(self, what: str):
        self.what = what
        self.rows = 0
        self.width: int | None = None
        self._first = ""
        self._waiting: list[Any] = []
        self._places: list[str] = []
        self._blocks: list[np.ndarray] = []

    def add(self, values: Any, where: str) -> None:
        """Take the next row; ``where`` names it in errors.

        Raises:
            UserError: not a list of numbers, or not as long as the rows before it.
        """
        flat = self.flat(values, where)
        if len(flat) != self.width:
            if self.width is not None:
                found = f"{len(flat)} numbers, but {self.width} in {self._first}"
                raise UserError(f"{where}: '{self.what}' has {found}. Expected the same keypoints everywhere.")
            self.width, self._first = len(flat), where
        self._waiting.extend(flat)
        self._places.append(where)
        self.rows += 1
        if len(self._places) >= _BLOCK:
            self._flush()

    def flat(self, values: Any, where: str) -> list[Any]:
        """Return numbers, or lists of them, as one list; raises UserError for anything else."""
        flat = values
        if type(values) is list and values and type(values[0]) is list:
            parts = set(map(type, values)) == {list} and len(set(map(len, values))) == 1
            flat = list(chain.from_iterable(values)) if parts else None
        if type(flat) is not list or not set(map(type, flat)) <= _KINDS:
            raise UserError(f"{where}: '{self.what}' is {shown(values)}, expected a list of numbers.")
        return flat

    def _flush(self) -> None:
        width = self.width or 0
        try:
            block = np.array(self._waiting, np.float64)
        except OverflowError:
            wrong = next(n for n, value in enumerate(self._waiting) if value is not None and abs(value) > _LARGEST)
            where = self._places[wrong // max(width, 1)]
            raise UserError(f"{where}: '{self.what}' holds a number with more digits than a pixel has.") from None
        with np.errstate(over="ignore"):
            self._blocks.append(block.reshape(len(self._places), width).astype(np.float32))
        self._waiting, self._places = [], []

    def array(self, *shape: int) -> np.ndarray:
        """Return all rows, (rows, *shape); with no shape (rows, numbers)."""
        self._flush()
        self._blocks = [np.concatenate(self._blocks)]
        return self._blocks[0].reshape(self.rows, *(shape or (self.width or 0,)))

    def triples(self, path: Path) -> np.ndarray:
        """Return (rows, keypoints, 3); raises UserError where the lists are not x, y, score of each keypoint."""
        if not self.width or self.width % 3:
            raise UserError(f"{path} has {self.width} numbers in '{self.what}', expected x, y, score of each keypoint.")
        return self.array(self.width // 3, 3)

    def pairs(self, scores: Numbers, path: Path) -> tuple[np.ndarray, np.ndarray]:
        """Return (rows, keypoints, 2) and (rows, keypoints) ``scores``; raises UserError for other numbers of them."""
        count = scores.width or 0
        if self.width != 2 * count:
            found = f"'{self.what}' has {self.width} numbers and '{scores.what}' {count}"
            raise UserError(f"{path}: {found}, expected x, y for each.")
        return self.array(count, 2), scores.array()
