"""Ultralytics' results as JSON: the list that ``to_json()`` gives for an image, or a list of such lists."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.formats.layouts import COCO, names_for
from uplift.data.formats.rows import frames_or_images, pose_data, to_pixels
from uplift.data.parsers.json import JsonText, Numbers, first_json, is_text, items, json_files, shown, texts
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    first = first_json(peek)
    if first is None or first.json_sign != "[":
        return False
    keys = set(first.json_keys)
    if not keys:  # images as lists in a list
        return all(f'"{key}"' in first.text for key in ("box", "keypoints", "confidence"))
    return {"box", "keypoints", "class"} <= keys and "image_id" not in keys


class _Found:
    """What has been read so far."""

    def __init__(self) -> None:
        self.x, self.y, self.seen = Numbers("x"), Numbers("y"), Numbers("visible")
        self.file: list[int] = []
        self.frame: list[int | None] = []
        self.track: list[str] = []
        self.category: list[str] = []

    def add(self, body: Any, file: int, frame: int | None, where: str) -> None:
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
        track, name = body.get("track_id"), body.get("name", body.get("class"))
        if isinstance(track, bool) or not isinstance(track, int | str | None):
            raise UserError(f"{where} has track_id {shown(track)}, expected a number.")
        self.track.append("" if track is None else str(track))
        self.category.append(str(name) if is_text(name) or type(name) is int else "")
        self.file.append(file)
        self.frame.append(frame)


def _read(path: Path, options: ReadOptions) -> PoseData:
    files, found = json_files(path), _Found()
    for number, file in enumerate(files):
        for count, entry in enumerate(items(JsonText(file), "the list of results")):
            if not isinstance(entry, list):
                found.add(entry, number, None, f"{file}: entry {count}")
                continue
            for place, body in enumerate(entry):
                found.add(body, number, count, f"{file}: frame {count}, entry {place}")
    if not found.file:
        raise UserError(f"{path} holds nobody, expected results of Ultralytics.")
    keypoints = np.stack([found.x.array(), found.y.array()], -1)
    names, told = names_for(path, keypoints.shape[1], {17: COCO[17]}, options, keypoints)
    notes = list(told)
    blank = (keypoints == 0).all(-1)  # what weak keypoints are set to
    confidence = np.where(blank, np.float32(0), found.seen.array())
    if (np.nan_to_num(np.abs(keypoints), posinf=2) <= 1).all():
        keypoints = to_pixels(keypoints, options, notes)
    identity = frames_or_images(path, [file.stem for file in files], found.file, found.frame, found.track)
    if len(set(found.category)) > 1:
        identity["category"] = texts(path, found.category)
    return pose_data(path, names, keypoints, confidence, identity, notes=notes)


FORMAT = Format("ultralytics_json", "Ultralytics results (JSON)", _fits, _read)
