"""Turn a task file and ``key=value`` overrides into checked `Settings`."""

from __future__ import annotations

import dataclasses
import functools
import re
import typing
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml

from uplift.config.files import absolute, shipped, shipped_names
from uplift.config.settings import Settings, check_settings
from uplift.config.yaml_file import read_value, read_yaml
from uplift.errors import UserError, did_you_mean

__all__ = ["load_settings", "put_override", "read_task", "save_settings", "setting_names", "task_path"]

# Turn a task file and ``key=value`` overrides into checked `Settings`.

_MAX_EXTENDS = 10


def load_settings(task: str | None = None, overrides: Sequence[str] = (), default: str = "default") -> Settings:
    """Return the settings of a task (a shipped name or a YAML file) with ``overrides`` on top.

    Without a task the shipped ``default`` is the base: the recipe for one's own data. Paths in a
    task file belong to that file (`data.*` to `data.root`), those of overrides to the current
    folder; all leave here absolute where that matters.

    Raises:
        UserError: an unknown task or key, a value of the wrong type, settings that contradict.
    """
    path = task_path(task or default)
    merged = read_task(path)
    merged["task"] = path.stem if task else ""
    for override in overrides:
        put_override(merged, override)
    settings = _typed(merged)
    if task and not settings.data.name and settings.data.root is None:
        settings.data.root = str(path.parent.absolute())  # a task file of one's own names files beside it
    check_settings(settings)
    return settings


def task_path(task: str) -> Path:
    """Return the file of a task: a shipped name, or a path."""
    if task in shipped_names("tasks"):
        return shipped("tasks") / f"{task}.yaml"
    path = Path(task).expanduser()
    if path.suffix in (".yaml", ".yml") and path.is_file():
        return path
    if path.suffix in (".yaml", ".yml") or len(path.parts) > 1:
        raise UserError(f"No task file {path} (looked in {path.absolute().parent}).")
    names = [name for name in shipped_names("tasks") if name != "default"]
    raise UserError(
        f"No task '{task}'.{did_you_mean(task, names)} `uplift tasks` lists them; a file of your own ends in .yaml."
    )


def read_task(path: Path, depth: int = 0) -> dict[str, Any]:
    """Return the plain settings of a task file, its ``extends:`` underneath, keys checked with their line."""
    data, where = read_yaml(path, "task")
    if not isinstance(data, dict):
        raise UserError(f"{where(())}: found {type(data).__name__}, expected settings as `key: value`.")
    base: dict[str, Any] = {}
    parent = data.pop("extends", None)
    if parent is not None:
        if depth >= _MAX_EXTENDS:
            raise UserError(f"{where(('extends',))}: more than {_MAX_EXTENDS} tasks extend one another: a circle?")
        base = read_task(_parent_path(parent, path.parent, where(("extends",))), depth + 1)
    _bring_up_to_date(data)
    _check_keys(data, Settings, (), where)
    _bind_paths(data, path.parent)
    return _merge(base, data)


def _bring_up_to_date(data: dict[str, Any]) -> None:
    """Give settings that runs of version 0.1 wrote under other names their new ones."""
    chosen = data.get("data")
    for group in ("select", "hold_out"):
        choice = chosen.get(group) if isinstance(chosen, dict) else None
        for old in ("subject", "action", "sequence", "camera"):
            if isinstance(choice, dict) and old in choice:
                choice.setdefault(f"{old}s", choice.pop(old))


def _parent_path(parent: Any, folder: Path, where: str) -> Path:
    if not isinstance(parent, str):
        raise UserError(f"{where}: 'extends' is {parent!r}, expected one task or file.")
    beside = folder / parent
    if beside.suffix in (".yaml", ".yml") and beside.is_file():
        return beside
    try:
        return task_path(parent)
    except UserError as error:
        raise UserError(f"{where}: extends: {error}") from None


def _bind_paths(data: dict[str, Any], folder: Path) -> None:
    """Make what a task file names relative to itself absolute: skeleton, data.root, files of priors, networks and data sets."""
    skeleton = data.get("skeleton")
    if isinstance(skeleton, str) and skeleton.endswith((".yaml", ".yml")):
        data["skeleton"] = str((folder / skeleton).absolute())
    root = (data.get("data") or {}).get("root")
    if isinstance(root, str) and root:
        data["data"]["root"] = str((folder / Path(root).expanduser()).absolute())
    specs = [spec for spec in (data.get("priors") or {}).values() if isinstance(spec, dict)]
    for holder, key in [
        *((spec, "use") for spec in specs),
        (data.get("lifter") or {}, "network"),
        (data.get("data") or {}, "use"),
    ]:
        file, colon, name = str(holder.get(key, "")).rpartition(":")
        if colon and file.endswith(".py"):
            holder[key] = f"{(folder / file).absolute()}:{name}"


def _merge(base: dict[str, Any], top: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in top.items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = _merge(merged[key], value)
        else:
            merged[key] = value
    return merged


def _check_keys(data: dict[str, Any], kind: type, above: tuple[str, ...], where: Callable[[tuple], str]) -> None:
    hints = _hints_of(kind)
    for key, value in data.items():
        if key not in hints:
            valid = [".".join((*above, name)) for name in hints]
            full = ".".join((*above, key))
            raise UserError(f"{where((*above, key))}: unknown setting '{full}'.{did_you_mean(full, valid)}")
        is_group = dataclasses.is_dataclass(hints[key])
        if (is_group or typing.get_origin(hints[key]) is dict) and not isinstance(value, dict):
            raise UserError(
                f"{where((*above, key))}: '{'.'.join((*above, key))}' is {value!r}, expected settings below it."
            )
        if is_group:
            _check_keys(value, hints[key], (*above, key), where)  # type: ignore[arg-type]


def _typed(merged: dict[str, Any]) -> Settings:
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    _check_tuples(merged, Settings)
    try:
        config = OmegaConf.merge(OmegaConf.structured(Settings), OmegaConf.create(_escape(merged)))
        settings = OmegaConf.to_object(config)
    except OmegaConfBaseException as error:
        key = getattr(error, "full_key", None)
        text = str(error).splitlines()[0]
        raise UserError(f"Setting '{key}': {text}." if key else f"Settings: {text}.") from None
    assert isinstance(settings, Settings)
    for name, spec in settings.priors.items():
        if not isinstance(spec, dict):
            raise UserError(f"priors.{name} is {spec!r}, expected settings: use, weight and its own options.")
    return settings


def _check_tuples(data: dict[str, Any], kind: type, above: str = "") -> None:
    """Refuse what is not as many numbers as its setting holds; OmegaConf does, but without saying which."""
    for key, hint in _hints_of(kind).items():
        value = data.get(key)
        if dataclasses.is_dataclass(hint) and isinstance(value, dict):
            _check_tuples(value, hint, f"{above}{key}.")  # type: ignore[arg-type]
        elif typing.get_origin(hint) is tuple and key in data:
            count = len(typing.get_args(hint))
            if not isinstance(value, (list, tuple)) or len(value) != count or not all(map(_is_number, value)):
                raise UserError(f"{above}{key}={value!r}: expected {count} numbers, as a,b.")


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return True


def _escape(value: Any) -> Any:
    """Keep OmegaConf from reading ``${...}`` in a user's text as an interpolation."""
    if isinstance(value, dict):
        return {key: _escape(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_escape(inner) for inner in value]
    return value.replace("${", "\\${") if isinstance(value, str) else value


def save_settings(settings: Settings, path: Path) -> None:
    """Write all settings, resolved, as a task file that can be used again."""
    path.write_text(yaml.safe_dump(dataclasses.asdict(settings), sort_keys=False, allow_unicode=True))


# ``key=value`` overrides: each value read as the type its setting has.


@functools.cache
def _hints_of(kind: type) -> dict[str, Any]:
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
        hints = _hints_of(hint)
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
        for name, hint in _hints_of(kind).items():
            names += walk(hint, f"{prefix}{name}.") if dataclasses.is_dataclass(hint) else [f"{prefix}{name}"]  # type: ignore[arg-type]
        return names

    return [name for name in walk(Settings, "") if name.startswith(below)]
