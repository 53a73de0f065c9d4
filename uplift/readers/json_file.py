"""What the readers of JSON share: the files of a folder, and their entries one at a time."""

from __future__ import annotations

import heapq
import json
import os
import re
import reprlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from uplift.datasets.coco_json import JsonText
from uplift.errors import UserError
from uplift.readers.base import Peek

__all__ = [
    "entries",
    "first_json",
    "in_order",
    "is_text",
    "items",
    "json_files",
    "load_json",
    "members",
    "objects",
    "shown",
    "whole",
]

_TRIES = 100
_SCAN = json.JSONDecoder().raw_decode


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
    yield from enumerate(objects(text, what))


def objects(text: JsonText, what: str) -> Iterator[dict[str, Any]]:
    """Yield each object of the list that stands next in a text, as `JsonText.records` does, in less time.

    Raises:
        UserError: damaged, no list, or an entry that is no object.
    """
    for count, value in enumerate(items(text, what)):
        if type(value) is not dict:
            raise UserError(f"{text.path}: entry {count} of {what} is {shown(value)}, expected an object.")
        yield value


def items(text: JsonText, what: str) -> Iterator[Any]:
    """Yield each value of the list that stands next in a text, one at a time, and pass it.

    Raises:
        UserError: damaged, or no list.
    """
    outermost = text.next_sign() == "[" and text.at < 1000 and not text.text[: text.at].strip()
    if text.next_sign() != "[":
        raise UserError(f"{text.path}: {what} is no list.")
    text.at += 1
    more = text.next_sign() != "]"
    whole_text = text.text
    while more:
        try:
            value, text.at = _SCAN(whole_text, text.at)
        except (ValueError, RecursionError):
            value = text.value()  # after spaces; or tells what is wrong
        yield value
        if whole_text.startswith(", ", text.at):  # as most write it
            text.at += 2
            continue
        more = text.next_sign() == ","
        if not more and text.next_sign() != "]":
            raise UserError(f"{text.path} is no whole JSON file: damaged or cut short at character {text.at:,}.")
        text.at += more
    text.at += 1
    if outermost:
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


def in_order(name: str) -> list[tuple[int, int, str]]:
    """Return what sorts file names so that 2 comes before 10."""
    parts = re.split(r"([0-9]+)", name)
    return [
        (0, int(part[:300]), part) if part.isdecimal() and part.isascii() else (1, 0, part) for part in parts if part
    ]
