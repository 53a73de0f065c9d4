"""The files that docs/examples.md prints, and the set that each of them is trained on."""

from __future__ import annotations

import re
from pathlib import Path

from benchmarks.machine import ROOT

__all__ = ["EXAMPLES", "PAGE", "files_of", "write_files"]

PAGE = ROOT / "docs" / "examples.md"

EXAMPLES = ("quadruped", "rat", "hand", "chair")
"""Folders of UPLIFT_DATA; the files of each are `my_NAME.yaml` and `my_NAME_task.yaml`."""

_FILE = re.compile(r"^```yaml\n(# (\w+\.yaml)\n.*?)^```$", re.M | re.S)


def files_of(page: Path = PAGE) -> dict[str, str]:
    """Return the page's files by name: its YAML blocks whose first line is ``# NAME.yaml``."""
    return {name: text for text, name in _FILE.findall(page.read_text())}


def write_files(name: str, folder: Path) -> Path:
    """Write the skeleton and the task of an example into ``folder``; returns the task's path."""
    files = files_of()
    for file in (f"my_{name}.yaml", f"my_{name}_task.yaml"):
        (folder / file).write_text(files[file])
    return folder / f"my_{name}_task.yaml"
