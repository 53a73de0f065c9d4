"""The verb data check: which files a task needs, which are there, and what they cost to load."""

from __future__ import annotations

import shlex
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uplift.cli.kinds import KINDS
from uplift.config.files import data_root, files_of, shipped_names
from uplift.config.loading import load_settings, split_words, trust_of
from uplift.config.settings import Settings
from uplift.data.datasets import DataSet, WantedFile
from uplift.data.datasets.base import cached_facts
from uplift.data.formats import MASK_FORMATS, read_masks
from uplift.data.formats.base import Peek
from uplift.data.formats.deeplabcut_files import keypoint_files
from uplift.data.formats.masks_npz import read_masks_npz
from uplift.data.formats.npz import contents_of, memory_of
from uplift.data.individuals import by_individuals
from uplift.data.load import (
    find_data,
    format_of,
    how_to_get,
    in_joints_of,
    load_file,
    named_set,
    of_labelled,
    read_options,
)  # fmt: skip
from uplift.data.masks import MaskData
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean
from uplift.skeleton import Skeleton, load_skeleton

__all__ = ["check_data", "keypoint_file", "mask_file", "simulated_keypoints", "simulated_masks"]


def check_data(words: Sequence[str]) -> tuple[list[str], bool]:
    """Return the lines on a task's data, and whether a fit has all it needs; raises UserError for invalid settings."""
    task = split_words(words)[1].get("task")
    if task == "":
        raise UserError("data check: 'task=' has no value. Expected task=NAME.")
    settings = load_settings(task, [word for word in words if word.partition("=")[0] != "task"])
    report = _Report(settings)
    if settings.data.simulate:
        what, size = KINDS[settings.lifts].check_simulated(settings, report.skeleton)
        cost = f"; {_size(size)} in memory" if size else ""
        report.lines.append(f"train, test: {what}: no files needed{cost}")
    else:
        report.part("train", settings, "train")
        if settings.data.test:
            report.part("test", settings, "test")
    if settings.data.labelled.file:
        report.part("labelled", of_labelled(settings), "train")
    trust = "" if settings.task in shipped_names("tasks") else trust_of(settings)
    return report.ended(f"{shlex.join(words)}{trust}"), not report.missing and not report.wrong


class _Report:
    """The lines to print, filled part by part."""

    def __init__(self, settings: Settings):
        self.skeleton: Skeleton | None = load_skeleton(settings.skeleton) if settings.skeleton else None
        about = settings.description.strip().partition("\n")[0]
        self.lines = [f"{settings.task or 'own data'}: {about}"]
        self.missing: dict[str, None] = {}
        """How to get what is missing."""
        self.wrong = False
        self.folder: Path | None = None

    def part(self, title: str, settings: Settings, which: str) -> None:
        """Report the files of the ``train`` or ``test`` frames of ``settings``."""
        found = named_set(settings, which)
        folder = data_root(settings.data.name, settings.data.root).absolute()
        if settings.data.name and folder != self.folder:
            self.lines.append(f"folder: {folder}" + ("" if folder.is_dir() else " (not there)"))
            self.folder = folder
        if not (self._file(title, settings, which) if found is None else self._set(title, *found)):
            self.missing.setdefault(how_to_get(settings, found[0] if found else None))

    def _set(self, title: str, source: DataSet, split: str) -> bool:
        """Report the files of a split; returns whether none is missing."""
        self.lines.append(f"{title}: {source.title or type(source).__name__}, split '{split}'")
        files = source.files(split)
        parts: dict[str, list[WantedFile]] = {}
        for file in files:
            parts.setdefault(file.part or str(file.path), []).append(file)
        for part, some in parts.items():
            absent = [f"{file.path.name}: {file.what}" for file in some if not file.present]
            self._part(part, [file.path for file in some if file.present], absent)
        if source.missing(split):
            return False
        facts = cached_facts(source, split) if source.cached else None
        if facts:
            size = _size(facts["bytes"])
            cost = f"{facts['frames']:,} frames of {facts['joints']} joints, {size} in memory, from the cache"
        else:
            first = "not read before; the first fit reads the files and keeps the arrays"
            size = _size(sum(_unpacked(file.path) for file in files))
            cost = f"{first if source.cached else 'read anew'}; the files hold {size}, an estimate of the memory"
        self.lines.append(f"  to load: {cost}")
        return True

    def _file(self, title: str, settings: Settings, which: str) -> bool:
        """Report files of keypoints or masks; returns whether none is missing."""
        name, folder = getattr(settings.data, which), data_root(settings.data.name, settings.data.root)
        try:
            paths = files_of(find_data(settings, which))
        except UserError:
            if not name:
                raise  # it names what to set
            paths = [(folder / part).absolute() for part in str(name).split(",") if part]
        left_out: list[str] = []
        if settings.lifts == "keypoints":
            paths, left_out = keypoint_files(paths)
        alone = paths[0].name if paths[0].parent == self.folder else str(paths[0])
        self.lines.append(f"{title}: {alone if len(paths) == 1 else f'{len(paths)} files'}")
        self.lines += [f"  {note}" for note in left_out]
        folders: dict[Path, list[Path]] = {}
        for path in paths:
            folders.setdefault(path if len(paths) <= _MOST_LINES else path.parent, []).append(path)
        for folder, some in folders.items():
            absent = [path.name for path in some if not path.exists()]
            self._part(folder.name, [path for path in some if path.exists()], absent)
        if not all(path.exists() for path in paths):
            return False
        loads, wrong = [], []
        for path in paths:
            try:
                loads.append(f"  to load: {KINDS[settings.lifts].check_file(path, settings, self.skeleton)}")
            except UserError as error:
                wrong.append(f"  WRONG    {error}")
        self.wrong |= bool(wrong)
        loads.sort(key=lambda line: "\n  WARNING" not in line)  # what is odd is among the first, which are shown
        self.lines += [*_first(loads), *_first(wrong)]
        return True

    def _part(self, title: str, present: list[Path], absent: list[str]) -> None:
        """Add a line on the files of one part that are there, and one on each of the first that are not."""
        size = _size(sum(path.stat().st_size for path in present))
        if len(present) == 1:
            self.lines.append(f"  present  {present[0].name}, {'a folder' if present[0].is_dir() else size}")
        elif present:
            self.lines.append(f"  present  {title}: {len(present):,} files, {size}")
        self.lines += _first([f"  MISSING  {file}" for file in absent])

    def ended(self, words: str) -> list[str]:
        """Return all lines, with where missing files come from and what to do next."""
        for source in self.missing:
            self.lines += ["", *source.splitlines()]
        fix = "put them there" if self.missing else "fix or replace what is wrong" if self.wrong else ""
        return [*self.lines, "", f"next: {fix}, then uplift data check {words}" if fix else f"next: uplift fit {words}"]


_MOST_LINES = 10


def _first(lines: list[str]) -> list[str]:
    """Return the first of many lines, and how many more there are."""
    return [*lines[:_MOST_LINES], *([f"  and {len(lines) - _MOST_LINES:,} more"] if len(lines) > _MOST_LINES else [])]


# Keypoints: what is simulated, and what a file holds.

_MOST_LOOKED_AT = 500_000_000
"""Bytes of a file that is read for what is odd about its numbers."""
_SIMULATED = {"keypoints", "pose", "root", "tilt_deg"}


def simulated_keypoints(settings: Settings, skeleton: Skeleton | None) -> tuple[str, int]:
    """Return what a fit simulates, and its bytes in memory, 0 where they are not known."""
    frames, joints = settings.data.simulate, len(skeleton.joints) if skeleton else 0
    size = memory_of(_SIMULATED, frames, joints) if joints else 0
    return f"simulated when the fit starts, {frames:,} frames", size


def keypoint_file(path: Path, settings: Settings, skeleton: Skeleton | None) -> str:
    """Return frames, joints and memory of a file; raises UserError for one that a fit would refuse."""
    found = contents_of(path, read_options(settings.data, path))
    joints = len(found.joint_names)
    if skeleton is not None:
        blank = np.zeros((1, joints, 2), np.float32), np.ones((1, joints), np.float32)
        in_joints_of(by_individuals(PoseData(*blank, found.joint_names, source=str(path)), skeleton), skeleton)
    poses = "with" if found.has_pose else "no"
    how = f"; {found.read_as}" if found.read_as else ""
    lines = [f"{found.frames:,} frames of {joints} joints, {poses} poses, {_size(found.memory)} in memory{how}"]
    if skeleton is not None and found.memory < _MOST_LOOKED_AT:
        notes = load_file(path, skeleton, read_options(settings.data, path)).notes
        lines += [f"  {note}" for note in notes if note.startswith("WARNING")]
    return "\n".join(lines)


# Masks: what is simulated, and what a file or folder holds, without opening every picture.


def simulated_masks(settings: Settings, skeleton: Skeleton | None) -> tuple[str, int]:
    """Return what a fit simulates, and its bytes in memory; raises UserError for an unknown family of shapes."""
    from uplift.data.synthetic.masks import FAMILIES

    data = settings.data
    if data.family not in FAMILIES:
        raise UserError(f"data.family={data.family}: no such family of shapes.{did_you_mean(data.family, FAMILIES)}")
    return f"{data.simulate:,} masks of simulated {data.family}, when the fit starts", data.simulate * data.side**2


def mask_file(path: Path, settings: Settings, skeleton: Skeleton | None) -> str:
    """Return in a few words what a file or folder holds; raises UserError where that is not masks."""
    peek, chosen = Peek(path), format_of(settings.data, path)
    found = MASK_FORMATS.guess(peek) if chosen is None else MASK_FORMATS.named(chosen, "data.format")
    if found.name == "npz" or found.name not in MASK_FORMATS:  # a user's own is tried out
        masks = read_masks_npz(path) if found.name == "npz" else _own_masks(path, settings, found.name)
        truth, how = "no" if masks.truth is None else "with", "" if found.name == "npz" else f"; {masks.notes[0]}"
        return f"{len(masks):,} masks of {masks.side} x {masks.side} px, {truth} true shapes{how}"
    count = f"{len(peek.pictures):,} pictures, " if peek.pictures else ""
    return f"{count}{found.title}; each is looked at when the fit starts"


def _own_masks(path: Path, settings: Settings, format: str) -> MaskData:
    options = {key: getattr(settings.data, key) for key in ("side", "border", "pieces", "category", "most")}
    return read_masks(path, format=format, **options)


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
