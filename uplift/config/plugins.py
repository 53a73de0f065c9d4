"""Turn ``name``, ``file.py:Class`` or ``package.module:Class`` plus options into an object."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from uplift.config.trust import place_of, require
from uplift.errors import UserError, did_you_mean

__all__ = ["blame", "build", "find_class", "line_of", "options_of", "users_line"]

_USERS = "uplift_user_"
"""Beginning of the names of modules that are files of users."""
_PACKAGE = Path(__file__).resolve().parents[1]
Kind = TypeVar("Kind")


def build(
    use: str,
    builtin: Mapping[str, str],
    options: Mapping[str, Any],
    where: str,
    kind: type[Kind],
    *,
    setting: str | None = None,
    **given: Any,
) -> Kind:
    """Return an instance of the class that ``use`` names, a subclass of ``kind``, with ``given`` and the user's ``options``.

    Raises UserError: no such name, file or class, not a subclass of ``kind``, an option that the class does
    not take or that is of another kind than its default, an argument without a default that
    was not given, or a user's ``__init__`` that fails.
    """
    found = find_class(use, builtin, setting or f"{where}.use")
    if not issubclass(found, kind):
        package = kind.__module__.partition(".")[0] + (".nn" if kind.__module__.startswith("torch.nn") else "")
        raise UserError(f"{where}: '{use}' is not a subclass of {package}.{kind.__name__}.")
    parameters = inspect.signature(found).parameters
    for name in given:
        if name not in parameters and options_of(found) is not None:
            raise UserError(f"{where}: {found.__name__}.__init__ must take an argument called '{name}'.")
    _check_kinds(found, options, where)
    allowed = options_of(found, skip=tuple(given))
    if allowed is not None:
        for name in options:
            if name not in allowed:
                raise UserError(f"{where}.{name}: '{use}' takes no such option.{did_you_mean(name, allowed)}")
    for name, parameter in parameters.items():
        several = parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
        if name not in options and name not in given and parameter.default is parameter.empty and not several:
            raise UserError(f"{where}: '{use}' needs the option '{name}': set {where}.{name}=...")
    with blame(f"{where}: {found.__name__}.__init__", found):
        return found(**given, **options)


@contextmanager
def blame(what: str, found: type) -> Iterator[None]:
    """Turn an error in a method of a user's class, ``what`` for the message, into a `UserError` that names file and line."""
    try:
        yield
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        if found.__module__.startswith("uplift."):
            raise
        kind = type(error).__name__
        raise UserError(f"{what} failed in {line_of(error, found)}: {kind}: {error}".rstrip(": ")) from error


def users_line(error: BaseException) -> str | None:
    """Return the last line of a user's plug-in file that an error went through; None where it went through none."""
    files = {getattr(module, "__file__", None) for name, module in sys.modules.items() if name.startswith(_USERS)}
    found = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename in files]
    return f"{found[-1].filename}, line {found[-1].lineno}" if found else None


def line_of(error: BaseException, found: type) -> str:
    """Return the line of the user's file that an error came from: the last one in the file of the class, else the first elsewhere."""
    file = getattr(sys.modules.get(found.__module__), "__file__", None) or found.__module__
    trace = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in trace if frame.filename == file]
    theirs = [
        frame
        for frame in trace
        if _PACKAGE not in Path(frame.filename).resolve().parents and "site-packages" not in frame.filename
    ]
    # A method with wrong arguments fails in the package's frames alone.
    last = (own or theirs[:1] or [None])[-1]
    return f"{found.__name__} of {file}" if last is None else f"{last.filename}, line {last.lineno}"


def _check_kinds(found: type, options: Mapping[str, Any], where: str) -> None:
    """Refuse an option whose kind is not that of its default, or a whole number out of the class's ``ranges``, if it has any."""
    number = ("a number", (int, float))
    kinds = {bool: ("true or false", (bool,)), int: number, float: number, str: ("text", (str,))}
    for name, parameter in inspect.signature(found).parameters.items():
        expected, kind = kinds.get(type(parameter.default), ("", ()))
        value = options.get(name, parameter.default)
        if expected and (not isinstance(value, kind) or (isinstance(value, bool) and kind != (bool,))):
            raise UserError(f"{where}.{name}={value!r}: expected {expected}, such as {parameter.default!r}.")
    for name, (low, high) in getattr(found, "ranges", {}).items():
        value = options.get(name, low)
        if not isinstance(value, int) or not low <= value <= high:
            raise UserError(f"{where}.{name}={value!r}: expected a whole number from {low:,} to {high:,}.")


def find_class(use: str, builtin: Mapping[str, str], setting: str) -> type:
    """Return the class that ``use`` names: a built-in, or ``file.py:Class``, or ``package.module:Class``.

    ``setting`` is the name of the setting, for messages.

    Raises UserError: there is no such class, or the user did not consent to its code (`uplift.config.trust`).
    """
    target = builtin.get(use, use)
    if ":" not in target:
        none = f"no such built-in.{did_you_mean(use, builtin)} Your own is named" if builtin else "expected"
        raise UserError(f"{setting}={use!r}: {none} file.py:Class or package.module:Class.")
    module_name, _, class_name = target.rpartition(":")
    if module_name.endswith(".py") and not Path(module_name).expanduser().is_file():
        raise UserError(f"{setting}: no file {Path(module_name).expanduser().absolute()}.")
    if target not in builtin.values():
        require({setting: use})
    module = (
        _load_file(place_of(target), setting) if module_name.endswith(".py") else _load_module(module_name, setting)
    )
    found = getattr(module, class_name, None)
    if not isinstance(found, type):
        classes = [name for name, value in vars(module).items() if isinstance(value, type)]
        raise UserError(f"{setting}={use!r}: no class '{class_name}' there.{did_you_mean(class_name, classes)}")
    return found


def options_of(found: type, skip: tuple[str, ...] = ()) -> dict[str, Any] | None:
    """Return the options that ``found`` takes with their defaults; None if it takes any (``**kwargs``)."""
    parameters = inspect.signature(found).parameters
    if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        return None
    return {name: p.default for name, p in parameters.items() if name not in skip}


def _load_file(name: str, setting: str) -> ModuleType:
    path = Path(name)
    key = f"{_USERS}{abs(hash(str(path)))}_{path.stem}"
    if key in sys.modules:
        return sys.modules[key]
    spec = importlib.util.spec_from_file_location(key, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[key] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[key]
        raise UserError(f"{setting}: {path} does not run: {type(error).__name__}: {error}") from error
    return module


def _load_module(name: str, setting: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except (Exception, SystemExit) as error:  # whatever a user's module raises on import
        raise UserError(f"{setting}: cannot import '{name}': {type(error).__name__}: {error}") from error
