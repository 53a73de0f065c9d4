"""Read JSON of MediaPipe's landmarks, as scripts of many hands write it: a list of frames, of bodies, of landmarks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.container import PoseData
from uplift.datasets.coco_json import JsonText
from uplift.errors import UserError
from uplift.readers.base import Peek, ReadOptions
from uplift.readers.csv_identity import Identity, bodies_of
from uplift.readers.json_file import items
from uplift.readers.mediapipe_bodies import bodies_in, is_list_of_marks, is_number, plain_key, values_of, values_of_all
from uplift.readers.mediapipe_landmarks import NO_DEPTH, landmark_names, placed, without_flags
from uplift.readers.table_rows import frame_numbers

__all__ = ["looks_like_mediapipe_json", "read_mediapipe_json"]

_FRAMES = ("frames", "data", "results", "landmarks", "poselandmarks", "poses", "sequence", "predictions")
_NUMBER = ("frame", "framenumber", "frameindex", "frameidx", "frameid", "index")
_TOLD = {
    "fps": "fps", "framerate": "fps", "width": "width", "height": "height", "imagewidth": "width",
    "imageheight": "height", "videowidth": "width", "videoheight": "height", "framewidth": "width",
    "frameheight": "height",
}  # fmt: skip


def looks_like_mediapipe_json(peek: Peek) -> bool:
    """Return whether JSON speaks of landmarks, or has x and y with a visibility or a depth."""
    if not peek.json_sign:
        return False
    if re.search(r'"(pose_?)?(world_?|normalized_?)?landmarks?"', peek.text, re.IGNORECASE):
        return True
    return bool(re.search(r'"x"\s*:\s*-?[\d.]', peek.text) and re.search(r'"(visibility|z)"\s*:', peek.text))


def read_mediapipe_json(path: Path, options: ReadOptions) -> PoseData:
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
    return placed(read.finished(options), options)


class _Read:
    """What has been read of the file so far."""

    def __init__(self, path: Path):
        self.path = path
        self.told: dict[str, float] = {}
        self.names: list[str] = []
        self.rows: list[np.ndarray] = []
        self.frame: list[float] = []
        self.deep = False

    def tell(self, key: str, value: Any) -> None:
        """Take what the file says of the whole video."""
        if isinstance(value, dict):
            for inner, one in value.items():
                if not isinstance(one, dict | list):
                    self.tell(inner, one)
        elif plain_key(key) in ("imagesize", "resolution") and isinstance(value, list) and len(value) == 2:
            self.tell("width", value[0])
            self.tell("height", value[1])
        elif plain_key(key) in _TOLD and is_number(value) and 0 < value < 1e6:
            self.told[_TOLD[plain_key(key)]] = float(value)

    def add(self, place: int, number: float | None, frame: Any) -> None:
        """Take the bodies of a frame; ``place`` counts frames."""
        if isinstance(frame, dict):
            keys = {plain_key(key): key for key in frame}
            own = next((frame[keys[key]] for key in _NUMBER if key in keys), None)
            number = float(own) if is_number(own) else number
        for body in bodies_in(frame, self._where(place), 0):
            self._add_body(body, self._where(place))
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
        found = Identity({"sequence": np.full(len(frame), self.path.stem), "frame": frame}, self.told.get("fps"))
        if {"width", "height"} <= set(self.told):
            found.image_size = int(self.told["width"]), int(self.told["height"])
        names, notes = landmark_names(self.path, self.names, options)
        notes = (*notes, NO_DEPTH) if self.deep else notes
        return bodies_of(self.path, found, keypoints, without_flags(scores, keypoints), names, notes)

    def _where(self, place: int) -> str:
        return f"{self.path}, frame {place} of the file"

    def _add_body(self, body: list[tuple[str, Any]], where: str) -> None:
        names = [name for name, _ in body]
        if not self.names:
            self.names = names
        if names != self.names:
            raise UserError(
                f"{where}: {len(names)} landmarks, expected the {len(self.names)} that the first frame has."
            )
        marks = [mark for _, mark in body]
        values = values_of_all(marks)  # most files are so, and it takes a fifth of the time
        if values is None:
            values = np.array([self._numbers(name, mark, where) for name, mark in body], np.float64)
        self.deep = self.deep or any("z" in mark if isinstance(mark, dict) else len(mark) > 2 for mark in marks)
        with np.errstate(over="ignore", invalid="ignore"):
            self.rows.append(values.astype(np.float32))

    def _numbers(self, name: str, mark: Any, where: str) -> tuple[float, float, float]:
        values = values_of(mark)
        if values is None:
            raise UserError(f"{where}: landmark '{name}' is {mark!r:.60}, expected numbers x and y.")
        return values


def _frames(path: Path, read: _Read) -> Iterator[tuple[int, float | None, Any]]:
    """Yield place, number where the file says one, and content of each frame; the rest is told to ``read``."""
    text = JsonText(path)
    if text.next_sign() == "[":
        at = text.at
        first = list(islice(items(text, "the file"), 1))
        text.at = at
        if is_list_of_marks(first):  # one frame, or one image
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
        if not done and plain_key(key) in _FRAMES and text.next_sign() == "[":
            kept = list(items(text, f"'{key}'"))
            if not is_list_of_marks(kept):
                yield from ((place, None, frame) for place, frame in enumerate(kept))
                done = bool(kept)
                continue
            rest[key] = kept
            continue
        value = text.value()
        read.tell(key, value)
        rest[key] = value
    if done:
        return
    world = next((v for k, v in rest.items() if "world" in plain_key(k) and isinstance(v, list)), None)
    if world and not is_list_of_marks(world):
        yield from ((place, None, frame) for place, frame in enumerate(world))
        return
    numbers = [re.fullmatch(r"(?:frame)?[ _]?(\d{1,15})", key, re.IGNORECASE) for key in rest]
    if rest and all(numbers):  # frames by their number
        yield from ((at, float(one[1]), rest[one[0]]) for at, one in enumerate(numbers) if one)
    else:
        nested = next((v for k, v in rest.items() if plain_key(k) in _FRAMES and isinstance(v, dict)), None)
        yield 0, None, nested if nested is not None else rest
