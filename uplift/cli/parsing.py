"""The ``key=value`` words of a verb, read and checked as the table of its settings says."""

from __future__ import annotations

import math
import re
import typing
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from uplift.cli.verbs import CAMERA_KEYS, NEEDED, READ_KEYS, VERBS
from uplift.config.settings import Setting
from uplift.errors import UserError, did_you_mean, nearest

if TYPE_CHECKING:
    from uplift.data.formats.base import ReadOptions
    from uplift.models.known_camera import KnownCamera

__all__ = ["Keys", "checked", "keyed", "known_camera"]


class Keys(dict[str, str]):
    """The ``key=value`` words of a verb as they were given, and its plain words."""

    def __init__(self, verb: str, values: Mapping[str, str], plain: Sequence[str] = ()):
        super().__init__(values)
        self.verb, self.plain = verb, list(plain)

    def value(self, key: str) -> Any:
        """Return the value of ``key`` as its setting has it, its default where it is not given.

        Raises UserError for a value that the setting does not accept.
        """
        setting = VERBS[self.verb].settings[key]
        return checked(setting, self[key], self.verb) if key in self else setting.default

    def given(self, *keys: str) -> dict[str, Any]:
        """Return the values of those of ``keys`` that are given."""
        return {key: self.value(key) for key in keys if key in self}

    def options(self, group: str) -> dict[str, Any]:
        """Return the options of a class that words ``group.NAME=VALUE`` give, numbers and true or false as such."""
        from uplift.config.yaml_file import read_value

        return {
            key.removeprefix(f"{group}."): read_value(text) for key, text in self.items() if key.startswith(f"{group}.")
        }

    def detection(self) -> dict[str, Any]:
        """Return the arguments of `uplift.detect` that the words of `DETECTOR_KEYS` give."""
        options = self.options("detector.options")
        found = {"detector": self.value("detector"), "detector_options": options, "people": self.value("people")}
        return found | {name: self.value(f"video.{name}") for name in ("start_s", "end_s")}

    def reading(self) -> ReadOptions:
        """Return the `uplift.data.formats.base.ReadOptions` of those `READ_KEYS` that are given."""
        from uplift.data.formats.base import ReadOptions, size_of

        given = self.given(*READ_KEYS)
        if "image_size" in given:
            given["image_size"] = size_of(given["image_size"])
        return ReadOptions(**given)


def known_camera(keys: Keys) -> KnownCamera | None:
    """Return what words of predict or evaluate say of how the camera stands; None where they say nothing."""
    from uplift.models.known_camera import KnownCamera

    given = {name.partition(".")[2]: value for name, value in keys.given(*CAMERA_KEYS).items()}
    return KnownCamera(**given) if given else None


def checked(setting: Setting, text: str, verb: str) -> Any:
    """Return ``text`` as the value of a setting of ``verb``; raises UserError where it does not accept that."""
    value = _read(setting, text)
    if value is None:
        near = nearest(text, setting.choices)
        shown = text if re.fullmatch(r"[-+\d.,e]+", text) else repr(text)
        raise UserError(f"{verb}: {setting.name}={shown}, expected {setting.accepts}.{near}")
    return value


def _read(setting: Setting, text: str) -> Any:
    """Return the value, None where the setting does not accept ``text``."""
    if setting.choices:
        return text.casefold() if text.casefold() in setting.choices else None
    if setting.kind is bool:
        return {"true": True, "false": False}.get(text.casefold())
    form, parts = typing.get_origin(setting.kind), typing.get_args(setting.kind)
    if form not in (list, tuple):
        return text if setting.kind is str else _number(setting.kind, text, setting.low, setting.high)
    words = [part.strip() for part in text.split(",") if part.strip()]
    if parts[0] is str:
        return words
    count = len(parts) if form is tuple else len(words)
    ends = [end if isinstance(end, tuple) else (end,) * count for end in (setting.low, setting.high)]
    if len(words) != count:
        return None
    numbers = tuple(_number(parts[0], *word) for word in zip(words, *ends, strict=True))
    return None if None in numbers else form(numbers)


def _number(kind: type[int] | type[float], text: str, low: Any, high: Any) -> Any:
    """Return the number, None where ``text`` is none between ``low`` and ``high``; infinite only if ``high`` is."""
    try:
        value = kind(text)
    except ValueError:
        return None
    low, high = (-math.inf if low is None else low), (math.inf if high is None else high)
    return value if low <= value <= high else None


def keyed(verb: str, words: Sequence[str]) -> Keys:
    """Return the words of a verb: those that `VERBS` lists, with plain ones where it has some.

    Raises:
        UserError: a word without "=" where the verb takes none, an unknown key, one without a value or given twice,
            one missing.
    """
    from uplift.config.loading import split_words  # loads yaml, which `uplift --help` does without

    known, plain = VERBS[verb].settings, bool(VERBS[verb].words)
    open_groups = tuple(f"{name}." for name, one in known.items() if _is_group(one))
    needed = [name for name, one in known.items() if one.default is NEEDED]
    known = [name for name, one in known.items() if not _is_group(one)]
    others, found = split_words(words, known if plain else None)
    if others and not plain:
        raise UserError(f"{verb}: '{others[0]}' is not one of its settings.{did_you_mean(others[0], known)}")
    for key, value in found.items():
        if key not in known and not key.startswith(open_groups):
            raise UserError(f"{verb}: '{key}={value}' is not one of its settings.{did_you_mean(key, known)}")
        if not value:
            raise UserError(f"{verb}: '{key}=' has no value.")
    for key in needed:
        if key not in found and (others or not plain):
            raise UserError(f"{verb} needs {key}=...: {VERBS[verb].settings[key].help}. (uplift {verb} --help)")
    return Keys(verb, found, others)


def _is_group(setting: Setting) -> bool:
    return typing.get_origin(setting.kind) is dict
