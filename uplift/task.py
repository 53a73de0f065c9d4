"""Turn a task file and ``key=value`` overrides into checked `Settings`."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml

from uplift.config import Settings
from uplift.errors import UserError, did_you_mean
from uplift.limits import check_settings
from uplift.overrides import hints_of, put_override
from uplift.paths import shipped, shipped_names
from uplift.yaml_file import read_yaml

__all__ = ["load_settings", "read_task", "save_settings", "task_path"]

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
    hints = hints_of(kind)
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
    for key, hint in hints_of(kind).items():
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
