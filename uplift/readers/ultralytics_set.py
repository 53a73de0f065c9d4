"""What stands around Ultralytics' label files: their folder and data.yaml."""

from __future__ import annotations

import heapq
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uplift.errors import UserError
from uplift.readers.base import ReadOptions
from uplift.readers.json_file import in_order, is_text, shown
from uplift.readers.layouts import COCO, names_for

__all__ = ["Description", "describe", "first_labels", "label_files"]

_NO_LABELS = ("classes.txt", "labels.txt", "notes.txt")
_LEVELS = 3


def label_files(path: Path) -> list[Path]:
    """Return a file itself, or the label files of a folder, or of labels/ in it, with their numbers in order.

    Raises:
        UserError: none there.
    """
    if not path.is_dir():
        return [path]
    for folder in (path, path / "labels"):
        found = [folder / name for name in _label_names(folder)]
        if found:
            return sorted(found, key=lambda one: in_order(one.name))
    raise UserError(f"{path} has no *.txt in it, nor in labels/ below it.")


def first_labels(path: Path, most: int) -> list[Path]:
    """Return the first label files, by name, of a folder or of labels/ in it; never an exception."""
    for folder in (path, path / "labels"):
        try:
            found = heapq.nsmallest(most, _label_names(folder))
        except OSError:
            continue
        if found:
            return [folder / name for name in found]
    return []


def _label_names(folder: Path) -> Iterator[str]:
    for one in os.scandir(folder) if folder.is_dir() else []:
        name = one.name.lower()
        if name.endswith(".txt") and name not in _NO_LABELS and not name.startswith((".", "readme")) and one.is_file():
            yield one.name


@dataclass
class Description:
    """What data.yaml says of the labels."""

    path: Path | None = None
    shape: tuple[int, int] | None = None
    classes: dict[int, str] = field(default_factory=dict)
    partners: list[int] = field(default_factory=list)
    names: tuple[str, ...] | None = None

    def names_of(self, path: Path, count: int, options: ReadOptions, notes: list[str]) -> tuple[str, ...]:
        """Return the names of the keypoints; raises UserError where data.yaml has another number of them."""
        if self.names is None or options.layout is not None:
            names, told = names_for(path, count, {17: COCO[17]}, options)
            notes += told
            return names
        if len(self.names) != count:
            raise UserError(f"{self.path}: kpt_names are {len(self.names)}, the labels have {count} keypoints.")
        return self.names

    def mirror(self, names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
        """Return the pairs that flip_idx swaps."""
        other = self.partners
        if len(other) != len(names) or not all(place < len(names) for place in other):
            return ()
        return tuple((names[a], names[b]) for a, b in enumerate(other) if a < b and other[b] == a)

    def categories(self, classes: np.ndarray) -> np.ndarray | None:
        """Return (rows,) names of classes where there are several; None otherwise."""
        found = np.unique(classes)
        if len(found) < 2 and len(self.classes) < 2:
            return None
        names = np.array([self.classes.get(int(one), str(int(one))) for one in found])
        return names[np.searchsorted(found, classes)]


def describe(folder: Path) -> Description:
    """Return what the data.yaml of a folder of labels says, which stands beside it or up to two folders above.

    Raises:
        UserError: a data.yaml that has kpt_shape and is damaged.
    """
    here = folder.absolute()
    for place in [here, *here.parents][:_LEVELS]:
        for path in sorted([*place.glob("*.yaml"), *place.glob("*.yml")]):
            if _mentions_shape(path):
                return _description(path)
    return Description()


def _mentions_shape(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_size < 1_000_000 and b"kpt_shape" in path.read_bytes()
    except OSError:
        return False


def _description(path: Path) -> Description:
    data = _plain_yaml(path)
    shape = _whole_numbers(data.get("kpt_shape"))
    if len(shape) != 2 or not 0 < shape[0] < 100_000 or shape[1] not in (2, 3):
        raise UserError(f"{path}: kpt_shape is {shown(shape or data.get('kpt_shape'))}, expected [keypoints, 2 or 3].")
    classes, names = data.get("names"), data.get("kpt_names")
    if isinstance(names, dict):  # by class
        names = next(iter(names.values()), None)
    if isinstance(classes, list):
        classes = {str(number): name for number, name in enumerate(classes)}
    classes = classes if isinstance(classes, dict) else {}
    return Description(
        path=path,
        shape=(shape[0], shape[1]),
        classes={
            int(n): str(name)[:200] for n, name in classes.items() if is_text(name) and re.fullmatch("[0-9]{1,6}", n)
        },
        partners=_whole_numbers(data.get("flip_idx")),
        names=tuple(names) if isinstance(names, list) and names and all(map(is_text, names)) else None,
    )


def _plain_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file, all values as text: nothing is built, and nothing merged."""
    import yaml

    try:
        data = yaml.load(path.read_text(encoding="utf-8-sig"), yaml.BaseLoader)
    except (yaml.YAMLError, OSError, UnicodeDecodeError, RecursionError) as error:
        said = " ".join(str(error).split())[:160]
        raise UserError(f"{path} mentions kpt_shape and cannot be read as YAML: {said}") from None
    except (TypeError, ValueError):
        raise UserError(f"{path} mentions kpt_shape and is no plain YAML: a key that is no text.") from None
    if not isinstance(data, dict) or not all(isinstance(key, str) for key in data):
        raise UserError(f"{path} mentions kpt_shape and is no mapping, expected Ultralytics' description of labels.")
    return data


def _whole_numbers(values: Any) -> list[int]:
    """Return a list of whole numbers; nothing where it is none."""
    if not isinstance(values, list) or not all(isinstance(v, str) and re.fullmatch("[0-9]{1,9}", v) for v in values):
        return []
    return [int(value) for value in values]
