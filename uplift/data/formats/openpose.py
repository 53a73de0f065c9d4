"""OpenPose: one JSON file a frame, with a list of people and up to four lists of keypoints for each."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import HANDS, OPENPOSE, OPENPOSE_FACE70, names_for
from uplift.data.formats.rows import Bodies, pose_data, split_names, track_of
from uplift.data.parsers.json import Numbers, json_files, load_json, shown
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]

_PARTS = ("pose", "hand_left", "hand_right", "face")
_KEYS = [(part, f"{part}_keypoints_2d", f"{part}_keypoints") for part in _PARTS]
"""What versions from 1.2 on, and those before, call each part."""
_NAMES = {"hand_left": HANDS["left"], "hand_right": HANDS["right"], "face": OPENPOSE_FACE70}


def _fits(peek: Peek) -> bool:
    first = peek.first_json
    return first.json_sign == "{" and "people" in first.json_keys


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    files, bodies = json_files(path), Bodies(path)
    stems = [file.stem.removesuffix("_keypoints") for file in files]
    numbered = split_names(stems)  # a video's frames, unless a name ends with no number
    parts = {part: Numbers(f"{part}_keypoints_2d") for part in _PARTS}
    rows: dict[str, list[int]] = {part: [] for part in _PARTS}
    for file, name, frame in zip(files, *(numbered or (stems, [None] * len(stems))), strict=True):
        for person, where in _people(file):
            filled = _keypoints(person, where)
            for part, values in filled.items():
                parts[part].add(values, where)
                rows[part].append(len(bodies))
            if filled:
                number = person.get("person_id")
                if isinstance(number, list) and len(number) < 2:
                    number = number[0] if number else None
                track = track_of(number, where, "person_id", (int, float))
                bodies.add(name or path.absolute().stem, frame, track)
    if not len(bodies):
        raise UserError(f"{path}: no person with 2D keypoints ('pose_keypoints_2d' or others) in {len(files):,} files.")
    values, names, notes = _joined(path, parts, rows, len(bodies), options)
    identity = bodies.identity() if numbered else bodies.images(bodies.name)
    return pose_data(path, names, values[..., :2], values[..., 2], identity, notes=notes)


def _people(file: Path) -> Iterator[tuple[dict[str, Any], str]]:
    frame = load_json(file)
    people = frame.get("people") if isinstance(frame, dict) else None
    if not isinstance(people, list):
        raise UserError(
            f"{file} has no list of 'people', expected what OpenPose writes for a frame. Keep files of other kinds "
            "in other folders."
        )
    for count, person in enumerate(people):
        where = f"{file}: person {count}"
        if not isinstance(person, dict):
            raise UserError(f"{where} is {shown(person)}, expected an object.")
        yield person, where


def _keypoints(person: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the lists of keypoints that are filled; versions before 1.2 leave ``_2d`` out of their names."""
    found = {part: person.get(new, person.get(old)) for part, new, old in _KEYS}
    filled = {part: values for part, values in found.items() if values not in (None, [])}
    if not filled and any(person.get(f"{part}_keypoints_3d") for part in _PARTS):
        raise UserError(f"{where} has 3D keypoints only, expected 2D ones: 'pose_keypoints_2d'.")
    return filled


def _joined(
    path: Path, parts: dict[str, Numbers], rows: dict[str, list[int]], people: int, options: ReadOptions
) -> tuple[np.ndarray, tuple[str, ...], list[str]]:
    """Return (people, joints, 3) of all parts that are filled, their names, and notes."""
    found: list[np.ndarray] = []
    names: list[str] = []
    notes: list[str] = []
    for part, numbers in parts.items():
        if not numbers.rows:
            continue
        triples = numbers.triples(path)
        count = triples.shape[1]
        if part == "pose":
            joints, more = names_for(path, count, OPENPOSE, options, triples)
            notes += more
        else:
            joints = _NAMES[part] if len(_NAMES[part]) == count else tuple(f"{part}_keypoint_{n}" for n in range(count))
        if people * count > 20 * numbers.rows * count + 10_000_000:
            raise UserError(f"{path}: only {numbers.rows:,} of {people:,} people have '{numbers.what}': damaged file?")
        values = np.zeros((people, count, 3), np.float32)
        values[rows[part]] = triples
        found.append(values)
        names += joints
    return np.concatenate(found, 1), tuple(names), notes


FORMAT = FileFormat("openpose", "OpenPose JSON", _fits, _read, ".json")
