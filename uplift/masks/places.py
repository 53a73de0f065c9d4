"""The pictures that a user's paths mean, with a name and a category for each."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from uplift.masks.picture import ENDINGS
from uplift.readers.json_file import in_order

__all__ = ["Place", "pictures_of"]


@dataclass(frozen=True)
class Place:
    """Where one picture is."""

    path: Path
    name: str
    category: str
    """The sub-folder, or the folder where several were given."""


def pictures_of(paths: list[Path]) -> tuple[list[Place], list[str]]:
    """Return the pictures that paths name, folders with all their sub-folders, and the names of other files beside them.

    A file that is named is taken for a picture whatever its ending.
    """
    folders = [path for path in paths if path.is_dir()]
    found: list[Place] = []
    others: list[str] = []
    for path in paths:
        if not path.is_dir():
            found.append(Place(path, path.name if len(folders) == 0 else str(path), ""))
            continue
        for file in _files(path):
            inside = file.relative_to(path)
            if file.suffix.lower() not in ENDINGS:
                others.append(inside.as_posix())
                continue
            parts = (path.absolute().name, *inside.parts) if len(folders) > 1 else inside.parts
            found.append(Place(file, "/".join(parts), "/".join(parts[:-1])))
    return found, others


def _files(folder: Path) -> list[Path]:
    """Return the files in a folder and in those below it, their numbers in order; hidden ones left out."""
    found: list[Path] = []
    for at, folders, names in os.walk(folder):
        folders[:] = sorted((one for one in folders if not one.startswith((".", "__"))), key=in_order)
        found += [Path(at, name) for name in sorted(names, key=in_order) if not name.startswith(".")]
    return found
