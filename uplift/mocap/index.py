"""The index of the CMU data base: what is done in each motion."""

from __future__ import annotations

import re
from pathlib import Path

from uplift.errors import UserError
from uplift.mocap.text import read_lines

__all__ = ["read_index"]

_LINE = re.compile(r"(\d{1,3})_(\d{1,3}[a-z]?)(?:\.\w+)?[\t ,;]+(\S.*)")


def read_index(path: Path) -> dict[str, str]:
    """Return the description of each motion: lines such as ``02_01<tab>walk``, anything else in between.

    Raises:
        UserError: no such file, or none of its lines describes a motion.
    """
    if not path.is_file():
        raise UserError(f"No index file {path}.")
    found: dict[str, str] = {}
    for line in read_lines(path, "an index of motions"):
        match = _LINE.match(line.decode("utf-8", "replace").strip().lstrip("\ufeff"))
        if match:
            subject, trial, text = match.groups()
            found[f"{int(subject):02d}_{trial.zfill(2)}"] = text.strip().strip('"')
    if not found:
        raise UserError(f"{path}: no line describes a motion. Expected lines such as: 02_01, a tab, walk.")
    return found
