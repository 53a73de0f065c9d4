"""MediaPipe, which writes no files itself: landmarks as scripts keep them in csv, JSON or npz."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.csv import Identity, bodies_of, columns_in, read_columns
from uplift.data.formats.layouts import HAND21, POSE33, Layouts, is_nameless, names_for
from uplift.data.formats.rows import confidence_of, frame_numbers
from uplift.data.formats.scales import SHARES_NOTE
from uplift.data.parsers.json import JsonText, items
from uplift.data.parsers.npz import read_arrays
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]

# What the files of MediaPipe have in common: the landmarks' names, and coordinates that are shares of the image.

_NO_DEPTH = "z of MediaPipe is left out: it is an estimate of the same network, not a measurement"
_TELLING = {"lefteyeinner", "mouthleft", "leftfootindex", "leftpinky", "indexfingermcp", "ringfingerpip"}
_WORLD_NOTE = (
    "world landmarks, in metres about the hips and seen straight on, without perspective: x and y are taken as they "
    "are; landmarks of the image are better"
)
_PIXEL_NOTE = "coordinates go beyond any share of an image: taken as pixels"
_LARGEST_SHARE = 5.0
_AT_HIPS = 0.02


_FACE = tuple(f"face_{number}" for number in range(478))
_HANDS = tuple(f"{side}_hand_{name}" for side in ("left", "right") for name in HAND21)
_BODY = "MediaPipe's pose"
_COUNTS: Layouts = {
    33: (_BODY, POSE33),
    21: ("a hand", HAND21),
    468: ("MediaPipe's face", _FACE[:468]),
    478: ("MediaPipe's face", _FACE),
    75: (f"{_BODY} and both hands", (*POSE33, *_HANDS)),
    501: (f"{_BODY} and face", (*POSE33, *_FACE[:468])),
    543: (f"{_BODY}, face and both hands", (*POSE33, *_FACE[:468], *_HANDS)),
}


def _is_mediapipe(names: Sequence[str]) -> bool:
    """Return whether some of the names are ones that only MediaPipe gives."""
    return bool(_TELLING & {re.sub(r"[^a-z]", "", name.casefold().split(".")[-1]) for name in names})


def _landmark_names(path: Path, names: Sequence[str], options: ReadOptions) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of landmarks that a file names or only numbers, and the notes that say so."""
    if not is_nameless(names):
        return tuple(name.split(".")[-1] for name in names), ()  # PoseLandmark.NOSE, as Python prints it
    numbers = [int(re.sub(r"\D", "", name)) for name in names]
    if len(names) not in _COUNTS and options.layout is None and max(numbers, default=99) < len(POSE33):
        note = f"landmarks have no names in the file: numbers are taken as {_BODY}'s"
        return tuple(POSE33[number] for number in numbers), (note,)
    return names_for(path, len(names), _COUNTS, options)


def _without_flags(scores: np.ndarray | None, keypoints: np.ndarray) -> np.ndarray | None:
    """Return the visibility, with landmarks that never have one (hands, faces) as visible where they are.

    ``scores`` are (rows joints), ``keypoints`` (rows joints 2).
    """
    if scores is None:
        return None
    never = ~(scores > 0).any(0)
    if not never.any():
        return scores
    there = np.isfinite(keypoints).all(-1) & (keypoints != 0).any(-1)
    return np.where(never, there.astype(np.float32), scores)


def _placed(data: PoseData, options: ReadOptions) -> PoseData:
    """Return the keypoints in pixels, where they are shares of an image whose size is known; a note says what they are."""
    seen = data.keypoints[data.confidence > 0]
    size = options.image_size or data.image_size
    if np.quantile(np.abs(seen), 0.99) > _LARGEST_SHARE:
        return replace(data, notes=(*data.notes, _PIXEL_NOTE))
    if _is_world(data, seen):
        return replace(data, notes=(*data.notes, _WORLD_NOTE))
    if size is None:
        return replace(data, notes=(*data.notes, SHARES_NOTE))
    return replace(data, keypoints=data.keypoints * np.array(size, np.float32), image_size=size)


def _is_world(data: PoseData, seen: np.ndarray) -> bool:
    """Return whether coordinates are about the hips' middle, or about any middle where there are no hips."""
    names = [name.casefold() for name in data.joint_names]
    if "left_hip" in names and "right_hip" in names:
        hips = [names.index("left_hip"), names.index("right_hip")]
        both = (data.confidence[:, hips] > 0).all(1)
        if both.any():
            middle = data.keypoints[both][:, hips].mean(1)
            return bool((np.median(np.abs(middle), 0) < _AT_HIPS).all())
    return bool(((seen < 0).mean(0) > 0.2).all())


# Find the landmarks of bodies in whatever lists and objects stand around them.

_BODIES = (
    "poselandmarks", "posenormalizedlandmarks", "landmarks", "landmark", "normalizedlandmarks", "keypoints", "pose",
    "poses", "people", "persons", "results", "handlandmarks", "multihandlandmarks", "facelandmarks", "data",
    "poseworldlandmarks", "worldlandmarks",
)  # fmt: skip
"""Keys that lead to landmarks, the image's before the world's."""
_SCORES = ("visibility", "score", "confidence")
_NAMES_IN_ORDER = ("name", "part", "landmark", "landmark_name", "label")
_NAMES = frozenset(_NAMES_IN_ORDER)
_LARGEST = 1e300
_DEEPEST = 6


def _bodies_in(value: Any, where: str, depth: int) -> Iterator[list[tuple[str, Any]]]:
    """Yield the bodies in whatever lists and objects stand around their landmarks, as (name, landmark) each."""
    if depth > _DEEPEST:
        raise UserError(f"{where}: lists in lists, deeper than any landmarks are.")
    if value is None or value == [] or value == {}:
        return
    if isinstance(value, list):
        value = _split(value) or value
        if _is_list_of_marks(value):
            yield [(_name(mark, place), mark) for place, mark in enumerate(value)]
            return
        for one in value:
            yield from _bodies_in(one, where, depth + 1)
    elif isinstance(value, dict):
        keys = {_plain_key(key): key for key in value}
        known = next((keys[key] for key in _BODIES if key in keys and value[keys[key]]), None)
        marks = {key: mark for key, mark in value.items() if _is_mark(mark)}
        if known is not None:
            yield from _bodies_in(value[known], where, depth + 1)
        elif marks:
            yield list(marks.items())
        elif not any(key in keys for key in _BODIES):
            raise UserError(f"{where}: no landmarks among {', '.join(map(repr, list(value)[:6]))}.")
    else:
        raise UserError(f"{where}: {value!r:.60}, expected landmarks.")


def _split(value: list[Any]) -> list[list[Any]] | None:
    """Return the landmarks of a list of bare numbers; None for any other list."""
    if len(value) < 42 or not all(_is_number(one) for one in value):
        return None
    width = next((n for n in (4, 3, 2, 5) if len(value) % n == 0 and len(value) // n in _COUNTS), None)
    return None if width is None else [value[at : at + width] for at in range(0, len(value), width)]


def _is_list_of_marks(value: Any) -> bool:
    """Return whether a list begins with a landmark."""
    return isinstance(value, list) and bool(value) and _is_mark(value[0])


def _is_mark(value: Any) -> bool:
    if isinstance(value, dict):
        return "x" in value and "y" in value
    return isinstance(value, list) and 2 <= len(value) <= 5 and all(_is_number(n) or n is None for n in value)


def _name(mark: Any, place: int) -> str:
    if isinstance(mark, dict) and not _NAMES.isdisjoint(mark):
        name = next(mark[key] for key in _NAMES_IN_ORDER if key in mark)
        if isinstance(name, str) and name:
            return name
    return str(place)


def _values_of(mark: Any, name: str, where: str) -> tuple[float, float, float]:
    """Return x, y and visibility, NaN for what is null or not there; raises UserError where they are not numbers."""
    found: list[Any] = ["no landmark"]
    if isinstance(mark, dict):
        found = [mark.get("x"), mark.get("y"), next((mark[key] for key in _SCORES if key in mark), None)]
    elif isinstance(mark, list) and 2 <= len(mark) <= 5:
        found = [mark[0], mark[1], mark[3] if len(mark) > 3 else None]
    if not all(one is None or _is_number(one) for one in found):
        raise UserError(f"{where}: landmark '{name}' is {mark!r:.60}, expected numbers x and y.")
    x, y, score = (np.nan if one is None else min(max(float(one), -_LARGEST), _LARGEST) for one in found)
    return x, y, score


def _values_of_all(marks: list[Any]) -> np.ndarray | None:
    """Return what `_values_of` would of each, (marks, 3), where all are objects with numbers; None for any others."""
    try:
        flat = [value for mark in marks for value in (mark["x"], mark["y"], mark[_SCORES[0]])]
        if not set(map(type, flat)) <= {float, int}:
            return None
        values = np.array(flat, np.float64)
    except (KeyError, TypeError, OverflowError):
        return None
    return values.reshape(-1, 3) if (np.abs(values) < _LARGEST).all() else None


def _is_number(value: Any) -> TypeGuard[int | float]:
    """Return whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e308


def _plain_key(key: str) -> str:
    """Return the letters of a key, small."""
    return re.sub(r"[^a-z]", "", key.casefold())


# Read csv files of MediaPipe's landmarks: a row per frame, or a row per landmark.


def _looks_like_mediapipe_csv(peek: Peek) -> bool:
    """Return whether a csv has landmarks of MediaPipe, by name, or by number with as many as MediaPipe has."""
    columns = columns_in(peek)
    if columns is None:
        return False
    if columns.name is None:
        names = [name for name in columns.joints if not _is_world_column(name)] or list(columns.joints)
        deep = all(joint.z is not None for joint in columns.joints.values())
        return _is_mediapipe(names) or (is_nameless(names) and len(names) in _COUNTS and deep)
    lines = [line for line in peek.lines if line.strip()][:600]
    head, *names = [
        row[columns.name].strip(' "')
        for row in (line.replace(";", ",").replace("\t", ",").split(",") for line in lines)
        if len(row) > columns.name
    ]
    numbered = is_nameless(names) and columns.joints[""].z is not None and bool(names)
    return _is_mediapipe(names) or (numbered and ("landmark" in head.casefold() or head.casefold() == "id"))


def _read_mediapipe_csv(peek: Peek, options: ReadOptions) -> PoseData:
    """Read landmarks of the image, in pixels where its size is known, or of the world, in metres.

    Raises:
        UserError: no columns of landmarks, rows of different lengths, text where numbers must be.
    """
    path, columns = peek.path, columns_in(peek)
    if columns is None:
        raise UserError(
            f"{path} has no columns of landmarks; expected frame, landmark, x, y, z, or x1, y1, z1, v1, x2, ... "
            "of MediaPipe."
        )
    notes: tuple[str, ...] = ()
    image = {name: joint for name, joint in columns.joints.items() if not _is_world_column(name)}
    if image and len(image) < len(columns.joints):
        columns = replace(columns, joints=image)
        notes = ("world landmarks are left out, those of the image are taken",)
    if any(joint.z is not None for joint in columns.joints.values()):
        notes = (*notes, _NO_DEPTH)
    data = read_columns(path, columns, lambda names, _: _landmark_names(path, names, options), _without_flags)
    return _placed(replace(data, notes=(*data.notes, *notes)), options)


def _is_world_column(name: str) -> bool:
    return "world" in name.casefold()


# Read JSON of MediaPipe's landmarks, as scripts of many hands write it: a list of frames, of bodies, of landmarks.

_FRAMES = ("frames", "data", "results", "landmarks", "poselandmarks", "poses", "sequence", "predictions")
_NUMBER = ("frame", "framenumber", "frameindex", "frameidx", "frameid", "index")
_FACTS = {
    "fps": "fps", "framerate": "fps", "width": "width", "height": "height", "imagewidth": "width",
    "imageheight": "height", "videowidth": "width", "videoheight": "height", "framewidth": "width",
    "frameheight": "height",
}  # fmt: skip


def _looks_like_mediapipe_json(peek: Peek) -> bool:
    """Return whether JSON speaks of landmarks, or has x and y with a visibility or a depth."""
    if not peek.json_sign:
        return False
    if re.search(r'"(pose_?)?(world_?|normalized_?)?landmarks?"', peek.text, re.IGNORECASE):
        return True
    return bool(re.search(r'"x"\s*:\s*-?[\d.]', peek.text) and re.search(r'"(visibility|z)"\s*:', peek.text))


def _read_mediapipe_json(path: Path, options: ReadOptions) -> PoseData:
    """Read landmarks of the image, in pixels where its size is known, or of the world, in metres.

    Raises:
        UserError: damaged JSON, no landmarks, or frames with different landmarks.
    """
    read = _Read(path)
    try:
        for place, number, frame in _frames(path, read):
            read.add(place, number, frame)
    except RecursionError:
        raise UserError(f"{path}: lists in lists, deeper than any landmarks are.") from None
    return _placed(read.finished(options), options)


class _Read:
    """What has been read of the file so far."""

    def __init__(self, path: Path):
        self.path = path
        self.facts: dict[str, float] = {}
        self.names: list[str] = []
        self.rows: list[np.ndarray] = []
        self.frame: list[float] = []
        self.deep = False

    def add_fact(self, key: str, value: Any) -> None:
        """Take what the file says about the video."""
        if isinstance(value, dict):
            for inner, one in value.items():
                if not isinstance(one, dict | list):
                    self.add_fact(inner, one)
        elif _plain_key(key) in ("imagesize", "resolution") and isinstance(value, list) and len(value) == 2:
            self.add_fact("width", value[0])
            self.add_fact("height", value[1])
        elif _plain_key(key) in _FACTS and _is_number(value) and 0 < value < 1e6:
            self.facts[_FACTS[_plain_key(key)]] = float(value)

    def add(self, place: int, number: float | None, frame: Any) -> None:
        """Take the bodies of a frame; ``place`` counts frames."""
        if isinstance(frame, dict):
            keys = {_plain_key(key): key for key in frame}
            given = next((frame[keys[key]] for key in _NUMBER if key in keys), None)
            number = float(given) if _is_number(given) else number
        where = f"{self.path}, frame {place} of the file"
        for body in _bodies_in(frame, where, 0):
            self._add_body(body, where)
            self.frame.append(float(place) if number is None else number)

    def finished(self, options: ReadOptions) -> PoseData:
        """Return all that was taken."""
        if not self.rows:
            raise UserError(
                f"{self.path}: no landmarks in it, expected a list of {{x, y, z, visibility}} for each frame."
            )
        values = np.stack(self.rows)
        frame = frame_numbers(self.path, np.array(self.frame))
        scores = None if np.isnan(values[..., 2]).all() else values[..., 2]
        keypoints = np.ascontiguousarray(values[..., :2])
        found = Identity({"sequence": np.full(len(frame), self.path.stem), "frame": frame}, self.facts.get("fps"))
        if {"width", "height"} <= set(self.facts):
            found.image_size = int(self.facts["width"]), int(self.facts["height"])
        names, notes = _landmark_names(self.path, self.names, options)
        notes = (*notes, _NO_DEPTH) if self.deep else notes
        return bodies_of(self.path, found, keypoints, _without_flags(scores, keypoints), names, notes)

    def _add_body(self, body: list[tuple[str, Any]], where: str) -> None:
        names = [name for name, _ in body]
        if not self.names:
            self.names = names
        if names != self.names:
            raise UserError(
                f"{where}: {len(names)} landmarks, expected the {len(self.names)} that the first frame has."
            )
        marks = [mark for _, mark in body]
        values = _values_of_all(marks)  # most files are so, and it takes a fifth of the time
        if values is None:
            values = np.array([_values_of(mark, name, where) for name, mark in body], np.float64)
        self.deep = self.deep or any("z" in mark if isinstance(mark, dict) else len(mark) > 2 for mark in marks)
        with np.errstate(over="ignore", invalid="ignore"):
            self.rows.append(values.astype(np.float32))


def _frames(path: Path, read: _Read) -> Iterator[tuple[int, float | None, Any]]:
    """Yield place, number where the file says one, and content of each frame; ``read`` takes the rest."""
    text = JsonText(path)
    if text.next_sign() == "[":
        at = text.at
        first = list(islice(items(text, "the file"), 1))
        text.at = at
        if _is_list_of_marks(first):  # one frame, or one image
            yield 0, None, text.value()
            return
        for place, frame in enumerate(items(text, "the file")):
            yield place, None, frame
        return
    if text.next_sign() != "{":
        raise UserError(f"{path} begins {text.text[:20]!r}, expected frames of landmarks.")
    rest: dict[str, Any] = {}
    done = False
    for key in text.members():
        if not done and _plain_key(key) in _FRAMES and text.next_sign() == "[":
            kept = list(items(text, f"'{key}'"))
            if not _is_list_of_marks(kept):
                yield from ((place, None, frame) for place, frame in enumerate(kept))
                done = bool(kept)
                continue
            rest[key] = kept
            continue
        value = text.value()
        read.add_fact(key, value)
        rest[key] = value
    if done:
        return
    world = next((v for k, v in rest.items() if "world" in _plain_key(k) and isinstance(v, list)), None)
    if world and not _is_list_of_marks(world):
        yield from ((place, None, frame) for place, frame in enumerate(world))
        return
    numbers = [re.fullmatch(r"(?:frame)?[ _]?(\d{1,15})", key, re.IGNORECASE) for key in rest]
    if rest and all(numbers):  # frames by their number
        yield from ((at, float(one[1]), rest[one[0]]) for at, one in enumerate(numbers) if one)
    else:
        nested = next((v for k, v in rest.items() if _plain_key(k) in _FRAMES and isinstance(v, dict)), None)
        yield 0, None, nested if nested is not None else rest


# Read npz files of MediaPipe's landmarks: an array (frames, landmarks, 2 to 5) of x, y, z, visibility and presence.

_FRAME_KEYS = ("frame", "frames", "frame_number", "frame_numbers", "frame_idx", "frame_index")
_FLAGS = ("visibility", "visibilities", "confidence", "scores")


def _read_mediapipe_npz(path: Path, options: ReadOptions) -> PoseData:
    """Read landmarks of one or several bodies.

    Raises:
        UserError: no such array, pickled objects, or another shape.
    """
    arrays = read_arrays(path)
    name = _chosen(tuple(arrays))
    if name is None:
        shown = ", ".join(sorted(arrays)) or "nothing"
        raise UserError(f"{path}: no array of landmarks (found: {shown}), expected 'landmarks' (frames, 33, 4).")
    values = _landmarks(path, name, arrays[name])
    frames, bodies, joints = values.shape[:3]
    notes = [_NO_DEPTH] if values.shape[3] > 2 else []
    flags = next((arrays[key] for key in _FLAGS if key in arrays), None)
    scores = values[..., 3] if values.shape[3] > 3 else None
    if scores is None and flags is not None and flags.dtype.kind in "fiub" and flags.size == frames * bodies * joints:
        scores = flags.reshape(frames, bodies, joints).astype(np.float32)
    numbers = next((arrays[key] for key in _FRAME_KEYS if key in arrays), np.arange(frames))
    if numbers.shape != (frames,) or numbers.dtype.kind not in "fiu":
        raise UserError(f"{path}: frame numbers are {numbers.dtype} of shape {numbers.shape}, expected ({frames},).")
    frame = frame_numbers(path, numbers.astype(np.float64), once=True)
    keypoints = np.ascontiguousarray(values[..., :2]).reshape(-1, joints, 2)
    scores = _without_flags(None if scores is None else scores.reshape(-1, joints), keypoints)
    found = Identity({"sequence": np.full(frames * bodies, path.stem), "frame": np.repeat(frame, bodies)}, notes=notes)
    names, more = _landmark_names(path, [str(number) for number in range(joints)], options)
    found.fps, found.image_size = _number(arrays, "fps"), _size(arrays)
    seen = (confidence_of(keypoints, scores) > 0).any(1)  # places for bodies that a frame does not have
    found.values = {key: value[seen] for key, value in found.values.items()}
    data = bodies_of(path, found, keypoints[seen], None if scores is None else scores[seen], names, more)
    return _placed(data, options)


def _chosen(names: tuple[str, ...]) -> str | None:
    """Return the array of landmarks, those of the image rather than the world's."""
    fitting = [name for name in names if "landmark" in name.casefold() and "name" not in name.casefold()]
    return min(fitting, key=lambda name: ("world" in name.casefold(), "pose" not in name.casefold()), default=None)


def _landmarks(path: Path, name: str, array: np.ndarray) -> np.ndarray:
    """Return (frames bodies landmarks numbers) float32; rows of 132 numbers are 33 landmarks of four."""
    if array.dtype.kind not in "fiu":
        raise UserError(f"{path}: '{name}' is {array.dtype}, expected numbers (frames, 33, 4).")
    if array.ndim == 2 and array.shape[1] not in (2, 3, 4, 5):
        four = next((n for n in (4, 3, 5, 2) if array.shape[1] % n == 0 and array.shape[1] // n in _COUNTS), None)
        array = array if four is None else array.reshape(len(array), -1, four)
    elif array.ndim == 2:
        array = array[None]  # one image
    array = array[:, None] if array.ndim == 3 else array
    if array.ndim != 4 or array.shape[3] not in (2, 3, 4, 5) or not array.size:
        raise UserError(f"{path}: '{name}' has shape {array.shape}, expected (frames, landmarks, 2 to 5).")
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(np.float32)


def _number(arrays: dict[str, np.ndarray], name: str) -> float | None:
    array = arrays.get(name)
    if array is None or array.size != 1 or array.dtype.kind not in "fiu" or not 0 < array.item() < 1e5:
        return None
    return float(array.item())


def _size(arrays: dict[str, np.ndarray]) -> tuple[int, int] | None:
    """Return width and height where the file has them."""
    both = arrays.get("image_size")
    sides = both.ravel().tolist() if both is not None else [_number(arrays, side) or 0 for side in ("width", "height")]
    if len(sides) != 2 or not all(_is_number(side) and 1 <= side < 1e6 for side in sides):
        return None
    return int(sides[0]), int(sides[1])


# Which of the three a file is.


def _fits(peek: Peek) -> bool:
    if peek.npz_names:
        return "joint_names" not in peek.npz_names and _chosen(peek.npz_names) is not None
    return _looks_like_mediapipe_json(peek) or _looks_like_mediapipe_csv(peek)


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    if peek.npz_names:
        return _read_mediapipe_npz(peek.path, options)
    return _read_mediapipe_json(peek.path, options) if peek.json_sign else _read_mediapipe_csv(peek, options)


FORMAT = FileFormat("mediapipe", "landmarks of MediaPipe (csv, json, npz)", _fits, _read, coordinates="placed")
