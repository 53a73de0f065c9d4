"""A user's own format: the class to subclass for keypoints, and what it reads checked as the content of any file is."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from uplift.config.plugins import blame, build, find_class, line_of
from uplift.data.concat import concat_poses
from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.npz import poses_of
from uplift.data.formats.rows import honest
from uplift.data.poses import IDENTITY_KEYS, PoseData
from uplift.errors import UserError, did_you_mean

__all__ = ["Format", "Made", "OwnFormat", "made_of", "own_format", "own_keypoints"]


class OwnFormat:
    """What a user's formats of keypoints and of masks share."""

    title: ClassVar[str] = ""
    """What it is, in a few words; unset: the first line of the class's docstring."""
    ending: ClassVar[str] = ""
    """Such as ``.txt``: the files of a folder that end so are read one by one and joined; unset: `read` gets the folder."""

    def read(self, path: Path, options: Any) -> Any:
        """Return what the file or folder holds."""
        raise NotImplementedError(f"{type(self).__name__} has no read(self, path, options)")


class Format(OwnFormat):
    """Subclass this, write `read`, and name the class: ``format=my_reader.py:MyFormat``, ``data.format=`` in a fit.

    The class is made without arguments.
    """

    def read(self, path: Path, options: ReadOptions) -> PoseData:
        """Return the keypoints of a file or folder, which is there, in the file's own joints, by name.

        What the user says about the file (``options``) is put in the place of what it says afterwards.
        """
        return super().read(path, options)


# A class that was found and made: which files it is given, and errors that name it.


@dataclass(frozen=True)
class Made:
    """A user's format, ready to read."""

    maker: OwnFormat
    name: str
    """As the user gave it: ``file.py:Class`` or ``package.module:Class``."""
    ending: str

    @property
    def title(self) -> str:
        """What it is, and which class."""
        found = type(self.maker)
        words = found.title or (found.__doc__ or "").strip().partition("\n")[0].rstrip(". ") or found.__name__
        return f"{words} ({self.short})"

    @property
    def short(self) -> str:
        """The name without the folder of the file."""
        file, _, name = self.name.rpartition(":")
        return f"{Path(file).name if file.endswith('.py') else file}:{name}"

    def files(self, paths: Sequence[Path]) -> list[Path]:
        """Return what is read one by one: the paths, and of folders the files that end as the format says.

        Raises:
            UserError: a folder without such a file.
        """
        found: list[Path] = []
        for path in paths:
            if not self.ending or not path.is_dir():
                found.append(path)
                continue
            inside = sorted(one for one in path.iterdir() if not one.name.startswith("."))
            right = [one for one in inside if one.is_file() and one.name.lower().endswith(self.ending)]
            if not right:
                names = ", ".join(one.name for one in inside[:3]) + (", ..." if len(inside) > 3 else "")
                what = f"in it: {names}" if inside else "it is empty"
                raise UserError(f"{path} has no files that end with {self.ending}, which {self.short} reads ({what}).")
            found += right
        return found

    def where(self, path: Path) -> str:
        """Return what errors in what was read begin with."""
        return f"{path}, as {self.short} read it"

    def run(self, path: Path, step: Callable[[], Any]) -> Any:
        """Return what a step of reading ``path`` gives; an error in it names the user's file and line, and ``path``."""
        found = type(self.maker)
        try:
            with blame(f"{path}: {found.__name__}.read", found):
                return step()
        except UserError as error:
            if str(path) in str(error):
                raise
            raise UserError(f"{path}: {found.__name__}.read, in {line_of(error, found)}: {error}") from error


def own_format(name: str, where: str, kind: type[OwnFormat], read: Callable[[Made, Peek, Any], Any]) -> FileFormat:
    """Return the format that a user's class, a subclass of ``kind``, makes of ``read``.

    Raises:
        UserError: as `made_of`.
    """
    made = made_of(name, where, kind)
    return FileFormat(name, made.title, lambda _: False, lambda peek, options: read(made, peek, options), made.ending)


def made_of(name: str, where: str, kind: type[OwnFormat]) -> Made:
    """Return the format of the class that ``name``, in the option ``where``, says.

    Raises:
        UserError: no such file or class, a class of another kind, without `read`, or that cannot be made without arguments.
    """
    found = find_class(name, {}, where)
    if issubclass(found, OwnFormat) and not issubclass(found, kind):
        other, wanted = (f"uplift.{one.__name__}" for one in (found.__mro__[found.__mro__.index(OwnFormat) - 1], kind))
        raise UserError(f"{where}={name}: {found.__name__} is a {other}, expected a {wanted} here.")
    if issubclass(found, kind):
        _check_class(found, kind, f"{where}={name}")
    maker = build(name, {}, {}, where, kind)
    ending = found.ending.lower()
    return Made(maker, name, ending if ending.startswith(".") or not ending else f".{ending}")


def _check_class(found: type[OwnFormat], kind: type[OwnFormat], where: str) -> None:
    """Refuse a class that cannot be made as it is, or has nothing to read with."""
    if found.read is kind.read:
        raise UserError(f"{where}: {found.__name__} has no method read(self, path, options).")
    for name in ("title", "ending"):
        value = getattr(found, name)
        if not isinstance(value, str):
            raise UserError(f"{where}: {found.__name__}.{name} is {value!r}, expected text.")
    for parameter in inspect.signature(found).parameters.values():
        several = parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
        if parameter.default is parameter.empty and not several:
            raise UserError(
                f"{where}: {found.__name__}.__init__ needs '{parameter.name}', but formats are made without arguments: "
                "give it a default."
            )


# Keypoints.


def own_keypoints(name: str, where: str) -> FileFormat[ReadOptions, PoseData]:
    """Return the format of keypoints that a user's class makes; raises UserError as `made_of`."""
    return own_format(name, where, Format, _read)


def _read(made: Made, peek: Peek, options: ReadOptions) -> PoseData:
    parts = []
    for path in made.files(peek.paths):
        data = made.run(path, lambda path=path: made.maker.read(path, options))
        if not isinstance(data, PoseData):
            found = "nothing" if data is None else f"{type(data).__name__}"
            raise UserError(
                f"{made.where(path)}: {type(made.maker).__name__}.read returned {found}, expected "
                "uplift.PoseData(keypoints, confidence, joint_names)."
            )
        parts.append(made.run(path, lambda path=path, data=data: _checked(data, path, made.where(path))))
        if parts[-1].joint_names != parts[0].joint_names:
            these, those = (", ".join(part.joint_names[:6]) for part in (parts[-1], parts[0]))
            raise UserError(f"{made.where(path)}: its joints are {these}, those of {parts[0].source} {those}.")
    return concat_poses(parts)


def _checked(data: PoseData, path: Path, where: str) -> PoseData:
    """Return what was read as what a file of this project would hold, with what it does not have: lines, lenses, notes.

    Raises:
        UserError: what a file would be refused for, no frame, or no visible keypoint.
    """
    if len(set(data.joint_names)) < len(data.joint_names) or not data.joint_names:
        wrong = [name for name in data.joint_names if data.joint_names.count(name) > 1]
        raise UserError(f"{where}: " + (f"it names '{wrong[0]}' twice; names must differ." if wrong else "no joints."))
    found = poses_of(where, _arrays(data, where))
    keypoints, confidence = honest(found.keypoints, found.confidence)
    if not (confidence > 0).any():
        rows = f"no keypoint in {len(found):,} frames is visible: all are NaN, infinite or of confidence 0"
        raise UserError(f"{where}: {rows if len(found) else 'no frames'}.")
    return replace(
        found,
        stills=bool(data.stills),
        lenses=tuple(data.lenses),
        lens=_lens(data, where),
        keypoints=keypoints,
        confidence=confidence,
        bones=_pairs(data, "bones", where),
        mirror=_pairs(data, "mirror", where),
        notes=(data.notes,) if isinstance(data.notes, str) else tuple(map(str, data.notes)),
        source=str(path),
    )


_APART = {"stills", "lenses", "lens", "bones", "mirror", "notes", "source", "identity"}
"""Fields that are no arrays of a file of this project."""
_NEVER = {"root_filled", "labelled"}
"""Fields that settings decide, whatever a reader says."""


def _arrays(data: PoseData, where: str) -> dict[str, np.ndarray]:
    """Return the fields by the names that they have in a file of this project."""
    for key in data.identity:
        if key not in IDENTITY_KEYS:
            raise UserError(f"{where}: identity['{key}'] is not known.{did_you_mean(str(key), IDENTITY_KEYS)}")
    names = {one.name for one in fields(data)} - _APART - _NEVER
    given = {name: getattr(data, name) for name in names if getattr(data, name) is not None}
    if data.pose is None and data.root is None:
        given.pop("unit")
    return {name: np.asarray(value) for name, value in given.items()} | data.identity


def _lens(data: PoseData, where: str) -> np.ndarray | None:
    """Return which of the lenses saw each frame; raises UserError for one that is not there."""
    if data.lens is None:
        return None
    lens, count = np.asarray(data.lens), len(data.lenses)
    if lens.dtype.kind not in "iu" or (lens.size and not (lens.min() >= 0 and lens.max() < count)):
        raise UserError(f"{where}: 'lens' holds {lens[:3]}, expected places in 'lenses' below {count}.")
    return lens


def _pairs(data: PoseData, field: str, where: str) -> tuple[tuple[str, str], ...]:
    """Return the pairs of joints of a field as text; raises UserError for anything but pairs of known names."""
    pairs = []
    for pair in getattr(data, field):
        names = () if isinstance(pair, str) else tuple(map(str, pair))
        if len(names) != 2 or not set(names) <= set(data.joint_names):
            raise UserError(f"{where}: '{field}' holds {pair!r}, expected pairs of its joint names.")
        pairs.append(names)
    return tuple(pairs)
