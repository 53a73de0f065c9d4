"""Ultralytics: text labels and predictions, a file an image and a row a body; and results as JSON."""

from __future__ import annotations

import heapq
import os
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.formats.layouts import COCO, names_for
from uplift.data.formats.rows import (
    SHARES_NOTE,
    Bodies,
    pose_data,
    seen_by_flag,
    shares_to_pixels,
    track_of,
    video_names,
)
from uplift.data.parsers.files import reason_of
from uplift.data.parsers.json import JsonText, Numbers, in_order, is_text, items, json_files, shown
from uplift.data.parsers.pictures import PHOTO_ENDINGS
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["LABELS", "RESULTS"]

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


def _picture_sizes(
    files: list[Path], rows: list[int], options: ReadOptions, notes: list[str]
) -> tuple[dict[str, str], np.ndarray | None]:
    """Return the picture's name of each label file, and (rows, 2) sizes in px; None where they are not known.

    Pictures are looked for beside the labels, and in images/ where the labels are in labels/.
    """
    found = _pictures_beside(files[0].absolute().parent)
    names = {file.stem: found[file.stem].name for file in files if file.stem in found}
    if options.image_size is not None:
        return names, np.tile(np.array(options.image_size, np.float32), (len(rows), 1))
    if not names:
        return names, None
    used = sorted(set(rows))
    known = {row: _picture_size(found[files[row].stem]) for row in used if files[row].stem in found}
    sizes = set(known.values())
    without = [row for row in used if row not in known]
    if without and len(sizes) != 1:
        raise UserError(
            f"{files[without[0]]} has no picture beside it or in images/ to tell its size, and the others differ. "
            "Say image_size=WIDTHxHEIGHT."
        )
    if without:
        notes.append(f"{len(without):,} labels have no picture: their size is taken to be that of the others")
    other = next(iter(sizes))
    return names, np.array([known.get(row, other) for row in rows], np.float32)


def _pictures_beside(folder: Path) -> dict[str, Path]:
    """Return the pictures that belong to a folder of labels, by their names without ending."""
    places = [folder, folder.parent / "images"]
    parts = list(folder.parts)
    if "labels" in parts:
        last = len(parts) - 1 - parts[::-1].index("labels")
        places.append(Path(*parts[:last], "images", *parts[last + 1 :]))
    found: dict[str, Path] = {}
    for place in dict.fromkeys(places):
        for one in place.iterdir() if place.is_dir() else []:
            if one.suffix.lower() in PHOTO_ENDINGS:
                found.setdefault(one.stem, one)
    return found


def _picture_size(picture: Path) -> tuple[int, int]:
    """Return width and height of a picture from its header."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures: nothing is decoded
            with Image.open(picture) as opened:
                return opened.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise UserError(
            f"{picture} cannot be read as a picture, for the size of its labels: {error!s:.100}. Say "
            "image_size=WIDTHxHEIGHT."
        ) from None


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
            names, more = names_for(path, count, {17: COCO[17]}, options)
            notes += more
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
        raise UserError(f"{path} mentions kpt_shape and cannot be read as YAML: {reason_of(error)}") from None
    except (TypeError, ValueError):
        raise UserError(f"{path} mentions kpt_shape and is not plain YAML: a key is not text.") from None
    if not isinstance(data, dict) or not all(isinstance(key, str) for key in data):
        raise UserError(f"{path} mentions kpt_shape and is not a mapping, expected Ultralytics' description of labels.")
    return data


def _whole_numbers(values: Any) -> list[int]:
    """Return a list of whole numbers; empty for anything else."""
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


def _row_layout(path: Path, labels: _Labels, description: _Description, notes: list[str]) -> _RowLayout:
    """Return how the rows divide: as data.yaml says, or so that keypoints lie in their boxes.

    Raises:
        UserError: no division fits, or not that of data.yaml.
    """
    shortest, longest = int(labels.length.min()), int(labels.length.max())
    if description.shape is not None:
        count, size = description.shape
        if not 0 <= shortest - 5 - count * size <= longest - 5 - count * size <= 2:
            raise UserError(
                f"{path}: rows have {shortest} numbers, but {description.path} says kpt_shape [{count}, {size}]: expected "
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
        UserError: text that is not a row of a label, or rows with different numbers of keypoints.
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


def _are_labels(peek: Peek) -> bool:
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


def _read_labels(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    if path.suffix.lower() in _YAML and path.is_file():
        folders = [folder for folder in path.parent.glob("**/labels") if folder.is_dir()][:3]
        shown = ", ".join(map(str, folders)) or "train/labels"
        raise UserError(f"{path} describes a data set and holds no keypoints. Give a folder of its labels: {shown}.")
    files = _label_files(path)
    labels = _read_rows(path, files)
    description = _describe(path if path.is_dir() else path.parent)
    notes: list[str] = []
    layout = _row_layout(path, labels, description, notes)
    names = description.names_of(path, layout.count, options, notes)
    shares = layout.values[..., :2]
    if layout.values.shape[2] == 3:
        confidence = seen_by_flag(layout.values[..., 2], notes)
        confidence = np.where((shares == 0).all(-1), np.float32(0), confidence)  # predictions blank weak ones so
    else:
        confidence = (shares != 0).any(-1).astype(np.float32)
    pictures, sizes = _picture_sizes(files, labels.file, options, notes)
    keypoints = shares if sizes is None else shares * sizes[:, None].astype(np.float32)
    if sizes is None:
        notes.append(SHARES_NOTE)
    identity = _identity(path, files, labels, layout, pictures)
    classes = description.categories(labels.boxes[:, 0])
    if classes is not None:
        identity["category"] = classes
    same = sizes is not None and (sizes == sizes[0]).all()
    size = (int(sizes[0, 0]), int(sizes[0, 1])) if sizes is not None and same else None
    mirror = description.mirror(names)
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


LABELS = Format("ultralytics", "Ultralytics labels", _are_labels, _read_labels, ".txt")


# Results as JSON: the list that ``to_json()`` gives for an image, or a list of such lists.


def _are_results(peek: Peek) -> bool:
    first = peek.first_json
    if first is None or first.json_sign != "[":
        return False
    keys = set(first.json_keys)
    if not keys:  # images as lists in a list
        return all(f'"{key}"' in first.text for key in ("box", "keypoints", "confidence"))
    return {"box", "keypoints", "class"} <= keys and "image_id" not in keys


class _Results:
    """What has been read so far."""

    def __init__(self, path: Path) -> None:
        self.x, self.y, self.seen = Numbers("x"), Numbers("y"), Numbers("visible")
        self.bodies = Bodies(path)

    def add(self, body: Any, file: Path, frame: int | None, where: str) -> None:
        """Take one body."""
        points = body.get("keypoints") if isinstance(body, dict) else None
        if not isinstance(points, dict):
            raise UserError(f"{where} is {shown(body)}, expected an object with keypoints: x, y, visible.")
        self.x.add(points.get("x"), where)
        self.y.add(points.get("y"), where)
        seen = points.get("visible")
        self.seen.add([1.0] * (self.x.width or 0) if seen is None else seen, where)
        if not self.x.width == self.y.width == self.seen.width:
            raise UserError(f"{where} has {self.x.width} x, {self.y.width} y and {self.seen.width} visible.")
        name = body.get("name", body.get("class"))
        category = str(name) if is_text(name) or type(name) is int else ""
        self.bodies.add(file.stem, frame, track_of(body.get("track_id"), where, "track_id"), category)


def _read_results(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    found = _Results(path)
    for file in json_files(path):
        for count, entry in enumerate(items(JsonText(file), "the list of results")):
            if not isinstance(entry, list):
                found.add(entry, file, None, f"{file}: entry {count}")
                continue
            for place, body in enumerate(entry):
                found.add(body, file, count, f"{file}: frame {count}, entry {place}")
    if not len(found.bodies):
        raise UserError(f"{path} has no bodies, expected results of Ultralytics.")
    keypoints = np.stack([found.x.array(), found.y.array()], -1)
    names, named = names_for(path, keypoints.shape[1], {17: COCO[17]}, options, keypoints)
    blank = (keypoints == 0).all(-1)  # what weak keypoints are set to
    confidence = np.where(blank, np.float32(0), found.seen.array())
    keypoints, notes = shares_to_pixels(keypoints, options, named)
    return pose_data(path, names, keypoints, confidence, found.bodies.identity(), notes=notes)


RESULTS = Format("ultralytics_json", "Ultralytics results (JSON)", _are_results, _read_results, ".json")
