"""``key=value`` overrides: each value read as the type its setting has."""

from __future__ import annotations

import dataclasses
import functools
import re
import typing
from pathlib import Path
from typing import Any

from uplift.config import Settings
from uplift.errors import UserError, did_you_mean
from uplift.paths import shipped_names
from uplift.readers.files import absolute
from uplift.yaml_file import read_value

__all__ = ["hints_of", "put_override", "setting_names"]


@functools.cache
def hints_of(kind: type) -> dict[str, Any]:
    """Return the types of a dataclass's fields; reading them from their text takes long, so once."""
    return typing.get_type_hints(kind)


def put_override(data: dict[str, Any], override: str) -> None:
    """Put one ``key=value`` of the command line into plain settings.

    Raises:
        UserError: no ``key=value``, an unknown key, a group given a value.
    """
    key, equals, text = override.partition("=")
    if not equals or not key:
        near = f" Did you mean task={override}?" if override in shipped_names("tasks") else ""
        raise UserError(f"'{override}': expected key=value, such as trainer.max_time=00:10:00.{near}")
    keys = key.split(".")
    hint = _hint(keys, override)
    if dataclasses.is_dataclass(hint):
        below = did_you_mean("", setting_names(f"{key}."))
        raise UserError(f"'{override}': '{key}' holds settings: set one of them.{below}")
    value = _from_here(keys, _value(hint, text, override))
    for above in keys[:-1]:
        data = data.setdefault(above, {})
        if not isinstance(data, dict):
            raise UserError(f"'{override}': '{above}' is not a group of settings.")
    data[keys[-1]] = value


def _hint(keys: list[str], override: str) -> Any:
    """Return the type of the setting that ``keys`` name; Any below a free dictionary."""
    hint: Any = Settings
    for depth, key in enumerate(keys):
        full = ".".join(keys[: depth + 1])
        if not dataclasses.is_dataclass(hint):
            if typing.get_origin(hint) is dict or hint is Any:
                return Any
            raise UserError(f"'{override}': '{'.'.join(keys[:depth])}' is one setting, with none below it.")
        hints = hints_of(hint)
        if key not in hints:
            near = did_you_mean(full, setting_names() if depth else [*hints, "resume"])
            raise UserError(f"Unknown setting '{full}' in '{override}'.{near}")
        hint = hints[key]
    return hint


def _value(hint: Any, text: str, override: str) -> Any:
    """Return ``text`` as the type ``hint`` wants it: a name that looks like a number stays a name."""
    kinds = typing.get_args(hint)
    if hint is str or (str in kinds and type(None) in kinds):
        return text if hint is str else (None if text in ("", "null", "~") else text)
    if typing.get_origin(hint) not in (list, tuple):
        return read_value(text)
    inner = text.strip()
    if inner.startswith("[") != inner.endswith("]"):
        raise UserError(f"'{override}': a bracket is missing; a list is written a,b or [a,b].")
    return [part.strip().strip("'\"") for part in inner.strip("[]").split(",") if part.strip()]


def _from_here(keys: list[str], value: Any) -> Any:
    """Return a path of the command line as absolute: it is relative to the current folder."""
    name = ".".join(keys)
    if not isinstance(value, str) or not value:
        return value
    if name in ("data.train", "data.test"):
        return absolute(value)
    if name in ("data.root", "data.images", "init"):
        return str(Path(value).expanduser().absolute())
    if name == "data.labelled.file" and not re.fullmatch(r"\w+:\w+", value):  # SET:SPLIT is no path
        return str(Path(value).expanduser().absolute())
    if name == "skeleton" and value.endswith((".yaml", ".yml")):
        return str(Path(value).expanduser().absolute())
    file, colon, found = value.rpartition(":")
    if colon and file.endswith(".py") and (keys[-1] == "use" or name == "lifter.network"):
        return f"{Path(file).expanduser().absolute()}:{found}"
    return value


def setting_names(below: str = "") -> list[str]:
    """Return every setting's full name, such as ``trainer.max_time``."""

    def walk(kind: type, prefix: str) -> list[str]:
        names = []
        for name, hint in hints_of(kind).items():
            names += walk(hint, f"{prefix}{name}.") if dataclasses.is_dataclass(hint) else [f"{prefix}{name}"]  # type: ignore[arg-type]
        return names

    return [name for name in walk(Settings, "") if name.startswith(below)]
