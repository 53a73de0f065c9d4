"""MMPose and RTMPose: instances of one image, of the frames of a video, or of a folder of images."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.formats.layouts import MMPOSE, names_for
from uplift.data.formats.rows import Bodies, pose_data, track_of
from uplift.data.parsers.json import JsonText, Numbers, is_text, items, json_files, members, shown, whole_number
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    first = peek.first_json
    if first is None:
        return False
    keys = set(first.json_keys)
    if first.json_sign == "{":
        return bool(keys & {"meta_info", "instance_info"})
    if {"frame_id", "instances"} <= keys or {"keypoints", "keypoint_scores"} <= keys:
        return True
    return not keys and '"keypoint_scores"' in first.text  # frames as lists in a list


@dataclass
class _Found:
    """What has been read so far."""

    bodies: Bodies
    keypoints: Numbers = field(default_factory=lambda: Numbers("keypoints"))
    scores: Numbers = field(default_factory=lambda: Numbers("keypoint_scores"))
    size: int = 0
    """Coordinates of a keypoint."""
    meta: dict[str, Any] | None = None

    def add(self, instance: Any, file: Path, frame: int | None, where: str) -> None:
        """Take one body."""
        if not isinstance(instance, dict) or "keypoints" not in instance:
            raise UserError(f"{where} is {shown(instance)}, expected an object with 'keypoints'.")
        keypoints, scores = instance["keypoints"], instance.get("keypoint_scores")
        pairs = isinstance(keypoints, list) and keypoints and isinstance(keypoints[0], list)
        if not pairs or (len(keypoints[0]) not in (2, 3)):
            raise UserError(f"{where}: 'keypoints' is {shown(keypoints)}, expected a list of [x, y].")
        self.size = self.size or len(keypoints[0])
        if len(keypoints[0]) != self.size:
            raise UserError(f"{where}: a keypoint has {len(keypoints[0])} numbers, those before it have {self.size}.")
        self.keypoints.add(keypoints, where)
        self.scores.add([1.0] * len(keypoints) if scores is None else scores, where)
        if self.scores.width != len(keypoints):
            raise UserError(f"{where} has {len(keypoints)} keypoints and {self.scores.width} keypoint_scores.")
        track = instance.get("track_id", instance.get("instance_id"))
        self.bodies.add(file.stem, frame, track_of(track, where, "track_id"))


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    found = _Found(Bodies(path))
    for file in json_files(path):
        _read_file(found, file)
    if not found.keypoints.rows:
        raise UserError(f"{path}: no instance in {'any file of it' if path.is_dir() else 'it'}.")
    if found.size == 3:
        raise UserError(
            f"{path} has keypoints of three coordinates: 3D poses, or a third number that is not a score. Expected 2D "
            "predictions, [x, y] each."
        )
    keypoints = found.keypoints.array(found.scores.width or 0, 2)
    meta = _Meta(path, found.meta if options.layout is None else None, keypoints.shape[1])
    names, notes = meta.names, ()
    if names is None:
        names, notes = names_for(path, keypoints.shape[1], MMPOSE, options, keypoints)
    known = {"bones": meta.pairs("skeleton_links", names), "mirror": meta.mirror(names)}
    return pose_data(path, names, keypoints, found.scores.array(), found.bodies.identity(), notes=notes, **known)


def _read_file(found: _Found, file: Path) -> None:
    text = JsonText(file)
    if text.next_sign() == "[":
        _take(found, text)
        return
    kept = False
    for key, part in members(file):
        if key == "instance_info":
            _take(found, part)
            kept = True
            continue
        value = part.value()
        if key == "meta_info" and isinstance(value, dict):
            found.meta = found.meta or value
    if not kept:
        raise UserError(f"{file} has no 'instance_info', expected predictions of MMPose.")


def _take(found: _Found, text: JsonText) -> None:
    """Take a list of the instances of an image, or of frames: objects with instances, or lists of them."""
    stills = None
    for count, entry in enumerate(items(text, "'instance_info'")):
        still = isinstance(entry, dict) and "instances" not in entry
        where = f"{text.path}: {'instance' if still else 'frame'} {count}"
        if stills not in (None, still):
            raise UserError(
                f"{where} comes after entries of another kind: instances of an image, or frames of a video?"
            )
        stills = still
        if still:
            found.add(entry, text.path, None, where)
            continue
        frame, instances = count, entry
        if isinstance(entry, dict):
            frame = whole_number(entry.get("frame_id", count), where, "frame_id")
            instances = entry["instances"]
        if not isinstance(instances, list):
            raise UserError(f"{where} is {shown(entry)}, expected a list of instances.")
        for place, instance in enumerate(instances):
            found.add(instance, text.path, frame, f"{where}, instance {place}")


class _Meta:
    """What a file says about its data set: names, lines and partners."""

    def __init__(self, path: Path, meta: dict[str, Any] | None, count: int):
        self.path, self.meta, self.count = path, meta or {}, count
        self.names = self._names()

    def _names(self) -> tuple[str, ...] | None:
        names = self.meta.get("keypoint_id2name")
        if names is None and isinstance(self.meta.get("keypoint_name2id"), dict):
            names = {str(place): name for name, place in self.meta["keypoint_name2id"].items()}
        if names is None:
            return None
        if not isinstance(names, dict) or len(names) != self.count:
            given = f"names {len(names)} keypoints" if isinstance(names, dict) else "has no names by number"
            raise UserError(f"{self.path}: 'meta_info' {given}, but instances have {self.count}.")
        found = [names.get(str(place)) for place in range(self.count)]
        if not all(is_text(name) for name in found):
            raise UserError(
                f"{self.path}: 'meta_info' has keypoint_id2name {shown(names)}, expected 0 to n with names."
            )
        return tuple(map(str, found))

    def pairs(self, key: str, names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
        """Return pairs of places (counted from 0) under ``key`` by name; others are left out."""
        found = self.meta.get(key)
        good = [
            pair
            for pair in (found if isinstance(found, list) else [])
            if isinstance(pair, list)
            and len(pair) == 2
            and all(type(place) is int and 0 <= place < len(names) for place in pair)
        ]
        return tuple((names[a], names[b]) for a, b in good)

    def mirror(self, names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
        """Return partners, each pair once, from ``flip_pairs`` or ``flip_indices``."""
        partner = self.meta.get("flip_indices")
        pairs = self.pairs("flip_pairs", names)
        if not pairs and isinstance(partner, list) and len(partner) == len(names):
            swaps = [
                (a, b)
                for a, b in enumerate(partner)
                if type(b) is int and a < b < len(names) and partner[b] == a
            ]  # fmt: skip
            pairs = tuple((names[a], names[b]) for a, b in swaps)
        place = {name: number for number, name in enumerate(names)}
        return tuple(dict.fromkeys((a, b) if place[a] < place[b] else (b, a) for a, b in pairs))


FORMAT = Format("mmpose", "MMPose predictions", _fits, _read, ".json")
