"""Which of several files hold keypoints, each video's once: DeepLabCut writes up to a dozen for a video."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

__all__ = ["keypoint_files"]

_BY_PRODUCT = re.compile(
    r"_(skeleton\.(csv|h5)|(meta|full|includingmetadata|assemblies|el|bx|sk|bpt|id)\.pickle|labeled\.\w+|bp\.\w+)$",
    re.I,
)
"""Lengths of bones, records of the run, pieces of tracks, and videos with the keypoints drawn in."""
_OTHERS = {".mp4", ".avi", ".mov", ".mkv", ".webm", ".mpg", ".mpeg", ".yaml", ".yml", ".log"}
"""Videos, and the settings of trackers: beside files of keypoints in a folder."""
_TRACKS = re.compile(r"_(el|bx|sk)$", re.I)
_MOST_NAMED = 3


def keypoint_files(paths: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Return those of several files that hold keypoints, each video's once, and notes on those left out.

    A filtered file (``x_filtered.csv``) stands for the unfiltered one, a csv for the HDF5 file of its name, and
    ``x.csv`` for tracks of the same (``x_el.csv``). What no other stands for stays, as does a file alone.
    """
    if len(paths) < 2:
        return list(paths), []
    others = [one for one in paths if _BY_PRODUCT.search(one.name) or one.suffix.lower() in _OTHERS]
    kept = [one for one in paths if one not in set(others)]
    if not kept:
        return list(paths), []
    best: dict[tuple[str, str], Path] = {}
    for one in sorted(kept, key=_rank):
        best.setdefault(_video(one), one)
    chosen = set(best.values())
    twice = [one for one in kept if one not in chosen]
    notes = [f"{_named(twice)} left out: the same as in {_named([best[_video(one)] for one in twice])}"] * bool(twice)
    notes += [f"{_named(others)} left out: no keypoints, but what a tracker or a camera writes beside them"] * bool(
        others
    )
    return [one for one in kept if one in chosen], notes


def _video(path: Path) -> tuple[str, str]:
    """Return what files of the same keypoints share: the folder and the name, without what says how they were treated."""
    if path.suffix.lower() not in (".csv", ".h5", ".hdf5"):
        return str(path.parent), path.name
    return str(path.parent), _TRACKS.sub("", re.sub(r"_filtered$", "", path.stem, flags=re.I))


def _rank(path: Path) -> tuple[bool, bool, bool]:
    """Return what is lowest for the file to take: filtered, not of tracks, and a csv, which needs no further library."""
    stem = path.stem.lower()
    filtered = stem.endswith("_filtered")
    return not filtered, bool(_TRACKS.search(stem.removesuffix("_filtered"))), path.suffix.lower() != ".csv"


def _named(paths: Sequence[Path]) -> str:
    """Return the names of files, the first of many."""
    more = f" and {len(paths) - _MOST_NAMED:,} more" if len(paths) > _MOST_NAMED else ""
    return ", ".join(one.name for one in paths[:_MOST_NAMED]) + more
