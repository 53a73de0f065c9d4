"""Settings with several values, from lists and ranges on the command line, and the grid of fits that they span."""

from __future__ import annotations

import itertools
import math
import re
import typing
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from uplift.config.loading import type_of
from uplift.errors import UserError

__all__ = ["Axis", "Cell", "cells_of", "split_grid"]


class Axis(NamedTuple):
    """A setting that several values were given for."""

    key: str
    """The full name of the setting."""
    values: tuple[str, ...]
    """As each is written after ``key=``."""


class Cell(NamedTuple):
    """One fit of a grid."""

    name: str
    """Of its folder: its number in the grid and its values, such as ``03_units=128_seed=1``."""
    values: dict[str, str]
    """The value of each setting that varies, by its full name."""

    @property
    def words(self) -> list[str]:
        """The settings that vary as ``key=value`` words."""
        return [f"{key}={value}" for key, value in self.values.items()]


def cells_of(axes: Sequence[Axis]) -> list[Cell]:
    """Return the fits of the grid of all values; those of the last setting follow one another."""
    grid = list(itertools.product(*(axis.values for axis in axes)))
    wide, short = len(str(len(grid) - 1)), _short_names([axis.key for axis in axes])
    cells = []
    for number, values in enumerate(grid):
        parts = (f"{key}={_in_a_name(value)}" for key, value in zip(short, values, strict=True))
        keys = (axis.key for axis in axes)
        cells.append(Cell(f"{number:0{wide}}_{'_'.join(parts)}"[:_LONGEST], dict(zip(keys, values, strict=True))))
    return cells


_LONGEST = 100


def _short_names(keys: Sequence[str]) -> list[str]:
    """Return the last parts of names, or all of them where two would be the same."""
    last = [key.rpartition(".")[2] for key in keys]
    return [one if last.count(one) == 1 else key for one, key in zip(last, keys, strict=True)]


def _in_a_name(value: str) -> str:
    """Return a value as it can be in the name of a folder: the last part of a path, without special characters."""
    return re.sub(r"[^\w.,+-]+", "-", value.strip("[]\"'").rstrip("/").rpartition("/")[2]).strip("-") or "none"


# Which words have several values.

_NOT_VARIED = ("task", "resume", "trust", "lifts", "description", "data.get")
"""Words whose commas are their own, and what all fits of a sweep share."""
_TAKE_COMMAS = (
    "data.train", "data.val", "data.test", "data.category", "data.focal_px", "trainer.logger", "trainer.devices",
)  # fmt: skip
"""Texts that may name several things with commas: one value, as lists are."""


def split_grid(words: Iterable[str]) -> tuple[list[str], list[Axis]]:
    """Return the words with one value each, and the settings that were given several.

    Of what takes one number, word or ``true`` and ``false``, values have commas between them: ``seed=0,1,2``. Numbers
    may be ranges: ``0..63`` are the whole numbers with both ends, ``0.1..1:4`` four values spaced evenly, and
    ``1..100:log3`` three spaced evenly in the logarithm. What takes several itself (lists, pairs, files) has brackets
    around each value: ``views.azimuth_deg=[-30,30],[-90,90]``.

    Raises UserError: an empty range or value, a value that is there twice, a range of what is no number.
    """
    plain, axes = [], []
    for word in words:
        key, equals, text = word.partition("=")
        known = equals and key not in _NOT_VARIED and not key.startswith("sweep.")
        values = _values(key, text, word) if known else [text]
        if len(values) > 1:
            twice = next((value for value in values if values.count(value) > 1), None)
            if twice is not None:
                raise UserError(f"'{word}': the value {twice} is there twice.")
            axes.append(Axis(key, tuple(values)))
        else:
            plain.append(f"{key}={values[0]}" if equals else word)
    return plain, axes


def _values(key: str, text: str, word: str) -> list[str]:
    """Return the values of a word, in full; the text itself where it is one."""
    kind = _kind(type_of(key, word))
    parts = _between_commas(text)
    if typing.get_origin(kind) is dict:
        return [text]
    if typing.get_origin(kind) in (list, tuple) or key in _TAKE_COMMAS:
        return _bracketed(key, text, parts, word)
    # A file with a comma in its name, or what YAML does not read as a plain value.
    if (kind is str and Path(text).exists()) or text.startswith(("!", "&", "*")):
        return [text]
    if len(parts) > 1 and not all(parts):
        raise UserError(f"'{word}': there is an empty value between its commas.")
    numbers = kind in (int, float, Any)
    return [value for part in parts for value in _expanded(part, whole=kind is int, numbers=numbers, word=word)]


def _kind(hint: Any) -> Any:
    """Return the type of a setting without "or None"."""
    kinds = [kind for kind in typing.get_args(hint) if kind is not type(None)]
    return kinds[0] if type(None) in typing.get_args(hint) else hint


def _between_commas(text: str) -> list[str]:
    """Return the parts of a text between its commas, those inside brackets, braces and quotes apart."""
    parts, depth, quote = [""], 0, ""
    for sign in text:
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "\"'" and not parts[-1].strip():
            quote = sign
        depth += (sign in "[{(") - (sign in ")}]")
        if sign == "," and not quote and depth <= 0:
            parts.append("")
        else:
            parts[-1] += sign
    return [part.strip() for part in parts] if len(parts) > 1 else [text]


def _bracketed(key: str, text: str, parts: list[str], word: str) -> list[str]:
    """Return the values of what takes several itself, each in brackets."""
    inside = [part.startswith("[") and part.endswith("]") for part in parts]
    if any(_RANGE.fullmatch(part.strip("[] ")) for part in parts) and not Path(text).exists():
        several = "may be several files or names" if key in _TAKE_COMMAS else "takes several numbers or names"
        raise UserError(
            f"'{word}': a range goes with a single number, and {key} {several}. Put brackets around each value: {key}=[...],[...]."
        )
    if len(parts) < 2 or not any(inside):
        return [text]
    if not all(inside):
        raise UserError(f"'{word}': several values of {key} are written with brackets around each: {key}=[...],[...].")
    return [part[1:-1].strip() if key in _TAKE_COMMAS else part for part in parts]


# Ranges.

_NUMBER = r"[-+]?(?:\d+(?:\.\d+)?|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER})\.\.({_NUMBER})(?::(log)?(\d+))?")
_LIKE_A_RANGE = re.compile(r"[^/\\]*\d\s*\.\.\s*[-+.]?\d[^/\\]*")
_OF_HYDRA = re.compile(r"(range|choice|interval|glob|tag|sort|shuffle)\(.*")
_MOST_VALUES = 100_000


def _expanded(part: str, *, whole: bool, numbers: bool, word: str) -> list[str]:
    """Return the values of a range, or what else stands between commas as it is."""
    found = _RANGE.fullmatch(part)
    if found and numbers:
        return list(dict.fromkeys(_range(found, whole, word)))
    if found:
        raise UserError(f"'{word}': a range goes with numbers, and this setting is none. Write its values with commas.")
    if numbers and (_LIKE_A_RANGE.fullmatch(part) or _OF_HYDRA.fullmatch(part)):
        raise UserError(
            f"'{word}': expected values with commas as 1,2,5, whole numbers as 0..63, or numbers spaced evenly as 0.1..1:4, "
            "in the logarithm as 0.1..10:log5."
        )
    return [part]


def _range(found: re.Match[str], whole: bool, word: str) -> Iterator[str]:
    """Yield the values of a range as texts, its ends as they were written."""
    first, last, log, count = found.groups()
    low, high = float(first), float(last)
    if low > high:
        raise UserError(f"'{word}': an empty range, as {first} is above {last}. Write {last}..{first}.")
    if log and low <= 0:
        raise UserError(f"'{word}': a range in the logarithm begins above 0, found {first}.")
    if count is None and not (low.is_integer() and high.is_integer()):
        raise UserError(
            f"'{word}': how many values? {first}..{last}:4 are four, spaced evenly; {first}..{last}:log4 in the logarithm."
        )
    values = int(high - low) + 1 if count is None else int(count)
    if not (2 if count is not None and low < high else 1) <= values <= _MOST_VALUES:
        raise UserError(f"'{word}': {values:,} values, expected from 2 to {_MOST_VALUES:,}.")
    for place in range(values):
        share = place / max(values - 1, 1)
        value = low + place if count is None else low + (high - low) * share
        if log:
            value = math.exp(math.log(low) + (math.log(high) - math.log(low)) * share)
        ends = {0: low, values - 1: high}
        yield _number(ends.get(place, value), whole)


def _number(value: float, whole: bool) -> str:
    """Return a number as it is written: whole ones without a point."""
    short = float(f"{value:.6g}") if abs(value) < 1e6 else value
    return str(round(value)) if whole or short.is_integer() else f"{short:.6g}"
