"""AlphaPose and Halpe: COCO's list of results with names of images, tracks, and more layouts; or objects by image."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import ALPHAPOSE, names_for
from uplift.data.formats.rows import Bodies, name_of, pose_data, track_of
from uplift.data.parsers.json import Numbers, entries, json_files, load_json, members, shown
from uplift.data.parsers.pictures import PHOTO_ENDINGS
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    if peek.is_folder:
        return "bodies" in peek.first_json.json_keys
    keys = set(peek.json_keys)
    if peek.json_sign == "{":
        return "bodies" in keys or (bool(keys) and all(key.lower().endswith(PHOTO_ENDINGS) for key in peek.json_keys))
    named = peek.text.replace(" ", "").replace("\n", "").find('"image_id":"') >= 0
    return peek.json_sign == "[" and {"image_id", "keypoints"} <= keys and (named or bool(keys & {"idx", "box"}))


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    numbers, bodies, images = Numbers("keypoints"), Bodies(path), []
    for image, values, track, where in _bodies(path):
        numbers.add(values, where)
        bodies.add(image[: image.rindex(".")] if image.lower().endswith(PHOTO_ENDINGS) else image, track=track)
        images.append(image)
    if not images:
        raise UserError(f"{path} has no bodies, expected results of AlphaPose.")
    values = numbers.triples(path)
    names, notes = names_for(path, values.shape[1], ALPHAPOSE, options, values)
    identity = bodies.identity()
    if "image" in identity:
        identity = bodies.images(images)
    return pose_data(path, names, values[..., :2], values[..., 2], identity, notes=notes)


def _bodies(path: Path) -> Iterator[tuple[str, Any, str, str]]:
    """Yield image, keypoints, track and place of everyone in the file or folder."""
    for file in json_files(path):
        first = Peek(file)
        if first.json_sign == "[":
            for count, record in entries(file, "the list of results"):
                where = f"{file}: entry {count}"
                image = name_of(record.get("image_id"), where, "image_id")
                number = record.get("idx")
                while isinstance(number, list):  # several are those of a merged track
                    number = number[0] if len(number) == 1 else None
                track = track_of(number, where, "idx", (int, float, str))
                yield image, record.get("keypoints"), track, where
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


FORMAT = FileFormat("alphapose", "AlphaPose results", _fits, _read, ".json")
