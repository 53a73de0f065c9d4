"""Read a YAML file as plain data with the line of every part; nothing in it can run or grow without limit."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from uplift.errors import UserError

__all__ = ["Where", "read_value", "read_yaml"]

Where = Callable[[tuple], str]
"""Names the file and line of a part, such as ``("bones", 3)``."""

MAX_BYTES = 1_000_000
MAX_DEPTH = 20
MAX_VALUES = 60_000
MAX_INTEGER = 2**63

_TAG = "tag:yaml.org,2002:"
_PLAIN = {"str", "int", "float", "bool", "null", "timestamp", "map", "seq"}


class _Refused(Exception):
    """What is wrong with the YAML, and its 0-based line."""

    def __init__(self, problem: str, line: int) -> None:
        super().__init__(problem)
        self.line = line


class _Loader(yaml.SafeLoader):
    """A safe loader that refuses aliases, deep nesting and tags while it composes."""

    depth = 0
    values = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()
        line, tag = event.start_mark.line, getattr(event, "tag", None)
        self.values += 1
        if isinstance(event, yaml.AliasEvent):
            raise _Refused(f"an alias (*{event.anchor}); write the value out instead", line)
        if self.depth >= MAX_DEPTH:
            raise _Refused(f"values nested more than {MAX_DEPTH} deep", line)
        if tag not in (None, "!") and tag.removeprefix(_TAG) not in _PLAIN:
            raise _Refused(f"the YAML tag '{tag}'; only plain text, numbers, lists and mappings", line)
        if self.values > MAX_VALUES:
            raise _Refused(f"more than {MAX_VALUES:,} values", line)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


# YAML 1.1 reads 1e-3 as text; users mean the number.
_Loader.add_implicit_resolver(
    _TAG + "float", re.compile(r"^[-+]?(?:\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)

# YAML 1.1 reads 1:00:00 in base 60 and 017 in base 8; users mean a duration and a name.
_NOT_A_NUMBER = re.compile(r"[-+]?(\d+:|0\d)")


def read_value(text: str) -> Any:
    """Return the plain data of one value, such as ``0.1`` or ``[hip, nose]``; ``text`` where it is not YAML.

    Raises UserError: tags, aliases, or deep nesting.
    """
    try:
        return _parsed(text, {})
    except _Refused as refused:
        raise UserError(f"'{text[:60]}': found {refused}.") from None
    except yaml.YAMLError:
        return text


def read_yaml(path: Path, kind: str) -> tuple[Any, Where]:
    """Return the plain data of a YAML file and a function that names the file and line of a part.

    ``kind`` is what the file should hold, for the messages. Raises UserError for a file that is
    missing, not a regular file, unreadable, over 1 MB, not text, empty, not YAML, or that holds tags,
    aliases or a key twice.
    """
    text = _read_text(path, kind)
    lines: dict[tuple, int] = {}
    try:
        data = _parsed(text, lines)
    except _Refused as refused:
        raise UserError(f"{path}, line {refused.line + 1}: found {refused}. A {kind} file holds plain YAML.") from None
    except yaml.MarkedYAMLError as error:
        mark, problem = error.problem_mark or error.context_mark, error.problem or error.context
        line = mark.line + 1 if mark else 1
        raise UserError(f"{path}, line {line}: not YAML: {problem}. {_syntax_hint(error)}") from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise UserError(f"{path}, line {line}: not a text file: found a control character ({error.reason}).") from None
    if not lines:
        raise UserError(f"{path}, line 1: the file is empty; expected a {kind} in YAML.")

    def where(part: tuple) -> str:
        while part not in lines:
            part = part[:-1]
        return f"{path}, line {lines[part] + 1}"

    return data, where


def _parsed(text: str, lines: dict[tuple, int]) -> Any:
    """Return the plain data and note the line of each part; None and no lines for an empty text."""
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        return None if node is None else _plain(node, loader, (), lines)
    finally:
        loader.dispose()


def _syntax_hint(error: yaml.MarkedYAMLError) -> str:
    problem = str(error.problem)
    if "'\\t'" in problem:
        return "Indent with spaces, not tabs."
    if "expected ',' or" in problem:
        return "A bracket or a comma is missing on this line or above it."
    if "single document" in str(error.context):
        return "Keep one document in the file."
    return "Look for a missing colon, quote or bracket there or on the line above."


def _read_text(path: Path, kind: str) -> str:
    if not path.is_file():
        found = "found a folder" if path.is_dir() else "not a regular file" if path.exists() else "no such file"
        raise UserError(f"{path}: {found}; expected a {kind} file (YAML).")
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}).") from None
    if len(raw) > MAX_BYTES:
        size_mb = path.stat().st_size / 1e6
        raise UserError(f"{path}: {size_mb:.1f} MB is too large for a {kind} (at most {MAX_BYTES / 1e6:.0f} MB).")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise UserError(f"{path}, line {line}: not a text file (UTF-8); expected a {kind} in YAML.") from None


def _plain(node: Any, loader: _Loader, part: tuple, lines: dict[tuple, int]) -> Any:
    """Return the plain data under ``node`` and note the line of each part."""
    lines[part] = node.start_mark.line
    if isinstance(node, yaml.SequenceNode):
        return [_plain(child, loader, (*part, place), lines) for place, child in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode):
        return _plain_mapping(node, loader, part, lines)
    if node.tag in (_TAG + "str", _TAG + "timestamp", "!") or _NOT_A_NUMBER.match(node.value):
        return node.value
    try:
        value = loader.construct_object(node)
    except Exception:  # whatever PyYAML raises: IndexError for !!int ""
        kind = node.tag.removeprefix(_TAG)
        raise _Refused(f"'{node.value[:40]}', which is not a valid {kind}", node.start_mark.line) from None
    if isinstance(value, int) and abs(value) > MAX_INTEGER:  # larger ones are no float, or endless work
        raise _Refused(f"a whole number of {len(str(value))} digits, too large for any setting", node.start_mark.line)
    return value


def _plain_mapping(node: Any, loader: _Loader, part: tuple, lines: dict[tuple, int]) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for key, value in node.value:
        line = key.start_mark.line
        if not isinstance(key, yaml.ScalarNode) or key.tag != _TAG + "str":
            shown = f"'{key.value[:40]}'" if isinstance(key, yaml.ScalarNode) else "a list or mapping"
            raise _Refused(f"the key {shown}; keys are text (quote it if it is a name)", line)
        if key.value in plain:
            raise _Refused(f"the key '{key.value}' twice (first on line {lines[*part, key.value] + 1})", line)
        plain[key.value] = _plain(value, loader, (*part, key.value), lines)
        lines[*part, key.value] = line
    return plain
