"""Turn a task file and ``key=value`` overrides into checked `Settings`."""

from __future__ import annotations

import dataclasses
import functools
import re
import typing
from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import yaml

from uplift.config.files import absolute, holds_run, shipped, shipped_names
from uplift.config.settings import (
    RENAMED,
    TRAINER_FLAGS,
    TRAINER_FLAGS_OF_FIT,
    Settings,
    all_settings,
    check_settings,
    rename_old,
    seconds_of,
)
from uplift.config.trust import named_in, trust_words
from uplift.config.yaml_file import Where, read_value, read_yaml
from uplift.errors import UserError, did_you_mean

__all__ = [
    "classes_of",
    "load_settings",
    "plain_task",
    "put_override",
    "read_task",
    "save_settings",
    "setting_names",
    "settings_from",
    "split_words",
    "task_path",
    "trust_of",
    "type_of",
]

_MAX_EXTENDS = 10


def load_settings(task: str | None = None, overrides: Sequence[str] = (), default: str = "default") -> Settings:
    """Return the settings of a task (a shipped name or a YAML file) with ``overrides`` on top.

    Without a task the shipped ``default`` is the base: the recipe for a user's own data. Paths in a
    task file are relative to that file (`data.*` to `data.root`), those of overrides to the current
    folder; they are returned absolute where that matters.

    Raises UserError: an unknown task or key, a value of the wrong type, settings that contradict.
    """
    path = task_path(task or default)
    settings = _typed(plain_task(task, overrides, default))
    if task and not settings.data.name and settings.data.root is None:
        settings.data.root = str(path.parent.absolute())  # a user's task file names files beside it
    check_settings(settings)
    return settings


def plain_task(task: str | None = None, overrides: Sequence[str] = (), default: str = "default") -> dict[str, Any]:
    """Return the settings of `load_settings` as plain data, of what the task and ``overrides`` set, types not checked."""
    path = task_path(task or default)
    merged = read_task(path)
    merged["task"] = path.stem if task else ""
    words = split_words(overrides)[1]  # refuses a key given twice
    given: dict[str, Any] = {}
    for key in words.keys() & {"data.train", "data.simulate"}:
        put_override(given, f"{key}={words[key]}")
    _choose_source(merged, given)
    for override in overrides:
        put_override(merged, override)
    return merged


def settings_from(plain: Mapping[str, Any], task: str = "default") -> Settings:
    """Return the settings of ``task`` with plain nested ones over them, as `load_settings` checks them.

    ``priors`` replace those of the task. Files of classes are relative to the current folder, and become absolute.
    """
    merged = read_task(task_path(task))
    given = {key: _as_plain(value) for key, value in plain.items() if value is not None}
    _bind_paths(given, Path.cwd())
    _check_keys({key: value for key, value in given.items() if key != "priors"}, (), lambda path: ".".join(path))
    _put_texts(given)
    _choose_source(merged, given)
    merged = _merge(merged, given) | {key: given[key] for key in ("priors",) if key in given}
    settings = _typed({**merged, "task": "" if task == "default" else task})
    check_settings(settings)
    return settings


def _as_plain(value: Any) -> Any:
    """Return a copy with numbers of numpy and torch as Python's, dataclasses and tuples as plain data."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    if isinstance(value, Mapping):
        return {key: _as_plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_as_plain(inner) for inner in value]
    single = getattr(value, "ndim", None) == 0 and hasattr(value, "item")
    return value.item() if single else value  # type: ignore[union-attr]


def save_settings(settings: Settings, path: Path) -> None:
    """Write all settings as a task file that can be used again."""
    path.write_bytes(yaml.safe_dump(dataclasses.asdict(settings), sort_keys=False, allow_unicode=True).encode())


def setting_names(below: str = "") -> list[str]:
    """Return every setting's full name, such as ``trainer.max_time``."""
    return [name for name in all_settings() if name.startswith(below)]


# Task files: plain settings, those of the task that they extend underneath.


def task_path(task: str) -> Path:
    """Return the file of a task: a shipped name, or a path."""
    if task in shipped_names("tasks"):
        return shipped("tasks") / f"{task}.yaml"
    path = Path(task).expanduser()
    if path.suffix in (".yaml", ".yml") and path.is_file():
        return path
    if path.suffix in (".yaml", ".yml") or len(path.parts) > 1:
        raise UserError(f"No task file {path} (looked in {path.absolute().parent}).")
    hint = did_you_mean(task, [name for name in shipped_names("tasks") if name != "default"])
    raise UserError(f"No task '{task}'.{hint} `uplift tasks` lists them; your own task is a .yaml file.")


def read_task(path: Path, depth: int = 0) -> dict[str, Any]:
    """Return the plain settings of a task file, its ``extends:`` underneath, keys checked with their line."""
    data, where = read_yaml(path, "task")
    if not isinstance(data, dict):
        raise UserError(f"{where(())}: found {type(data).__name__}, expected settings as `key: value`.")
    base: dict[str, Any] = {}
    parent = data.pop("extends", None)
    if parent is not None:
        line = where(("extends",))
        if depth >= _MAX_EXTENDS:
            raise UserError(f"{line}: more than {_MAX_EXTENDS} tasks extend one another. Is there a circle?")
        base = read_task(_parent_path(parent, path.parent, line), depth + 1)
    if path.name == "config.yaml":  # written by a fit, perhaps of an earlier version
        rename_old(data)
    _gather_flags(data)
    _check_keys(data, (), where)
    _put_texts(data)
    _bind_paths(data, path.parent)
    named_in(classes_of(data).values(), str(path))
    if path.name != "config.yaml":  # of a run, which has trained on the one or the other
        _choose_source(base, data, f"{path}: ")
    return _merge(base, data)


def _choose_source(below: dict[str, Any], given: dict[str, Any], where: str = "") -> None:
    """Set aside, in place, the ``data.simulate`` or ``data.train`` of a task where the other is given on top of it.

    Raises UserError: both are given.
    """
    given, below = (data if isinstance(data := plain.get("data"), dict) else {} for plain in (given, below))
    if given.get("train") and given.get("simulate"):
        raise UserError(
            f"{where}data.train={given['train']} and data.simulate={given['simulate']} are both set, and a fit trains on "
            "files or on what it simulates. Leave one of them out."
        )
    if given.get("train") and below.get("simulate"):
        below["simulate"] = 0
    elif given.get("simulate") and below.get("train"):
        below["train"] = None


def _parent_path(parent: Any, folder: Path, where: str) -> Path:
    if not isinstance(parent, str):
        raise UserError(f"{where}: 'extends' is {parent!r}, expected a task or a file.")
    beside = folder / parent
    if beside.suffix in (".yaml", ".yml") and beside.is_file():
        return beside
    try:
        return task_path(parent)
    except UserError as error:
        raise UserError(f"{where}: extends: {error}") from None


_CLASSES = (
    "module", "lifter.network", "data.use", "data.format", "views.use", "student.network", "student.loss", "student.module",
)  # fmt: skip
"""Settings that may name a class of the user's as ``file.py:Class``."""
_GROUPS_OF_CLASSES = ("priors", "callbacks", "loggers")
"""Groups whose parts name one as ``use``."""


def _holder(data: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the group that holds a setting; an empty one where it is not set."""
    for key in name.split(".")[:-1]:
        inner = data.get(key)
        data = inner if isinstance(inner, dict) else {}
    return data


def _bind_paths(data: dict[str, Any], folder: Path) -> None:
    """Make the paths of a task file absolute: skeleton, data.root, files of priors, networks, data sets and formats."""
    skeleton = data.get("skeleton")
    if isinstance(skeleton, str) and skeleton.endswith((".yaml", ".yml")):
        data["skeleton"] = str((folder / skeleton).absolute())
    root = (data.get("data") or {}).get("root")
    if isinstance(root, str) and root:
        data["data"]["root"] = str((folder / Path(root).expanduser()).absolute())
    for _, holder, key in _holders_of_classes(data):
        holder[key] = _class_in(holder[key], folder)


def classes_of(data: dict[str, Any]) -> dict[str, str]:
    """Return the settings that name a class as ``file.py:Class`` or ``package.module:Class``, in full, with the class.

    Priors of weight 0 do not count: they are left out.
    """
    found = [one for one in _holders_of_classes(data) if ":" in one[1][one[2]]]
    return {name: holder[key] for name, holder, key in found if key != "use" or holder.get("weight", 1) != 0}


def trust_of(settings: Settings, *groups: str) -> str:
    """Return the words that a command on a run of these settings needs, `` trust=...``, empty where it runs no other code.

    ``groups`` are beginnings of the settings that count; all by default.
    """
    uses = (use for name, use in classes_of(dataclasses.asdict(settings)).items() if name.startswith(groups or ""))
    words = trust_words(uses)
    return f" {words}" if words else ""


def _holders_of_classes(data: dict[str, Any]) -> list[tuple[str, dict[str, Any], str]]:
    """Return each setting that names a class: in full, and the group that holds it with its key there."""
    found = [(name, _holder(data, name), name.split(".")[-1]) for name in _CLASSES]
    for group in _GROUPS_OF_CLASSES:
        parts = _holder(data, f"{group}.use").items()
        found += [(f"{group}.{name}.use", spec, "use") for name, spec in parts if isinstance(spec, dict)]
    return [one for one in found if isinstance(one[1].get(one[2]), str)]


def _class_in(value: Any, folder: Path) -> Any:
    """Return ``file.py:Class`` with the file's full path; any other value as it is."""
    file, colon, name = str(value).rpartition(":")
    return f"{(folder / Path(file).expanduser()).absolute()}:{name}" if colon and file.endswith(".py") else value


def _merge(base: dict[str, Any], top: dict[str, Any]) -> dict[str, Any]:
    merged = base | top
    for key in base.keys() & top.keys():
        if isinstance(base[key], dict) and isinstance(top[key], dict):
            merged[key] = _merge(base[key], top[key])
    return merged


def _check_keys(data: dict[str, Any], above: tuple[str, ...], where: Where) -> None:
    """Refuse keys that are not settings, and a value in place of a group of them."""
    names = _names_below(above)
    for key, value in data.items():
        part = (*above, key)
        full = ".".join(part)
        if full not in names:
            raise UserError(f"{where(part)}: {_unknown(full, names)}")
        setting = all_settings().get(full)
        if (setting is None or typing.get_origin(setting.type) is dict) and not isinstance(value, dict):
            raise UserError(f"{where(part)}: '{full}' is {value!r}, expected settings below it.")
        if setting is None:
            _check_keys(value, part, where)


def _gather_flags(data: dict[str, Any]) -> None:
    """Put flags of Lightning's Trainer among plain ``trainer`` settings below ``trainer.flags``, in place."""
    trainer = data.get("trainer")
    if isinstance(trainer, dict):
        flags = {name: trainer.pop(name) for name in list(trainer) if name in TRAINER_FLAGS}
        if flags and isinstance(trainer.setdefault("flags", {}), dict):
            trainer["flags"] |= flags


def _put_texts(data: dict[str, Any]) -> None:
    """Put mappings as the texts that they may also be written as, in place: times by units, focal lengths by camera."""
    chosen = data.get("data")
    if isinstance(chosen, dict) and isinstance(lengths := chosen.get("focal_px"), dict):
        chosen["focal_px"] = ",".join(f"{camera}:{length}" for camera, length in lengths.items())
    trainer = data.get("trainer")
    if isinstance(trainer, dict) and isinstance(trainer.get("max_time"), (dict, timedelta)):
        trainer["max_time"] = f"{seconds_of(trainer['max_time']):.12g}"


def _names_below(above: Sequence[str]) -> list[str]:
    """Return the full names of the settings and groups right below a group."""
    start, depth = "".join(f"{key}." for key in above), len(above) + 1
    return list(dict.fromkeys(".".join(name.split(".")[:depth]) for name in setting_names(start)))


def _unknown(name: str, valid: Iterable[str]) -> str:
    if name in RENAMED:
        return f"the setting '{name}' is now called '{RENAMED[name]}'."
    group, _, flag = name.partition(".")
    if group == "trainer":
        if flag in TRAINER_FLAGS_OF_FIT:
            return f"'{name}' is not for a fit to set: {TRAINER_FLAGS_OF_FIT[flag]}."
        valid = [*valid, *(f"trainer.{one}" for one in TRAINER_FLAGS)]
    return f"unknown setting '{name}'.{did_you_mean(name, valid)}"


def _typed(merged: dict[str, Any]) -> Settings:
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    _check_tuples(merged)
    try:
        config = OmegaConf.merge(_structure(), OmegaConf.create(_escape(merged)))
        settings = OmegaConf.to_object(config)
    except OmegaConfBaseException as error:
        key = getattr(error, "full_key", None)
        text = str(error).splitlines()[0]
        raise UserError(f"Setting '{key}': {text}." if key else f"Settings: {text}.") from None
    assert isinstance(settings, Settings)
    for group in _GROUPS_OF_CLASSES:
        for name, spec in getattr(settings, group).items():
            if not isinstance(spec, dict):
                what = "use, weight and options of the prior" if group == "priors" else "use, and options of the class"
                raise UserError(f"{group}.{name} is {spec!r}, expected settings: {what}.")
    return settings


@functools.cache
def _structure() -> Any:
    """Return the types and defaults of all settings, which `OmegaConf.merge` copies."""
    from omegaconf import OmegaConf

    return OmegaConf.structured(Settings)


def _check_tuples(data: dict[str, Any]) -> None:
    """Refuse what is not as many numbers as its setting holds; OmegaConf does, but without saying which."""
    for setting in all_settings().values():
        if typing.get_origin(setting.type) is tuple:
            value: Any = data
            for key in setting.name.split("."):
                value = value.get(key, setting.default)
                if value is setting.default:
                    break
            count = len(setting.default)
            try:
                right = isinstance(value, (list, tuple)) and len([float(number) for number in value]) == count
            except (TypeError, ValueError):
                right = False
            if not right:
                raise UserError(f"{setting.name}={value!r}: expected {count} numbers, as a,b.")


def _escape(value: Any) -> Any:
    """Keep OmegaConf from reading ``${...}`` in a user's text as an interpolation."""
    if isinstance(value, dict):
        return {key: _escape(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_escape(inner) for inner in value]
    return value.replace("${", "\\${") if isinstance(value, str) else value


# ``key=value`` words: each value read as the type its setting has.


def split_words(words: Iterable[str], of: Collection[str] | None = None) -> tuple[list[str], dict[str, str]]:
    """Return the plain words of a command and its ``key=value`` words, those whose key is given once.

    With the keys ``of`` the command, a word of another key that names an existing file is a plain one.

    Raises UserError: a key twice.
    """
    plain: list[str] = []
    keyed: dict[str, str] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or (of is not None and key not in of and Path(word).exists()):
            plain.append(word)
        elif key in keyed:
            raise UserError(f"'{key}' is given twice: {key}={keyed[key]} and {word}. Keep one.")
        else:
            keyed[key] = value
    return plain, keyed


def put_override(data: dict[str, Any], override: str) -> None:
    """Put one ``key=value`` of the command line into plain settings.

    Raises UserError: not ``key=value``, an unknown key, a group given a value.
    """
    key, equals, text = override.partition("=")
    key = _in_full(key)
    if not equals or not key:
        near = f" Did you mean task={override}?" if override in shipped_names("tasks") else ""
        raise UserError(f"'{override}': expected key=value, such as trainer.max_time=00:10:00.{near}")
    keys = key.split(".")
    value = _from_here(keys, _value(type_of(key, override), text, override))
    for above in keys[:-1]:
        data = data.setdefault(above, {})
        if not isinstance(data, dict):
            raise UserError(f"'{override}': '{above}' is not a group of settings.")
    data[keys[-1]] = read_value(value) if key == "trainer.max_time" and str(value).startswith("{") else value
    if key == "trainer.max_time":
        _put_texts({"trainer": data})


def _in_full(name: str) -> str:
    """Return the name of a setting; a flag of Lightning's Trainer stands among plain ``trainer`` settings."""
    group, _, flag = name.partition(".")
    return f"trainer.flags.{flag}" if group == "trainer" and flag in TRAINER_FLAGS else name


def type_of(name: str, override: str) -> Any:
    """Return the type of the setting ``name``, Any for an option; raises UserError for none, as in the word ``override``."""
    name = _in_full(name)
    if name in all_settings():
        return all_settings()[name].type
    below = setting_names(f"{name}.")
    if below:
        raise UserError(f"'{override}': '{name}' holds settings: set one of them.{did_you_mean('', below)}")
    for setting in all_settings().values():
        if name.startswith(f"{setting.name}."):
            if typing.get_origin(setting.type) is dict:
                return Any
            raise UserError(f"'{override}': '{setting.name}' is one setting, with none below it.")
    keys = name.split(".")
    depth = next(depth for depth in range(len(keys)) if not setting_names(".".join(keys[: depth + 1]) + "."))
    valid = setting_names() if depth else [*_names_below(()), "resume"]
    raise UserError(f"'{override}': {_unknown('.'.join(keys[: depth + 1]), valid)}")


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


def _is_ready(init: str) -> bool:
    """Return whether a word is the name of a ready lifter, or one that may be, and not a run or a file here."""
    path = Path(init)
    if init in shipped_names("lifters"):
        return not path.is_file() and not holds_run(path)
    return len(path.parts) == 1 and not path.suffix and not path.exists()


def _from_here(keys: list[str], value: Any) -> Any:
    """Return a path of the command line, relative to the current folder, as absolute."""
    name = ".".join(keys)
    if not isinstance(value, str) or not value:
        return value
    if name in ("data.train", "data.test"):
        return absolute(value)
    if name == "init" and _is_ready(value):
        return value
    if (
        name in ("data.root", "data.images", "init")
        or (name == "data.labelled.file" and not re.fullmatch(r"\w+:\w+", value))  # SET:SPLIT is not a path
        or (name == "skeleton" and value.endswith((".yaml", ".yml")))
    ):
        return str(Path(value).expanduser().absolute())
    if name == "data.val" and not re.fullmatch(r"[\d.]+", value):
        return absolute(value)
    return _class_in(value, Path()) if keys[-1] == "use" or name in _CLASSES else value
