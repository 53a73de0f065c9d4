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
from uplift.paths import shipped, shipped_names
from uplift.yaml_file import read_yaml

__all__ = ["load_settings", "read_task", "save_settings", "setting_names", "task_path"]

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
        _put(merged, _parse_override(override), override)
    settings = _typed(merged)
    _check(settings)
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
    raise UserError(f"No task '{task}'.{did_you_mean(task, names)} `uplift tasks` lists them; a file of your own ends in .yaml.")


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
        beside = path.parent / str(parent)
        found = beside if beside.suffix in (".yaml", ".yml") and beside.is_file() else task_path(str(parent))
        base = read_task(found, depth + 1)
    _check_keys(data, Settings, (), where)
    _bind_paths(data, path.parent)
    return _merge(base, data)


def _bind_paths(data: dict[str, Any], folder: Path) -> None:
    """Make the skeleton and the priors' files that a task file names relative to it absolute."""
    skeleton = data.get("skeleton")
    if isinstance(skeleton, str) and skeleton.endswith((".yaml", ".yml")):
        data["skeleton"] = str((folder / skeleton).absolute())
    specs = [spec for spec in (data.get("priors") or {}).values() if isinstance(spec, dict)]
    for holder, key in [*((spec, "use") for spec in specs), (data.get("lifter") or {}, "network")]:
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
    hints = typing.get_type_hints(kind)
    for key, value in data.items():
        if key not in hints:
            valid = [".".join((*above, name)) for name in hints]
            full = ".".join((*above, key))
            raise UserError(f"{where((*above, key))}: unknown setting '{full}'.{did_you_mean(full, valid)}")
        if dataclasses.is_dataclass(hints[key]):
            if not isinstance(value, dict):
                raise UserError(
                    f"{where((*above, key))}: '{'.'.join((*above, key))}' is {value!r}, expected settings below it."
                )
            _check_keys(value, hints[key], (*above, key), where)  # type: ignore[arg-type]


def _parse_override(override: str) -> tuple[list[str], Any]:
    key, equals, text = override.partition("=")
    if not equals or not key:
        raise UserError(f"'{override}': expected key=value, such as trainer.max_time=00:10:00.")
    try:
        value = yaml.safe_load(text) if text else None
    except yaml.YAMLError:
        value = text
    if not isinstance(value, (str, int, float, bool, list, dict, type(None))) or (":" in text and text[:1].isdigit()):
        value = text  # YAML 1.1 reads 00:10:00 as a number of base 60
    return key.split("."), value


def _put(data: dict[str, Any], keyed: tuple[list[str], Any], override: str) -> None:
    keys, value = keyed
    hints: Any = Settings
    for depth, key in enumerate(keys):
        if not dataclasses.is_dataclass(hints):
            break
        names = typing.get_type_hints(hints)
        if key not in names:
            full = ".".join(keys[: depth + 1])
            near = did_you_mean(full, setting_names() if depth else [*names, "resume"])
            raise UserError(f"Unknown setting '{full}' in '{override}'.{near}")
        hints = names[key]
    if dataclasses.is_dataclass(hints) and not isinstance(value, dict):
        raise UserError(f"'{override}': '{'.'.join(keys)}' holds settings: set one of them.{did_you_mean('', setting_names(keys[0]))}")
    if typing.get_origin(hints) in (list, tuple) and not isinstance(value, list):
        value = [] if value is None else str(value).split(",")
    value = _from_here(keys, value)
    for key in keys[:-1]:
        data = data.setdefault(key, {})
        if not isinstance(data, dict):
            raise UserError(f"'{override}': '{key}' is not a group of settings.")
    data[keys[-1]] = value


def _from_here(keys: list[str], value: Any) -> Any:
    """Return a path of the command line as absolute: it is relative to the current folder."""
    name = ".".join(keys)
    if not isinstance(value, str) or not value:
        return value
    if name in ("data.train", "data.test", "data.root", "init"):
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
        for name, hint in typing.get_type_hints(kind).items():
            names += walk(hint, f"{prefix}{name}.") if dataclasses.is_dataclass(hint) else [f"{prefix}{name}"]  # type: ignore[arg-type]
        return names

    return [name for name in walk(Settings, "") if name.startswith(below)]


def _typed(merged: dict[str, Any]) -> Settings:
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

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


def _escape(value: Any) -> Any:
    """Keep OmegaConf from reading ``${...}`` in a user's text as an interpolation."""
    if isinstance(value, dict):
        return {key: _escape(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_escape(inner) for inner in value]
    return value.replace("${", "\\${") if isinstance(value, str) else value


def _check(settings: Settings) -> None:
    """Refuse values that no type can: names, ranges, contradictions."""
    _one_of("lifter.tilt", settings.lifter.tilt, ("predicted", "learned", "level"))
    _one_of("lifter.radius", settings.lifter.radius, ("all", "without_root"))
    _one_of("lifter.camera", settings.lifter.camera, ("orthographic", "perspective"))
    if settings.data.unit is not None:
        _one_of("data.unit", settings.data.unit, ("mm", "relative"))
    _one_of("lifter.intrinsics", settings.lifter.intrinsics, ("auto", "off"))
    _in_range("lifter.distance", settings.lifter.distance, 2, 1e4)
    _one_of("views.elevation", settings.views.elevation, ("batch", "normal", "same"))
    settings.views.count_root = settings.lifter.radius == "all"
    for name, stage in (("teacher", settings.teacher), ("student", settings.student)):
        _in_range(f"{name}.share", stage.share, 0, float("inf"))
        _in_range(f"{name}.batch_size", stage.batch_size, 2, 1 << 20)
        _in_range(f"{name}.learning_rate", stage.learning_rate, 1e-12, 10)
        _in_range(f"{name}.hide", stage.hide, 0, 0.9)
        _in_range(f"{name}.beta1", stage.beta1, 0, 0.99999)
        _in_range(f"{name}.beta2", stage.beta2, 0, 0.9999999)
        if stage.average is not None:
            _in_range(f"{name}.average", stage.average, 0, 0.999999)
    if settings.teacher.share <= 0:
        raise UserError("teacher.share is 0: the first stage cannot be left out.")
    trainer = settings.trainer
    if trainer.max_time is None and trainer.max_steps is None and trainer.max_epochs is None:
        raise UserError("Set one of trainer.max_time, trainer.max_steps, trainer.max_epochs: the fit would never end.")
    for key in ("max_steps", "max_epochs", "threads", "checkpoint_steps"):
        value = getattr(trainer, key)
        if value is not None:
            _in_range(f"trainer.{key}", value, 1 if key != "max_epochs" else 1e-9, 10**12)
    _in_range("trainer.log_every", trainer.log_every, 1, 10**9)
    _in_range("data.simulate", settings.data.simulate, 0, 10**8)
    if not 0 <= settings.seed < 2**31:
        raise UserError(f"seed={settings.seed}: expected a whole number from 0 to {2**31 - 1}.")


def _one_of(name: str, value: str, valid: tuple[str, ...]) -> None:
    if value not in valid:
        raise UserError(f"{name}={value!r}: expected one of {', '.join(valid)}.{did_you_mean(value, valid)}")


def _in_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise UserError(f"{name}={value}: expected a number from {low:g} to {high:g}.")


def save_settings(settings: Settings, path: Path) -> None:
    """Write all settings, resolved, as a task file that can be used again."""
    path.write_text(yaml.safe_dump(dataclasses.asdict(settings), sort_keys=False, allow_unicode=True))
