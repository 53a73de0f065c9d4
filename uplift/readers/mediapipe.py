"""MediaPipe, which writes no files of its own: landmarks as scripts keep them in csv, JSON or npz."""

from __future__ import annotations

from pathlib import Path

from uplift.data.container import PoseData
from uplift.readers.base import Format, Peek, ReadOptions
from uplift.readers.mediapipe_csv import looks_like_mediapipe_csv, read_mediapipe_csv
from uplift.readers.mediapipe_json import looks_like_mediapipe_json, read_mediapipe_json
from uplift.readers.mediapipe_npz import looks_like_mediapipe_npz, read_mediapipe_npz

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    if peek.npz_names:
        return looks_like_mediapipe_npz(peek)
    return looks_like_mediapipe_json(peek) or looks_like_mediapipe_csv(peek)


def _read(path: Path, options: ReadOptions) -> PoseData:
    peek = Peek(path)
    if peek.npz_names:
        return read_mediapipe_npz(path, options)
    return read_mediapipe_json(path, options) if peek.json_sign else read_mediapipe_csv(path, options)


FORMAT = Format("mediapipe", "landmarks of MediaPipe (csv, json, npz)", _fits, _read)
