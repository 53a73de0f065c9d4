"""MMPose and RTMPose: instances of one image, of the frames of a video, or of a folder of images."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import MMPOSE, names_for, pairs_by_name, swapped_names
from uplift.data.formats.rows import Bodies, pose_data, track_of
from uplift.data.parsers.json import JsonText, Numbers, is_text, items, json_files, members, shown, whole_number
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]

_CLOSE, _HIGHEST_PEAK = 1.5, 20.0
"""Scores between these are peaks of RTMPose's own scale: heat maps stay below, per cent goes beyond."""


def _fits(peek: Peek) -> bool:
    first = peek.first_json
    keys = set(first.json_keys)
    if first.json_sign == "{":
        return bool(keys & {"meta_info", "instance_info"})
    if not keys:  # frames as lists in a list
        return first.json_sign == "[" and '"keypoint_scores"' in first.text
    return {"frame_id", "instances"} <= keys or {"keypoints", "keypoint_scores"} <= keys


@dataclass
class _Found:
    """What has been read so far."""

    bodies: Bodies
    keypoints: Numbers = field(default_factory=lambda: Numbers("keypoints"))
    scores: Numbers = field(default_factory=lambda: Numbers("keypoint_scores"))
    meta: dict[str, Any] = field(default_factory=dict)

    def add(self, instance: Any, file: Path, frame: int | None, where: str) -> None:
        if not isinstance(instance, dict) or "keypoints" not in instance:
            raise UserError(f"{where} is {shown(instance)}, expected an object with 'keypoints'.")
        keypoints, scores = instance["keypoints"], instance.get("keypoint_scores")
        pairs = isinstance(keypoints, list) and keypoints and isinstance(keypoints[0], list)
        if not pairs or len(keypoints[0]) not in (2, 3):
            raise UserError(f"{where}: 'keypoints' is {shown(keypoints)}, expected a list of [x, y].")
        self.keypoints.add(keypoints, where)
        self.scores.add([1.0] * len(keypoints) if scores is None else scores, where)
        track = instance.get("track_id", instance.get("instance_id"))
        self.bodies.add(file.stem, frame, track_of(track, where, "track_id"))


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    found = _Found(Bodies(path))
    for file in json_files(path):
        _read_file(found, file)
    if not found.keypoints.rows:
        raise UserError(f"{path}: no instance in {'any file of it' if path.is_dir() else 'it'}.")
    if found.keypoints.width == 3 * (found.scores.width or 0):
        raise UserError(
            f"{path} has keypoints of three coordinates: 3D poses, or a third number that is not a score. Expected 2D "
            "predictions, [x, y] each."
        )
    keypoints, scores = found.keypoints.pairs(found.scores, path)
    scores, raw = _sure(scores)
    meta = found.meta if options.layout is None else {}
    names, notes = _names(path, meta, keypoints.shape[1]), ()
    if names is None:
        names, notes = names_for(path, keypoints.shape[1], MMPOSE, options, keypoints)
    known = {"bones": pairs_by_name(meta.get("skeleton_links"), names), "mirror": _mirror(meta, names)}
    return pose_data(path, names, keypoints, scores, found.bodies.identity(), notes=(*notes, *raw), **known)


def _sure(scores: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return scores of at most 1, and a note where RTMPose's own go far beyond it, which are no shares."""
    most = float(np.nanmax(scores, initial=0))
    if not _CLOSE < most < _HIGHEST_PEAK:
        return scores, ()
    return np.minimum(scores, np.float32(1)), (
        f"scores go up to {most:.3g}, as RTMPose's do: those over 1 are taken as 1",
    )


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
        elif isinstance(value := part.value(), dict) and key == "meta_info":
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
            raise UserError(f"{where} follows entries of another kind: instances of an image, or frames of a video?")
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


def _names(path: Path, meta: dict[str, Any], count: int) -> tuple[str, ...] | None:
    """Return the names of the keypoints that a file gives; None where it gives none."""
    names = meta.get("keypoint_id2name")
    if names is None and isinstance(meta.get("keypoint_name2id"), dict):
        names = {str(place): name for name, place in meta["keypoint_name2id"].items()}
    if names is None:
        return None
    if not isinstance(names, dict) or len(names) != count:
        given = f"names {len(names)} keypoints" if isinstance(names, dict) else "has no names by number"
        raise UserError(f"{path}: 'meta_info' {given}, but instances have {count}.")
    found = [names.get(str(place)) for place in range(count)]
    if not all(is_text(name) for name in found):
        raise UserError(f"{path}: 'meta_info' has keypoint_id2name {shown(names)}, expected 0 to n with names.")
    return tuple(map(str, found))


def _mirror(meta: dict[str, Any], names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Return partners, each pair once, from ``flip_pairs`` or ``flip_indices``."""
    pairs = pairs_by_name(meta.get("flip_pairs"), names) or swapped_names(meta.get("flip_indices"), names)
    return tuple(dict.fromkeys((a, b) if names.index(a) < names.index(b) else (b, a) for a, b in pairs))


FORMAT = FileFormat("mmpose", "MMPose predictions", _fits, _read, ".json")
