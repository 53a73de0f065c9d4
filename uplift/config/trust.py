"""Consent to code: a class of a user's file or module is loaded only where the user named it in this command or call."""

from __future__ import annotations

import functools
import os
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from uplift.errors import UserError

__all__ = ["Consent", "Trust", "consent_of", "consents", "granted", "named_in", "place_of", "require", "trust_words"]

Consent = frozenset[str]
"""Real paths of files, and names of modules with all below them, whose code may run."""
Trust = str | Path | Iterable[str | Path] | None
"""``trust=`` of functions: files and modules, or texts with commas between them."""
Given = ParamSpec("Given")
Result = TypeVar("Result")

_NOW: ContextVar[Consent | None] = ContextVar("consent", default=None)
"""What is consented to; None outside the commands and functions of this package."""
_NAMED_IN: dict[str, str] = {}
"""Classes that files name -> the last such file, for messages."""
_CLASS = re.compile(r"(.+\.py|[^\W\d]\w*(?:\.\w+)*):[^\W\d]\w*(?::.*)?", re.DOTALL)
"""``file.py:Class`` or ``package.module:Class``, perhaps with ``:SPLIT``."""


def consents(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Make a function or constructor one that users call: classes that its arguments name, and ``trust=``, may run in it.

    Arguments are the user's own words where the user makes the call. What it calls in turn consents to nothing more:
    there, names may be those of a file that was read.
    """

    @functools.wraps(function)
    def asked(*given: Given.args, **options: Given.kwargs) -> Result:
        words = [*given, *options.values()] if _NOW.get() is None else []
        with granted(consent_of(words, options.get("trust"))):
            return function(*given, **options)

    return asked


def consent_of(words: Iterable[Any], trust: Any = None) -> Consent:
    """Return the code of the classes that ``words`` name, and of ``trust=``; raises UserError for a file that is not there."""
    return _named(words) | _trusted(trust)


@contextmanager
def granted(consent: Consent | None = None) -> Iterator[Consent]:
    """Let the code of ``consent`` run, beside what runs already, and yield both: to be granted again in what comes later."""
    token = _NOW.set((_NOW.get() or Consent()) | (consent or Consent()))
    try:
        yield _NOW.get() or Consent()
    finally:
        _NOW.reset(token)


def place_of(use: str) -> str:
    """Return the file, its real path, or the module of ``file.py:Class`` or ``package.module:Class``."""
    place = use.rpartition(":")[0]
    return os.path.realpath(os.path.expanduser(place)) if place.endswith(".py") else place


def require(asked: Mapping[str, str]) -> None:
    """Raise UserError for settings, each with the class that it names, whose code the user did not consent to."""
    consent = _NOW.get() or Consent()
    refused = {key: use for key, use in asked.items() if not consent & _with_parents(place_of(use))}
    if not refused:
        return
    files = list(dict.fromkeys(_NAMED_IN[use] for use in refused.values() if use in _NAMED_IN))
    names = ", ".join(f"{key}={use}" for key, use in refused.items())
    raise UserError(
        f"{', '.join(files)}{' asks for ' if files else ''}{names}: code that is not part of uplift runs only with your "
        f"consent in this command. Read it, and if you trust it, add {trust_words(refused.values())}"
    )


def _with_parents(place: str) -> set[str]:
    """Return a file, or a module and the packages that it is in."""
    if os.sep in place:
        return {place}
    parts = place.split(".")
    return {".".join(parts[: end + 1]) for end in range(len(parts))}


def trust_words(uses: Iterable[str]) -> str:
    """Return ``trust=...`` for the classes ``uses``, as the command line takes it; empty without any."""
    places = [place_of(use) for use in dict.fromkeys(uses)]
    here = os.path.realpath(".")
    shown = list(dict.fromkeys(os.path.relpath(one, here) if one.startswith(here + os.sep) else one for one in places))
    return shlex.quote(f"trust={','.join(shown)}") if shown else ""


def named_in(uses: Iterable[str], file: str) -> None:
    """Note that ``file`` names the classes ``uses``, for the message where one of them is refused."""
    _NAMED_IN.update(dict.fromkeys(uses, file))


# What words and arguments name.


def _named(words: Iterable[Any]) -> Consent:
    """Return the places of classes in texts, and in those that mappings and lists of them hold."""
    found: set[str] = set()
    for word in words:
        if isinstance(word, (str, Path)):
            value = str(word).partition("=")[2]  # of key=value
            matches = (_CLASS.fullmatch(text.strip()) for text in (str(word), value))
            found |= {place_of(f"{match[1]}:_") for match in matches if match}
        elif isinstance(word, Mapping):
            found |= _named(word.values())
        elif isinstance(word, (list, tuple)) and all(isinstance(one, (str, Mapping)) for one in word):
            found |= _named(word)
        else:  # options of reading a file
            format = getattr(word, "format", None)
            found |= _named([format]) if isinstance(format, str) else set()
    return Consent(found)


def _trusted(trust: Any) -> Consent:
    """Return the files and modules of ``trust=``."""
    if trust is None:
        return Consent()
    given = [trust] if isinstance(trust, (str, Path)) else list(trust)
    parts = [
        part for one in given for part in ([str(one)] if Path(one).is_file() else str(one).strip("[] ").split(","))
    ]
    return Consent(_trusted_place(part.strip()) for part in parts if part.strip())


def _trusted_place(part: str) -> str:
    place = re.sub(r":\w+$", "", part)  # of file.py:Class
    if not place.endswith(".py") and re.fullmatch(r"[^\W\d]\w*(\.\w+)*", place):
        return place
    path = Path(place).expanduser()
    if not place.endswith(".py") or not path.is_file():
        found = "no such file" if place.endswith(".py") else "no name of code"
        raise UserError(
            f"trust={part}: {found}, expected the .py file or the module whose classes may run, such as "
            "trust=my_priors.py, trust=a.py,b.py or trust=my_package.nets."
        )
    return os.path.realpath(path)
