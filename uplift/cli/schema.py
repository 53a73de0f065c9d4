"""The verb schema: JSON schemas of task and skeleton files, with which editors complete and check them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from uplift.cli.help import option_settings
from uplift.cli.parsing import keyed
from uplift.config.files import refuse_output, replacing
from uplift.config.plugins import find_class, options_of
from uplift.config.schema import task_schema
from uplift.errors import UserError
from uplift.skeleton.schema import skeleton_schema

__all__ = ["full_task_schema", "write_skeleton_schema", "write_task_schema"]


def full_task_schema() -> dict[str, Any]:
    """Return the JSON schema of task files with the options of all built-in priors and networks."""
    from uplift.models.networks import NETWORKS
    from uplift.priors import PRIORS

    classes = {name: find_class(name, PRIORS, "priors") for name in PRIORS}
    priors = {
        name: None if options_of(found) is None else option_settings(found, ("skeleton",))
        for name, found in classes.items()
    }
    networks = {name: option_settings(find_class(name, NETWORKS, "lifter"), ("inputs", "outputs")) for name in NETWORKS}
    return task_schema(priors, networks)


def write_task_schema(words: list[str]) -> list[str]:
    """Write the schema of task files and return the lines to print."""
    return _write("task", keyed("schema task", words).value("output"), full_task_schema)


def write_skeleton_schema(words: list[str]) -> list[str]:
    """Write the schema of skeleton files and return the lines to print."""
    return _write("skeleton", keyed("schema skeleton", words).value("output"), skeleton_schema)


def _write(kind: str, output: str, schema: Any) -> list[str]:
    path = Path(output).expanduser()
    if path.suffix.lower() != ".json":
        raise UserError(f"output={output}: a schema is a .json file, such as {kind}.schema.json.")
    refuse_output(path)
    text = json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"
    with replacing(path) as file:
        file.write(text.encode())
    return [
        f"wrote {path}: editors complete and check {kind} files with it (VS Code: the extension YAML by Red Hat)",
        f"next: put this line on top of a {kind} file beside it, with the full path where the file is elsewhere:",
        f"# yaml-language-server: $schema={path.name}",
    ]
