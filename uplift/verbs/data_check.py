"""The verb data check: which files a task needs, which are there, and what they cost to load."""

from __future__ import annotations

import shlex
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uplift.config import Settings
from uplift.data.container import IDENTITY_KEYS
from uplift.data.load import find_data, named_set
from uplift.data.missing import how_to_get
from uplift.datasets import DataSet
from uplift.datasets.cache import cached_facts
from uplift.errors import UserError
from uplift.paths import data_root
from uplift.readers.archive import read_arrays
from uplift.readers.npz import joint_names_of
from uplift.skeleton import Skeleton, load_skeleton
from uplift.skeleton.matching import build_joints
from uplift.task import load_settings

__all__ = ["check_data"]

_PER_JOINT = {"keypoints": 2, "pose": 3}  # numbers of four bytes, whatever the file has
_PER_FRAME = {"root": 3, "tilt_deg": 1}


def check_data(words: Sequence[str]) -> tuple[list[str], bool]:
    """Return what to say of a task's data, and whether a fit has all that it needs.

    Raises:
        UserError: no such task, set, option or split; no data named.
    """
    tasks = [word.partition("=")[2] for word in words if word.partition("=")[0] == "task"]
    overrides = [word for word in words if word.partition("=")[0] != "task"]
    if tasks and not tasks[-1]:
        raise UserError("data check: 'task=' names nothing. Expected task=NAME.")
    settings = load_settings(tasks[-1] if tasks else None, overrides)
    report = _Report(settings)
    if settings.data.simulate:
        report.simulated()
    else:
        report.part("train")
        if settings.data.test:
            report.part("test")
    return report.ended(shlex.join(words)), report.complete


class _Report:
    """The lines, filled part by part."""

    def __init__(self, settings: Settings):
        self.settings = settings
        self.skeleton: Skeleton | None = load_skeleton(settings.skeleton) if settings.skeleton else None
        self.lines = [f"{settings.task or 'own data'}: {settings.description.strip().splitlines()[0]}"]
        self.source: DataSet | None = None
        self.missing = self.wrong = False
        if settings.data.name and not settings.data.simulate:
            folder = data_root(settings.data.name, settings.data.root).absolute()
            self.lines.append(f"folder: {folder}" + ("" if folder.is_dir() else " (not there)"))

    @property
    def complete(self) -> bool:
        """Whether nothing is missing or wrong."""
        return not self.missing and not self.wrong

    def simulated(self) -> None:
        """Say that nothing is needed."""
        frames, skeleton = self.settings.data.simulate, self.skeleton
        cost = ""
        if skeleton is not None:
            joints = len(skeleton.joints)
            cost = (
                f"; {_size(_memory({'keypoints', 'confidence', 'pose', 'root', 'tilt_deg'}, frames, joints))} in memory"
            )
        self.lines.append(f"train, test: simulated when the fit starts, {frames:,} frames: no files needed{cost}")

    def part(self, which: str) -> None:
        """Say what is there of the ``train`` or ``test`` frames."""
        found = named_set(self.settings, which)
        if found is None:
            self._file(which)
        else:
            self._set(which, *found)

    def _set(self, which: str, source: DataSet, split: str) -> None:
        self.source = source
        self.lines.append(f"{which}: {source.title or type(source).__name__}, split '{split}'")
        missing = source.missing(split)
        for file in source.files(split):
            self._line(file.path, file.what, file.present)
        facts = cached_facts(source, split) if source.cached and not missing else None
        if facts:
            about = f"{facts['frames']:,} frames of {facts['joints']} joints, {_size(facts['bytes'])} in memory"
            self.lines.append(f"  to load: {about}, from the cache")
        elif not missing:
            size = sum(_unpacked(file.path) for file in source.files(split))
            kept = (
                "not read before; the first fit reads the files and keeps the arrays" if source.cached else "read anew"
            )
            self.lines.append(f"  to load: {kept}; the files hold {_size(size)}, an estimate of the memory")

    def _file(self, which: str) -> None:
        name = getattr(self.settings.data, which)
        if not name:
            find_data(self.settings, which)  # says what to set
        path = (data_root(self.settings.data.name, self.settings.data.root) / name).absolute()
        self.lines.append(f"{which}: {path.name if self.settings.data.name else path}")
        self._line(path, "", path.is_file())
        if not path.is_file():
            return
        try:
            self.lines.append(f"  to load: {_npz_facts(path, self.skeleton)}")
        except UserError as error:
            self.wrong = True
            self.lines.append(f"  WRONG    {error}")

    def _line(self, path: Path, what: str, present: bool) -> None:
        if present:
            self.lines.append(f"  present  {path.name}, {_size(path.stat().st_size)}")
        else:
            self.missing = True
            self.lines.append(f"  MISSING  {path.name}" + (f": {what}" if what else ""))

    def ended(self, words: str) -> list[str]:
        """Return all lines, with where missing files come from and what to do next."""
        if self.missing:
            self.lines += ["", *how_to_get(self.settings, self.source).splitlines()]
        if not self.complete:
            what = "put them there" if self.missing else "mend or replace what is wrong"
            return [*self.lines, "", f"next: {what}, then uplift data check {words}"]
        return [*self.lines, "", f"next: uplift fit {words}"]


def _npz_facts(path: Path, skeleton: Skeleton | None) -> str:
    """Return frames, joints and memory of an npz of the documented layout, out of its headers alone.

    Raises:
        UserError: not such a file, or other joints than the skeleton's.
    """
    if path.suffix.lower() != ".npz":
        raise UserError(f"{path}: unknown format '{path.suffix}'. Readable: .npz (docs/your-data.md).")
    small = read_arrays(path, ("joint_names",))  # also holds every header against the bytes that are there
    shapes, stored = _headers(path)
    shape = shapes.get("keypoints", ())
    if "joint_names" not in small or len(shape) != 3:
        raise UserError(f"{path}: 'keypoints' (frames, joints, 2) and 'joint_names' are needed (docs/your-data.md).")
    frames, joints = shape[:2]
    names = joint_names_of(str(path), small)
    if len(names) != joints:
        raise UserError(f"{path}: {len(names)} joint names for {joints} joints in 'keypoints'.")
    if skeleton is not None:
        try:
            build_joints(np.zeros((1, joints, 2), np.float32), np.ones((1, joints), np.float32), names, skeleton)
        except UserError as error:
            raise UserError(f"{path}: {error}") from None
    identity = sum(stored[key] for key in IDENTITY_KEYS if key in stored)
    size = _size(_memory(set(shapes), frames, joints) + identity)
    return f"{frames:,} frames of {joints} joints, {'with' if 'pose' in shapes else 'no'} poses, {size} in memory"


def _memory(arrays: set[str], frames: int, joints: int) -> int:
    """Return the bytes of what a reader makes of these arrays; a confidence there always is."""
    numbers = joints * (1 + sum(count for name, count in _PER_JOINT.items() if name in arrays))
    return 4 * frames * (numbers + sum(count for name, count in _PER_FRAME.items() if name in arrays))


def _headers(path: Path) -> tuple[dict[str, tuple[int, ...]], dict[str, int]]:
    """Return shape and bytes of each array of an npz that was found whole."""
    shapes, stored = {}, {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as file:
                version = np.lib.format.read_magic(file)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shapes[name] = read(file)[0]
            stored[name] = member.file_size
    return shapes, stored


def _unpacked(path: Path) -> int:
    """Return the bytes of a file; of an archive, those of what is packed in it."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return sum(member.file_size for member in archive.infolist())
    return path.stat().st_size


def _size(count: int) -> str:
    value = float(count)
    for unit in ("bytes", "kB", "MB"):
        if value < 999.5:
            return f"{value:.0f} {unit}" if value >= 9.95 or unit == "bytes" else f"{value:.1f} {unit}"
        value /= 1000
    return f"{value:.1f} GB"
