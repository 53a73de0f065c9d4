"""What the readers of JSON share: files of a folder, entries one at a time, and lists of numbers as one array."""

from __future__ import annotations

import heapq
import os
import re
import reprlib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from uplift.datasets.coco_json import JsonText
from uplift.errors import UserError
from uplift.readers.base import Peek

__all__ = [
    "Numbers",
    "entries",
    "first_json",
    "in_order",
    "is_text",
    "items",
    "json_files",
    "load_json",
    "members",
    "shown",
    "whole",
]

_BLOCK = 4096
_KINDS = {int, float, type(None)}
_TRIES = 100


def json_files(path: Path) -> list[Path]:
    """Return a file itself, or the JSON files of a folder with their numbers in order.

    Raises:
        UserError: none in the folder.
    """
    if not path.is_dir():
        return [path]
    found = [Path(one) for one in os.scandir(path) if _is_json(one.name) and one.is_file()]
    if not found:
        raise UserError(f"{path} has no *.json in it.")
    return sorted(found, key=lambda one: in_order(one.name))


def first_json(peek: Peek) -> Peek | None:
    """Return the first look at a JSON file, or at the first one of a folder that is no empty list.

    Never an exception; None where there is no JSON.
    """
    if not peek.is_folder:
        return peek if peek.json_sign else None
    try:
        names = heapq.nsmallest(_TRIES, (one.name for one in os.scandir(peek.path) if _is_json(one.name)))
    except OSError:
        return None
    found = None
    for name in names:
        try:
            found = Peek(peek.path / name)
        except (UserError, OSError):
            continue
        if found.json_sign and not re.match(r"\s*[\[{]\s*[\]}]\s*$", found.text):
            return found
    return found if found is not None and found.json_sign else None


def _is_json(name: str) -> bool:
    return name.lower().endswith(".json") and not name.startswith(".")


def load_json(path: Path) -> Any:
    """Return the one value of a JSON file.

    Raises:
        UserError: damaged, or more than one value.
    """
    text = JsonText(path)
    value = text.value()
    _end(text)
    return value


def members(path: Path) -> Iterator[tuple[str, JsonText]]:
    """Yield each key of a file's object, with the text standing before its value, which the caller passes.

    Raises:
        UserError: damaged, or no object.
    """
    text = JsonText(path)
    if text.next_sign() != "{":
        raise UserError(f"{path} begins {text.text[text.at : text.at + 20]!r}, expected an object: {{ ... }}.")
    for key in text.members():
        yield key, text
    _end(text)


def entries(path: Path, what: str) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the number and object of each entry of a file's list; ``what`` names the list in errors.

    Raises:
        UserError: damaged, no list, or an entry that is no object.
    """
    text = JsonText(path)
    yield from enumerate(text.records(what))
    _end(text)


def items(text: JsonText, what: str) -> Iterator[Any]:
    """Yield each value of the list that stands next in a text, one at a time, and pass it.

    Raises:
        UserError: damaged, or no list.
    """
    if text.next_sign() != "[":
        raise UserError(f"{text.path}: {what} is no list.")
    text.at += 1
    more = text.next_sign() != "]"
    while more:
        yield text.value()
        more = text.next_sign() == ","
        if not more and text.next_sign() != "]":
            raise UserError(f"{text.path} is no whole JSON file: damaged or cut short at character {text.at:,}.")
        text.at += more
    text.at += 1
    if text.text[:1000].lstrip().startswith("["):
        _end(text)


def _end(text: JsonText) -> None:
    if text.next_sign():
        raise UserError(
            f"{text.path} is no whole JSON file: it ends at character {text.at:,}, and more follows: "
            f"{text.text[text.at : text.at + 40]!r}."
        )


def is_text(value: Any) -> bool:
    """Return whether a value of JSON names something: text that is not empty."""
    return isinstance(value, str) and bool(value)


def shown(value: Any) -> str:
    """Return a value of JSON for an error, short however large or deep it is."""
    return f"{reprlib.repr(value):.80}"


def whole(value: Any, where: str, what: str) -> int:
    """Return ``value`` as an integer from 0 up; raises UserError for anything else."""
    number = value
    if isinstance(value, str) and re.fullmatch(r"[0-9]{1,15}", value):
        number = int(value)
    if isinstance(value, float) and value.is_integer():
        number = int(value)
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**53:
        raise UserError(f"{where}: '{what}' is {shown(value)}, expected a whole number from 0 up.")
    return number


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
            UserError: no list of numbers, or not as long as the rows before it.
        """
        flat = self.flat(values, where)
        if len(flat) != self.width:
            if self.width is not None:
                raise UserError(
                    f"{where}: '{self.what}' has {len(flat)} numbers, but {self.width} in {self._first}. "
                    "Expected the same keypoints everywhere."
                )
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
        if type(flat) is not list or not _KINDS.issuperset(map(type, flat)):
            raise UserError(f"{where}: '{self.what}' is {shown(values)}, expected a list of numbers.")
        return flat

    def _flush(self) -> None:
        width = self.width or 0
        try:
            block = np.array(self._waiting, np.float64)
        except OverflowError:
            wrong = next(n for n, value in enumerate(self._waiting) if _too_large(value))
            where = self._places[wrong // max(width, 1)]
            raise UserError(f"{where}: '{self.what}' holds a number of more digits than any pixel has.") from None
        with np.errstate(over="ignore"):
            self._blocks.append(block.reshape(len(self._places), width).astype(np.float32))
        self._waiting, self._places = [], []

    def array(self, *shape: int) -> np.ndarray:
        """Return all rows, (rows, *shape); with no shape (rows, numbers)."""
        self._flush()
        self._blocks = [np.concatenate(self._blocks)]
        return self._blocks[0].reshape(self.rows, *(shape or (self.width or 0,)))


def _too_large(value: Any) -> bool:
    try:
        float(value or 0)
    except OverflowError:
        return True
    return False


def in_order(name: str) -> list[tuple[int, int, str]]:
    """Return what sorts file names so that 2 comes before 10."""
    parts = re.split(r"([0-9]+)", name)
    return [
        (0, int(part[:300]), part) if part.isdecimal() and part.isascii() else (1, 0, part) for part in parts if part
    ]
