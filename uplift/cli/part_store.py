"""Parts of a long prediction that are kept beside its output until that is complete: a command that was ended goes on."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from uplift.config.files import replacing
from uplift.config.lock import only_one
from uplift.config.progress import say
from uplift.data.names import Names
from uplift.models.ground import Ground
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton

__all__ = ["PartStore", "digest_of", "stamps_of"]

_MANIFEST = "manifest.json"
_FACTS = ("unit", "fps", "image_size", "truth_unit", "axes", "source", "title", "notes")


class PartStore:
    """The folder ``.OUTPUT.parts``: a file for each part, and what they were made of.

    A context manager: parts of the same input, lifter and options are kept from the command before, all others are
    removed; at the end the folder goes, and stays where an exception ends it earlier. Raises UserError where another
    command is at work on the same output.
    """

    def __init__(self, output: str | Path, made_of: Mapping[str, Any], skeleton: Skeleton):
        output = Path(output)
        self.folder = output.with_name(f".{output.name}.parts")
        self._made_of = json.loads(json.dumps(made_of, default=str))
        self._skeleton = skeleton
        self._output, self._stack = output, ExitStack()

    def __enter__(self) -> PartStore:
        self.folder.mkdir(exist_ok=True)
        self._stack.enter_context(only_one(self.folder / "lock", str(self._output)))
        manifest = self.folder / _MANIFEST
        before: Any = None
        with suppress(OSError, ValueError):
            before = json.loads(manifest.read_bytes())
        kept = len(self)
        if before == self._made_of:
            if kept:
                say(f"going on: {kept:,} {'part is' if kept == 1 else 'parts are'} there from before ({self.folder})")
            return self
        if kept:
            was = before if isinstance(before, dict) else {}
            changed = [name for name, value in self._made_of.items() if was.get(name) != value]
            other = "other options" if changed == ["options"] else f"another {' and '.join(changed) or 'input'}"
            say(f"beginning anew: {other} than the parts in {self.folder} were made with")
        self.clear()
        with replacing(manifest) as file:
            file.write(json.dumps(self._made_of, indent=1).encode())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        kept = len(self)
        if kind is not None and kept:
            these = "1 part is" if kept == 1 else f"{kept:,} parts are"
            print(f"{these} kept in {self.folder}: the same command goes on from there", file=sys.stderr)
        if kind is None or not kept:
            shutil.rmtree(self.folder, ignore_errors=True)
        self._stack.close()

    def __len__(self) -> int:
        return len(self._files())

    def __contains__(self, number: object) -> bool:
        return isinstance(number, int) and self._path(number).is_file()

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob("[0-9]*.npz"))

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:06}.npz"

    def clear(self) -> None:
        """Remove all parts."""
        for part in self._files():
            part.unlink()

    def save(self, number: int, part: Prediction) -> None:
        """Keep a part; raises OSError for a full disk."""
        facts = {name: getattr(part, name) for name in _FACTS}
        arrays = _arrays(part) | {"facts": np.array(json.dumps(facts, default=float))}
        with replacing(self._path(number)) as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]

    def load(self, number: int) -> Prediction:
        """Return a part."""
        with np.load(self._path(number), allow_pickle=False) as file:
            arrays: dict[str, Any] = {name: file[name] for name in file.files}
        facts = json.loads(str(arrays.pop("facts")))
        facts |= {name: tuple(facts[name]) for name in ("image_size", "notes") if facts[name] is not None}
        groups: dict[str, dict[str, Any]] = {"identity": {}, "names": {}, "ground": {}}
        for name in [name for name in arrays if "." in name]:
            group, _, key = name.partition(".")
            groups[group][key] = arrays.pop(name)
        for key, names in groups["names"].items():
            groups["identity"][key] = Names(groups["identity"][key], names)
        ground = Ground(**groups["ground"]) if groups["ground"] else None
        names = tuple(self._skeleton.joints)
        return Prediction(
            **arrays, **facts, identity=groups["identity"], ground=ground, joint_names=names, skeleton=self._skeleton
        )


def _arrays(part: Prediction) -> dict[str, np.ndarray]:
    """Return all arrays of a part by name, those of a group as ``group.name``."""
    found: dict[str, np.ndarray] = {}
    for field in fields(part):
        value = getattr(part, field.name)
        if isinstance(value, np.ndarray):
            found[field.name] = value
        elif field.name == "identity":
            for key, column in value.items():
                named = isinstance(column, Names)
                found |= {f"identity.{key}": column.codes if named else np.asarray(column)}
                found |= {f"names.{key}": column.names} if named else {}
        elif field.name == "ground" and value is not None:
            found |= {f"ground.{key}": np.asarray(column) for key, column in vars(value).items()}
    return {name: array.astype(str) if array.dtype.kind == "O" else array for name, array in found.items()}


# What parts were made of.


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def stamps_of(paths: list[Path]) -> dict[str, list[int]]:
    """Return the size and time of change of files, and of those in folders, by their paths."""
    files = [
        file for path in paths for file in ([path] if path.is_file() else sorted(path.rglob("*"))) if file.is_file()
    ]
    return {os.path.realpath(file): [file.stat().st_size, file.stat().st_mtime_ns] for file in files}
