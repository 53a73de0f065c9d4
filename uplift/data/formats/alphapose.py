"""AlphaPose and Halpe: COCO's list of results with names of images, tracks, and more layouts; or objects by image."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.formats.layouts import ALPHAPOSE, names_for
from uplift.data.formats.rows import pose_data, video_names
from uplift.data.parsers.json import Numbers, entries, is_text, json_files, load_json, members, shown, texts
from uplift.data.parsers.pictures import PHOTO_ENDINGS
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    if peek.is_folder:
        first = peek.first_json
        return first is not None and "bodies" in first.json_keys
    keys = set(peek.json_keys)
    if peek.json_sign == "{":
        return "bodies" in keys or (bool(keys) and all(key.lower().endswith(PHOTO_ENDINGS) for key in peek.json_keys))
    named = peek.text.replace(" ", "").replace("\n", "").find('"image_id":"') >= 0
    return peek.json_sign == "[" and {"image_id", "keypoints"} <= keys and (named or bool(keys & {"idx", "box"}))


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    numbers = Numbers("keypoints")
    images: list[str] = []
    tracks: list[str] = []
    for image, values, track, where in _bodies(path):
        numbers.add(values, where)
        images.append(image)
        tracks.append(track)
    if not numbers.rows:
        raise UserError(f"{path} holds nobody, expected results of AlphaPose.")
    if not numbers.width or numbers.width % 3:
        raise UserError(f"{path} has {numbers.width} numbers in 'keypoints', expected x, y, score of each.")
    values = numbers.array(numbers.width // 3, 3)
    names, notes = names_for(path, values.shape[1], ALPHAPOSE, options, values)
    identity = _identity(path, images, tracks)
    return pose_data(path, names, values[..., :2], values[..., 2], identity, notes=notes)


def _bodies(path: Path) -> Iterator[tuple[str, Any, str, str]]:
    """Yield image, keypoints, track and place of everyone in the file or folder."""
    for file in json_files(path):
        first = Peek(file)
        if first.json_sign == "[":
            for count, record in entries(file, "the list of results"):
                where = f"{file}: entry {count}"
                yield _image(record.get("image_id"), where), record.get("keypoints"), _track(record, where), where
        elif path.is_dir() or "bodies" in first.json_keys:
            yield from _people(load_json(file), file.stem, str(file))
        else:
            for image, value in members(file):
                yield from _people(value.value(), image, f"{file}: {image:.60}")


def _people(value: Any, image: str, where: str) -> Iterator[tuple[str, Any, str, str]]:
    """Yield everyone in one image, as AlphaPose writes them with ``--format cmu`` or ``open``."""
    people = value.get("bodies", value.get("people")) if isinstance(value, dict) else None
    if not isinstance(people, list):
        raise UserError(f"{where} has neither 'bodies' nor 'people', expected AlphaPose's results of an image.")
    for count, body in enumerate(people):
        place = f"{where}: body {count}"
        if not isinstance(body, dict):
            raise UserError(f"{place} is {shown(body)}, expected an object.")
        yield image, body.get("joints", body.get("pose_keypoints_2d")), "", place


def _image(value: Any, where: str) -> str:
    if is_text(value) or type(value) is int:
        return str(value)
    raise UserError(f"{where} has image_id {shown(value)}, expected the name of an image.")


def _track(record: dict[str, Any], where: str) -> str:
    """Return the track's number as text; it may stand in a list, and as 1.0."""
    track = record.get("idx")
    while isinstance(track, list) and len(track) == 1:
        track = track[0]
    if track is None or track == [] or isinstance(track, list):  # several are those of a merged track
        return ""
    if isinstance(track, bool) or not isinstance(track, int | float | str):
        raise UserError(f"{where} has idx {shown(track)}, expected the number of a track.")
    return str(int(track)) if isinstance(track, float) and track.is_integer() else str(track)


def _identity(path: Path, images: list[str], tracks: list[str]) -> dict[str, np.ndarray]:
    """Return sequence, frame and track where the images are those of a video; image and entry otherwise."""
    stems = [name[: name.rindex(".")] if name.lower().endswith(PHOTO_ENDINGS) else name for name in images]
    video = video_names(stems, path.stem)
    if video is None:
        return {"image": texts(path, images), "instance": np.arange(len(images)).astype(str)}
    found = {"sequence": texts(path, video[0]), "frame": np.array(video[1], np.int64)}
    return {**found, "instance": texts(path, tracks)} if any(tracks) else found


FORMAT = Format("alphapose", "AlphaPose results", _fits, _read, ".json")
