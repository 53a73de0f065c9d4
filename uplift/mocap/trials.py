"""Which files of a folder are motions, whose they are, and which skeleton goes with each."""

from __future__ import annotations

import os
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from uplift.errors import UserError

__all__ = ["Trial", "find_trials"]

_NUMBERED = re.compile(r"(?<!\d)(\d{1,3})_(\d{1,3}[a-z]?)(?![\da-zA-Z])")


@dataclass(frozen=True)
class Trial:
    """One motion file."""

    path: Path
    subject: str
    """Such as ``S35``."""
    sequence: str
    """Such as ``35_01``."""
    skeleton: Path | None = None
    """The ``.asf`` of an ``.amc``."""


def find_trials(folder: Path, skip: Collection[str] = ()) -> tuple[list[Trial], list[str]]:
    """Return the motions below ``folder`` in order, and what was noticed.

    Raises:
        UserError: no folder, no motions, an ``.amc`` without its ``.asf``, one motion twice.
    """
    if not folder.is_dir():
        raise UserError(f"No folder {folder}. Expected one with CMU's .asf and .amc files, or .bvh files made of them.")
    files = _files(folder)
    skeletons: dict[str, list[Path]] = {}
    for path in files[".asf"]:
        skeletons.setdefault(_subject(path.stem), []).append(path)
    found: dict[str, Trial] = {}
    doubled = 0
    skipped = set()
    for path in [*files[".amc"], *files[".bvh"]]:
        trial = _trial(path)
        if {trial.subject, trial.sequence} & set(skip):
            skipped |= {trial.subject, trial.sequence} & set(skip)
            continue
        other = found.get(trial.sequence)
        if other is None:
            own = _skeleton_of(path, trial.subject, skeletons) if path.suffix.lower() == ".amc" else None
            found[trial.sequence] = Trial(path, trial.subject, trial.sequence, own)
        elif other.path.suffix.lower() == path.suffix.lower():
            raise UserError(f"{other.path} and {path} are both motion {trial.sequence}: keep one of them.")
        else:
            doubled += 1
    if set(skip) - skipped:
        raise UserError(f"skip={', '.join(sorted(set(skip) - skipped))}: no such subject or motion in {folder}.")
    if not found:
        kinds = ", ".join(f"{len(paths)} {kind}" for kind, paths in files.items())
        raise UserError(f"{folder}: no motions (found {kinds}). Expected .amc files with their .asf, or .bvh files.")
    notes = [f"{doubled} .bvh left out: their .amc, which has all bones, is there"] if doubled else []
    return sorted(found.values(), key=lambda trial: _order(trial.sequence)), notes


def _files(folder: Path) -> dict[str, list[Path]]:
    files: dict[str, list[Path]] = {".asf": [], ".amc": [], ".bvh": []}
    for place, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            path = Path(place, name)
            if path.suffix.lower() in files and path.is_file() and not name.startswith("."):
                files[path.suffix.lower()].append(path)
    return files


def _order(sequence: str) -> list:
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", sequence) if part]


def _trial(path: Path) -> Trial:
    numbers = _NUMBERED.search(path.stem)
    if numbers:
        subject, trial = numbers.groups()
        return Trial(path, f"S{int(subject)}", f"{int(subject):02d}_{trial.zfill(2)}")
    subject, _, _ = path.stem.rpartition("_")
    return Trial(path, _subject(subject or path.stem), path.stem)


def _subject(stem: str) -> str:
    return f"S{int(stem)}" if re.fullmatch(r"\d{1,9}", stem) else stem


def _skeleton_of(path: Path, subject: str, skeletons: dict[str, list[Path]]) -> Path:
    choices = skeletons.get(subject, [])
    beside = [choice for choice in choices if choice.parent == path.parent]
    if len(beside or choices) == 1:
        return (beside or choices)[0]
    if choices:
        raise UserError(f"{path}: {len(choices)} skeletons of {subject} ({choices[0]}, {choices[1]}): keep one.")
    raise UserError(
        f"{path}: its skeleton is missing. Expected {subject.removeprefix('S')}.asf: CMU gives it with the subject."
    )
