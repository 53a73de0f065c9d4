"""DeepLabCut and Lightning Pose: tables in csv or HDF5, of one or several individuals."""

from __future__ import annotations

from pathlib import Path

from uplift.data.container import PoseData
from uplift.readers.base import Format, Peek, ReadOptions
from uplift.readers.deeplabcut_csv import looks_like_deeplabcut_csv, read_deeplabcut_csv
from uplift.readers.deeplabcut_h5 import looks_like_deeplabcut_h5, read_deeplabcut_h5

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    return looks_like_deeplabcut_h5(peek) if peek.is_hdf5 else looks_like_deeplabcut_csv(peek)


def _read(path: Path, options: ReadOptions) -> PoseData:
    return read_deeplabcut_h5(path) if Peek(path).is_hdf5 else read_deeplabcut_csv(path)


FORMAT = Format("deeplabcut", "DeepLabCut or Lightning Pose (csv, h5)", _fits, _read)
