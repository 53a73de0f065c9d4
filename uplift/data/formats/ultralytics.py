"""Ultralytics: text labels and predictions, a file an image and a row a body; and results as JSON."""

from __future__ import annotations

import os
import re
import warnings
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import COCO, names_for, swapped_names
from uplift.data.formats.rows import Bodies, pose_data, seen_by_flag, track_of, video_names
from uplift.data.formats.scales import SHARES_NOTE
from uplift.data.parsers.files import read_bytes, reason_of
from uplift.data.parsers.json import JsonText, Numbers, in_order, is_text, items, json_files, shown
from uplift.data.parsers.pictures import PHOTO_ENDINGS
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["LABELS", "RESULTS"]

# Text labels and predictions: a file an image, a row a body, coordinates as shares of the image.

_YAML = (".yaml", ".yml")
_LABEL = re.compile(r"(?!\.|readme|(classes|labels|notes)\.txt$).*\.txt", re.IGNORECASE)
_LEVELS = 3
_TRIES = 100


def _are_labels(peek: Peek) -> bool:
    if peek.ending in _YAML:
        return "kpt_shape" in peek.text
    if not peek.is_folder:
        return peek.ending == ".txt" and _is_row(peek)
    with suppress(UserError, OSError):
        for file in _files_in(peek.path)[0][:_TRIES]:
            with suppress(UserError, OSError):
                return _is_row(Peek(file))
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


def _files_in(path: Path) -> tuple[list[Path], list[str]]:
    """Return the label files of a data set's training split, of a folder, or of labels/ in it, and notes."""
    described = _yaml_in(path)
    with suppress(UserError):  # a damaged one says so when the keypoints are described
        files, notes = ([], []) if described is None else _split_files(described)
        if files:
            return files, notes
    places = (path, path / "labels", path / "labels" / "train", path / "train" / "labels")
    return next(filter(None, map(_label_files, places)), []), []


def _label_files(folder: Path) -> list[Path]:
    """Return the label files of a folder, in order."""
    with suppress(OSError):
        found = [one.name for one in os.scandir(folder) if _LABEL.fullmatch(one.name) and one.is_file()]
        return [folder / name for name in sorted(found, key=in_order)]
    return []


_SPLITS = ("train", "val", "test")


def _split_files(described: Path) -> tuple[list[Path], list[str]]:
    """Return the label files of the first split that a data.yaml names and that is there, and a note on the others."""
    data = _plain_yaml(described)
    found: dict[str, list[Path]] = {}
    for split in _SPLITS:
        named = data.get(split)
        places = [str(one) for one in (named if isinstance(named, list) else [named]) if is_text(one)]
        found[split] = [file for place in places for file in _labels_at(described.parent, data.get("path"), place)]
    there = [split for split, files in found.items() if files]
    if not there:
        return [], []
    others = [f"{split} ({found[split][0].parent})" for split in there[1:]]
    note = f"the split '{there[0]}' of {described.name}" + (f"; not read: {', '.join(others)}" if others else "")
    return found[there[0]], [note]


def _labels_at(root: Path, base: Any, place: str) -> list[Path]:
    """Return the label files of the pictures that a data.yaml in ``root`` means: a folder of them, or a list; none outside ``root``.

    The folder that it says it is in (``base``) is mostly that of another machine.
    """
    inside = root.resolve()
    for where in (root / (base if is_text(base) else "") / place, root / place, root / place.removeprefix("../")):
        if inside not in (where.resolve(), *where.resolve().parents):
            continue
        if where.is_dir():
            files = _label_files(_of_pictures(where)) or _label_files(where) or _label_files(where / "labels")
        else:
            lines = _text(where).splitlines() if where.suffix.lower() == ".txt" and where.is_file() else []
            files = [_of_pictures(root / line.strip()).with_suffix(".txt") for line in lines if line.strip()]
            files = [file for file in files if inside in file.resolve().parents and file.is_file()]
        if files:
            return files
    return []


def _of_pictures(path: Path) -> Path:
    """Return where the labels of a picture or a folder of them are: in labels/ in place of the last images/."""
    parts = list(path.parts)
    if "images" in parts:
        parts[len(parts) - 1 - parts[::-1].index("images")] = "labels"
    return Path(*parts)


def _labels_of(path: Path) -> tuple[list[Path], list[str]]:
    """Return the label files that a path means, and notes; raises UserError where there are none."""
    if path.is_dir():
        files, notes = _files_in(path)
        if not files:
            raise UserError(f"{path} has no *.txt in it, nor in labels/ below it.")
        return files, notes
    if path.suffix.lower() not in _YAML:
        return [path], []
    files, notes = _split_files(path)
    if not files:
        folders = [folder for folder in path.parent.glob("**/labels") if folder.is_dir()][:3]
        shown = ", ".join(map(str, folders)) or "train/labels"
        raise UserError(
            f"{path} describes a data set, and no labels are where it says. Give a folder of its labels: {shown}."
        )
    return files, notes


def _read_labels(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    files, notes = _labels_of(path)
    labels = _read_rows(path, files)
    description = _describe(files[0].parent)
    values, predicted, tracks = _divide(path, labels, description, notes)
    names = description.names_of(path, values, options, notes)
    keypoints, confidence = values[..., :2], (values[..., :2] != 0).any(-1).astype(np.float32)
    if values.shape[2] == 3:  # predictions blank weak keypoints
        confidence = np.where(confidence > 0, seen_by_flag(values[..., 2], notes), np.float32(0))
    pictures, sizes = _picture_sizes(files, labels.file.tolist(), options, notes)
    if sizes is None:
        notes.append(SHARES_NOTE)
    else:
        keypoints = keypoints * sizes[:, None]
    identity = _identity(path, files, labels, predicted, tracks, pictures)
    known: dict[str, Any] = {"mirror": swapped_names(description.partners, names)}
    if sizes is not None and (sizes == sizes[0]).all():
        known["image_size"] = (int(sizes[0, 0]), int(sizes[0, 1]))
    identity |= description.categories(labels.values[:, 0])
    return pose_data(path, names, keypoints, confidence, identity, notes=notes, **known)


def _identity(
    path: Path,
    files: list[Path],
    labels: _Labels,
    predicted: bool,
    tracks: np.ndarray | None,
    pictures: dict[Path, Path],
) -> dict[str, np.ndarray]:
    """Return sequence, frame and track of predictions that are numbered as a video's frames; images otherwise."""
    stems = [file.stem for file in files]
    video = video_names(stems, path.absolute().stem) if predicted and len(files) > 1 else None
    if video is None:
        image = np.array([pictures[file].name if file in pictures else file.stem for file in files])[labels.file]
        return {"image": image, "instance": labels.line.astype(str)}
    sequence, frame = np.array(video[0]), np.array(video[1], np.int64)
    identity = {"sequence": sequence[labels.file], "frame": frame[labels.file]}
    return identity if tracks is None else identity | {"instance": tracks}


# The pictures beside label files, for their sizes.


def _picture_sizes(
    files: list[Path], rows: list[int], options: ReadOptions, notes: list[str]
) -> tuple[dict[Path, Path], np.ndarray | None]:
    """Return the picture of each label file that has one, and (rows, 2) sizes in px; None where they are not known.

    Pictures are looked for beside the labels, and in images/ where the labels are in labels/.
    """
    beside = {folder: _pictures_beside(folder.absolute()) for folder in dict.fromkeys(file.parent for file in files)}
    found = {file: beside[file.parent][file.stem] for file in files if file.stem in beside[file.parent]}
    if options.image_size is not None:
        return found, np.tile(np.array(options.image_size, np.float32), (len(rows), 1))
    if not found:
        return found, None
    used = sorted(set(rows))
    known = {row: _picture_size(found[files[row]]) for row in used if files[row] in found}
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
    return found, np.array([known.get(row, other) for row in rows], np.float32)


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


# The data.yaml that describes labels.


@dataclass
class _Description:
    """What data.yaml says."""

    path: Path | None = None
    shape: tuple[int, int] | None = None
    classes: dict[int, str] = field(default_factory=dict)
    partners: list[int] = field(default_factory=list)
    names: tuple[str, ...] | None = None

    def names_of(self, path: Path, values: np.ndarray, options: ReadOptions, notes: list[str]) -> tuple[str, ...]:
        """Return the names of (rows, keypoints, 2 or 3) keypoints; raises UserError where data.yaml has another number of them."""
        if self.names is None or options.layout is not None:
            names, more = names_for(path, values.shape[1], COCO, options, values)
            notes += more
            return names
        if len(self.names) != values.shape[1]:
            raise UserError(
                f"{self.path}: kpt_names are {len(self.names)}, the labels have {values.shape[1]} keypoints."
            )
        return self.names

    def categories(self, classes: np.ndarray) -> dict[str, np.ndarray]:
        """Return (rows,) names of classes where there are several."""
        found, place = np.unique(classes, return_inverse=True)
        if len(found) < 2 and len(self.classes) < 2:
            return {}
        return {"category": np.array([self.classes.get(int(one), str(int(one))) for one in found])[place]}


def _describe(folder: Path) -> _Description:
    """Return what the data.yaml in a folder of labels, or up to two folders above, says; a damaged one raises UserError."""
    here = folder.absolute()
    found = next(filter(None, map(_yaml_in, [here, *here.parents][:_LEVELS])), None)
    return _Description() if found is None else _description(found)


def _yaml_in(folder: Path) -> Path | None:
    """Return the YAML file in a folder that describes keypoints; None without one."""
    for path in sorted([*folder.glob("*.yaml"), *folder.glob("*.yml")]):
        with suppress(OSError):
            if path.is_file() and path.stat().st_size < 1_000_000 and b"kpt_shape" in path.read_bytes():
                return path
    return None


def _description(path: Path) -> _Description:
    data = _plain_yaml(path)
    shape = _integers(data.get("kpt_shape"))
    if len(shape) != 2 or not 0 < shape[0] < 100_000 or shape[1] not in (2, 3):
        raise UserError(f"{path}: kpt_shape is {shown(shape or data.get('kpt_shape'))}, expected [keypoints, 2 or 3].")
    classes, names = data.get("names"), data.get("kpt_names")
    if isinstance(names, dict):  # by class
        names = next(iter(names.values()), None)
    if isinstance(classes, list):
        classes = {str(number): name for number, name in enumerate(classes)}
    classes = classes if isinstance(classes, dict) else {}
    partners = _integers(data.get("flip_idx"))
    numbered = {n: name for n, name in classes.items() if is_text(name) and re.fullmatch("[0-9]{1,6}", n)}
    return _Description(
        path=path,
        shape=(shape[0], shape[1]),
        classes={int(n): name[:200] for n, name in numbered.items()},
        partners=partners if max(partners, default=0) < shape[0] else [],
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


def _integers(values: Any) -> list[int]:
    """Return a list of whole numbers; empty for anything else."""
    if not isinstance(values, list) or not all(isinstance(v, str) and re.fullmatch("[0-9]{1,9}", v) for v in values):
        return []
    return [int(value) for value in values]


# The rows of label files, and what their numbers are.


@dataclass
class _Labels:
    """The rows of all label files."""

    file: np.ndarray
    line: np.ndarray
    length: np.ndarray
    """Numbers in each row."""
    values: Float[np.ndarray, "rows longest"]
    """Class, centre and size of the box, keypoints and what follows; NaN behind the end of a row."""


def _divide(
    path: Path, labels: _Labels, description: _Description, notes: list[str]
) -> tuple[np.ndarray, bool, np.ndarray | None]:
    """Return (rows, keypoints, 2 or 3) numbers, whether a network made them, and (rows,) tracks, empty where a row has none.

    Rows divide as data.yaml says, or so that keypoints lie in their boxes; raises UserError where they do not.
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
        notes.append(
            f"no data.yaml with kpt_shape beside the labels or above: rows of {shortest} numbers are read as {count} "
            f"keypoints of {'x, y, v' if size == 3 else 'x, y'}"
        )
    end = 5 + count * size
    values = labels.values[:, 5:end].reshape(-1, count, size)
    flags = size == 2 or bool(np.isin(values[..., 2], (0, 1, 2)).all())
    return values, longest > end or not flags, _tracks(labels.values[:, end:])


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
    centre, side = labels.values[:10_000, None, 1:3], labels.values[:10_000, None, 3:5]
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
    """Return the rows of all files; raises UserError where they differ in more than what follows the keypoints."""
    tables: dict[int, Numbers] = {}
    rows: list[tuple[int, int, int]] = []
    for number, file in enumerate(files):
        for line, text in enumerate(_text(file).splitlines()):
            if text.strip():
                where = f"{file}, line {line + 1}"
                values = _numbers(text, where)
                tables.setdefault(len(values), Numbers("keypoints")).add(values, where)
                rows.append((number, line, len(values)))
    if not rows:
        raise UserError(f"{path}: all {len(files):,} label files are empty.")
    number, line, length = np.array(rows).T
    labels = _Labels(number, line, length, np.full((len(rows), max(tables)), np.nan, np.float32))
    if max(tables) - min(tables) > 2:
        few = min(tables, key=lambda length: tables[length].rows)
        others = ", ".join(str(length) for length in sorted(tables)[:10] if length != few)
        place = _place(files, labels, labels.length == few)
        raise UserError(f"{place} has {few} numbers, other rows {others}. Expected the same keypoints in every row.")
    for length, table in tables.items():
        labels.values[labels.length == length, :length] = table.array()
    box, kind = labels.values[:, :5], labels.values[:, 0]
    wrong = ~np.all(np.isfinite(box), axis=1) | (kind < 0) | (kind != np.floor(kind))
    if wrong.any():
        raise UserError(
            f"{_place(files, labels, wrong)} begins {box[wrong][0].tolist()}, expected a class (a whole number "
            "from 0 up) and a box of four shares of the image."
        )
    return labels


def _place(files: list[Path], labels: _Labels, rows: np.ndarray) -> str:
    first = int(np.argmax(rows))
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
        return read_bytes(file).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(f"{file} cannot be read as text: {error}") from None


LABELS = FileFormat("ultralytics", "Ultralytics labels", _are_labels, _read_labels, ".txt", "placed")


# Results as JSON: the list that ``to_json()`` gives for an image, or a list of such lists.


def _are_results(peek: Peek) -> bool:
    first = peek.first_json
    keys = set(first.json_keys)
    nested = not keys and all(f'"{key}"' in first.text for key in ("box", "keypoints", "confidence"))
    return first.json_sign == "[" and (nested or ({"box", "keypoints", "class"} <= keys and "image_id" not in keys))


class _Results:
    """What has been read so far."""

    def __init__(self, path: Path) -> None:
        self.x, self.y, self.seen = Numbers("x"), Numbers("y"), Numbers("visible")
        self.bodies = Bodies(path)

    def add(self, body: Any, file: Path, frame: int | None, where: str) -> None:
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
    names, notes = names_for(path, keypoints.shape[1], COCO, options, keypoints)
    blank = (keypoints == 0).all(-1)  # what weak keypoints are set to
    confidence = np.where(blank, np.float32(0), found.seen.array())
    return pose_data(path, names, keypoints, confidence, found.bodies.identity(), notes=notes)


RESULTS = FileFormat("ultralytics_json", "Ultralytics results (JSON)", _are_results, _read_results, ".json", "shares")
