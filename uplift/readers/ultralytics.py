"""Ultralytics' text labels and predictions: a file an image, a row a body, coordinates as shares of the image."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.base import Format, Peek, ReadOptions
from uplift.readers.pictures import picture_sizes
from uplift.readers.rows import SHARES_NOTE, pose_data, seen_by_flag, video_names
from uplift.readers.ultralytics_rows import Labels, RowLayout, read_rows, row_layout
from uplift.readers.ultralytics_set import describe, first_labels, label_files

__all__ = ["FORMAT"]

_YAML = (".yaml", ".yml")
_TRIES = 100


def _fits(peek: Peek) -> bool:
    if peek.ending in _YAML:
        return "kpt_shape" in peek.text
    if not peek.is_folder:
        return peek.ending == ".txt" and _is_row(peek)
    for file in first_labels(peek.path, _TRIES):
        try:
            return _is_row(Peek(file))
        except (UserError, OSError):
            continue
    return False


def _is_row(peek: Peek) -> bool:
    """Return whether the first line is a class, a box in shares of the image, and more."""
    first = next((line.split() for line in peek.lines or peek.text.splitlines() if line.strip()), [])
    try:
        values = [float(cell) for cell in first[:5]]
        float(first[-1])
    except (ValueError, IndexError):
        return False
    shares = all(-0.5 <= value <= 1.5 for value in values[1:])
    return len(first) >= 7 and values[0] >= 0 and values[0].is_integer() and shares


def _read(path: Path, options: ReadOptions) -> PoseData:
    if path.suffix.lower() in _YAML and path.is_file():
        folders = [folder for folder in path.parent.glob("**/labels") if folder.is_dir()][:3]
        shown = ", ".join(map(str, folders)) or "train/labels"
        raise UserError(f"{path} describes a data set and holds no keypoints. Give a folder of its labels: {shown}.")
    files = label_files(path)
    labels = read_rows(path, files)
    told = describe(path if path.is_dir() else path.parent)
    notes: list[str] = []
    layout = row_layout(path, labels, told, notes)
    names = told.names_of(path, layout.count, options, notes)
    shares = layout.values[..., :2]
    if layout.values.shape[2] == 3:
        confidence = seen_by_flag(layout.values[..., 2], notes)
        confidence = np.where((shares == 0).all(-1), np.float32(0), confidence)  # predictions blank weak ones so
    else:
        confidence = (shares != 0).any(-1).astype(np.float32)
    pictures, sizes = picture_sizes(files, labels.file, options, notes)
    keypoints = shares if sizes is None else shares * sizes[:, None].astype(np.float32)
    if sizes is None:
        notes.append(SHARES_NOTE)
    identity = _identity(path, files, labels, layout, pictures)
    classes = told.categories(labels.boxes[:, 0])
    if classes is not None:
        identity["category"] = classes
    same = sizes is not None and (sizes == sizes[0]).all()
    size = (int(sizes[0, 0]), int(sizes[0, 1])) if sizes is not None and same else None
    mirror = told.mirror(names)
    return pose_data(path, names, keypoints, confidence, identity, notes=notes, image_size=size, mirror=mirror)


def _identity(
    path: Path, files: list[Path], labels: Labels, layout: RowLayout, pictures: dict[str, str]
) -> dict[str, np.ndarray]:
    """Return sequence, frame and track of predictions that are numbered as a video's frames; images otherwise."""
    stems = [file.stem for file in files]
    video = video_names(stems, path.absolute().stem) if layout.predicted and len(files) > 1 else None
    if video is None:
        image = np.array([pictures.get(stem, stem) for stem in stems])[labels.file]
        return {"image": image, "instance": np.array(labels.line).astype(str)}
    sequence, frame = np.array(video[0]), np.array(video[1], np.int64)
    identity = {"sequence": sequence[labels.file], "frame": frame[labels.file]}
    return identity if layout.track is None else {**identity, "instance": layout.track}


FORMAT = Format("ultralytics", "Ultralytics labels", _fits, _read)
