"""Ultralytics' text labels and predictions: a file an image, a row a body, coordinates as shares of the image."""

from __future__ import annotations

import heapq
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.formats.layouts import COCO, names_for
from uplift.data.formats.rows import SHARES_NOTE, pose_data, seen_by_flag, video_names
from uplift.data.parsers.json import Numbers, in_order, is_text, shown
from uplift.data.parsers.pictures import picture_sizes
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]

# What stands around Ultralytics' label files: their folder and data.yaml.

_NO_LABELS = ("classes.txt", "labels.txt", "notes.txt")
_LEVELS = 3


def _label_files(path: Path) -> list[Path]:
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


def _first_labels(path: Path, most: int) -> list[Path]:
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
class _Description:
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


def _describe(folder: Path) -> _Description:
    """Return what the data.yaml of a folder of labels says, which stands beside it or up to two folders above.

    Raises:
        UserError: a data.yaml that has kpt_shape and is damaged.
    """
    here = folder.absolute()
    for place in [here, *here.parents][:_LEVELS]:
        for path in sorted([*place.glob("*.yaml"), *place.glob("*.yml")]):
            if _mentions_shape(path):
                return _description(path)
    return _Description()


def _mentions_shape(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_size < 1_000_000 and b"kpt_shape" in path.read_bytes()
    except OSError:
        return False


def _description(path: Path) -> _Description:
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
    return _Description(
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


# The rows of Ultralytics' label files, and what their numbers are.


@dataclass
class _Labels:
    """The rows of all label files."""

    file: list[int] = field(default_factory=list)
    line: list[int] = field(default_factory=list)
    length: np.ndarray = field(default_factory=lambda: np.empty(0, int))
    """(rows,) numbers in a row."""
    values: np.ndarray = field(default_factory=lambda: np.empty((0, 0), np.float32))
    """(rows, longest), NaN behind the end of a row."""
    boxes: np.ndarray = field(default_factory=lambda: np.empty((0, 5), np.float32))
    """(rows, 5): class, centre and size."""


@dataclass
class _RowLayout:
    """What the numbers of a row are."""

    count: int
    values: np.ndarray
    """(rows, keypoints, 2 or 3)."""
    predicted: bool
    """Whether a network made them, not a person."""
    track: np.ndarray | None
    """(rows,) text, empty where a row has none."""


def _row_layout(path: Path, labels: _Labels, told: _Description, notes: list[str]) -> _RowLayout:
    """Return how the rows divide: as data.yaml says, or so that keypoints lie in their boxes.

    Raises:
        UserError: no division fits, or not that of data.yaml.
    """
    shortest, longest = int(labels.length.min()), int(labels.length.max())
    if told.shape is not None:
        count, size = told.shape
        if not 0 <= shortest - 5 - count * size <= longest - 5 - count * size <= 2:
            raise UserError(
                f"{path}: rows have {shortest} numbers, but {told.path} says kpt_shape [{count}, {size}]: expected "
                f"{5 + count * size}, and up to two more (confidence, track)."
            )
    else:
        count, size = _divided(path, labels, shortest, longest)
        parts = "x, y, v" if size == 3 else "x, y"
        notes.append(
            f"no data.yaml with kpt_shape beside the labels or above: rows of {shortest} numbers are read as {count} "
            f"keypoints of {parts}"
        )
    end = 5 + count * size
    values = labels.values[:, 5:end].reshape(len(labels.values), count, size)
    flags = size == 2 or bool(np.isin(values[..., 2], (0, 1, 2)).all())
    return _RowLayout(count, values, longest > end or not flags, _tracks(labels.values[:, end:]))


def _divided(path: Path, labels: _Labels, shortest: int, longest: int) -> tuple[int, int]:
    """Return the number of keypoints and of their numbers for which most keypoints lie in their boxes."""
    best: tuple[float, int, int] = (0.0, 0, 0)
    for extra in (0, 1, 2):
        for size in (3, 2):
            count, rest = divmod(shortest - 5 - extra, size)
            if rest or count < 1 or longest - 5 - count * size > 2:
                continue
            inside = _share_inside(labels, count, size)
            if inside > best[0] + 0.02:
                best = (inside, count, size)
    if best[0] < 0.5:
        raise UserError(
            f"{path}: rows of {shortest} numbers do not divide into keypoints that lie in their boxes (outlines of "
            "objects?). Put the data.yaml with kpt_shape beside the labels or above them."
        )
    return best[1], best[2]


def _share_inside(labels: _Labels, count: int, size: int) -> float:
    values = labels.values[:10_000, 5 : 5 + count * size].reshape(-1, count, size)
    if size == 3 and not ((values[..., 2] >= 0) & ((values[..., 2] <= 1) | (values[..., 2] == 2))).all():
        return 0.0
    centre, side = labels.boxes[:10_000, None, 1:3], labels.boxes[:10_000, None, 3:5]
    inside = np.all(np.abs(values[..., :2] - centre) <= 0.6 * side + 0.01, axis=-1)
    given = np.any(values[..., :2] != 0, axis=-1)
    return float(inside[given].mean()) if given.any() else 0.0


def _tracks(extra: np.ndarray) -> np.ndarray | None:
    """Return the tracks among the up to two columns behind the keypoints; the other is the box's confidence."""
    if extra.shape[1] == 0:
        return None
    last = extra[:, -1]
    known = np.isfinite(last)
    if not known.any() or (last[known] != np.floor(last[known])).any() or (last[known] < 0).any():
        return None
    return np.where(known, np.where(known, last, 0).astype(np.int64).astype(str), "")


def _read_rows(path: Path, files: list[Path]) -> _Labels:
    """Return the rows of all files; they may differ in what follows the keypoints.

    Raises:
        UserError: text that is no row of a label, or rows with different numbers of keypoints.
    """
    labels = _Labels()
    by_length: dict[int, Numbers] = {}
    lengths: list[int] = []
    for number, file in enumerate(files):
        for line, text in enumerate(_text(file).splitlines()):
            if text.strip():
                where = f"{file}, line {line + 1}"
                values = _numbers(text, where)
                by_length.setdefault(len(values), Numbers("keypoints")).add(values, where)
                lengths.append(len(values))
                labels.file.append(number)
                labels.line.append(line)
    if not lengths:
        raise UserError(f"{path}: all {len(files):,} label files are empty.")
    labels.length = np.array(lengths)
    if max(by_length) - min(by_length) > 2:
        few = min(by_length, key=lambda length: by_length[length].rows)
        others = ", ".join(str(length) for length in sorted(by_length)[:10] if length != few)
        raise UserError(
            f"{_place(files, labels, labels.length == few)} has {few} numbers, other rows {others}. Expected the "
            "same keypoints in every row."
        )
    labels.values = np.full((len(lengths), max(by_length)), np.nan, np.float32)
    for length, table in by_length.items():
        labels.values[labels.length == length, :length] = table.array()
    labels.boxes = labels.values[:, :5]
    kind = labels.boxes[:, 0]
    wrong = ~np.all(np.isfinite(labels.boxes), axis=1) | (kind < 0) | (kind != np.floor(kind))
    if wrong.any():
        raise UserError(
            f"{_place(files, labels, wrong)} begins {labels.boxes[wrong][0].tolist()}, expected a class (a whole "
            "number from 0 up) and a box of four shares of the image."
        )
    return labels


def _place(files: list[Path], labels: _Labels, rows: np.ndarray) -> str:
    first = int(np.flatnonzero(rows)[0])
    return f"{files[labels.file[first]]}, line {labels.line[first] + 1}"


def _numbers(text: str, where: str) -> list[float]:
    try:
        values = list(map(float, text.split()))
    except ValueError:
        raise UserError(f"{where}: {text[:40]!r} are not numbers, expected class, box, keypoints.") from None
    if len(values) < 7:
        raise UserError(f"{where} has {len(values)} numbers: no keypoints after class and box, only an object?")
    return values


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{file} cannot be read as text: {error}") from None


# Ultralytics' text labels and predictions: a file an image, a row a body, coordinates as shares of the image.

_YAML = (".yaml", ".yml")
_TRIES = 100


def _fits(peek: Peek) -> bool:
    if peek.ending in _YAML:
        return "kpt_shape" in peek.text
    if not peek.is_folder:
        return peek.ending == ".txt" and _is_row(peek)
    for file in _first_labels(peek.path, _TRIES):
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
    files = _label_files(path)
    labels = _read_rows(path, files)
    told = _describe(path if path.is_dir() else path.parent)
    notes: list[str] = []
    layout = _row_layout(path, labels, told, notes)
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
    path: Path, files: list[Path], labels: _Labels, layout: _RowLayout, pictures: dict[str, str]
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
