"""Skeletons of Kinetics, as ST-GCN takes them: one video a file, with the skeletons of each frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.formats.layouts import KINETICS, names_for
from uplift.data.formats.rows import pose_data, to_pixels
from uplift.data.parsers.json import Numbers, json_files, members, objects, shown, whole
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    first = peek.first_json
    if first is None or first.json_sign != "{" or "data" not in first.json_keys:
        return False
    return '"frame_index"' in first.text or {"label", "label_index"} <= set(first.json_keys)


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    poses, scores = Numbers("pose"), Numbers("score")
    file_of: list[int] = []
    frames: list[int] = []
    files = json_files(path)
    for number, file in enumerate(files):
        before = len(frames)
        _read_file(file, poses, scores, frames)
        file_of += [number] * (len(frames) - before)
    if not frames:
        raise UserError(f"{path} has no skeleton in any frame.")
    count = scores.width or 0
    if poses.width != 2 * count:
        raise UserError(f"{path}: 'pose' has {poses.width} numbers and 'score' {count}, expected x, y for each score.")
    keypoints, confidence = poses.array(count, 2), scores.array()
    names, told = names_for(path, count, KINETICS, options, keypoints)
    notes = list(told)
    shares = bool((np.nan_to_num(np.abs(keypoints), posinf=2) <= 1).all())
    if shares:
        keypoints = to_pixels(keypoints, options, notes)
    stems = np.array([file.stem for file in files])
    identity = {"sequence": stems[file_of], "frame": np.array(frames, np.int64)}
    return pose_data(path, names, keypoints, confidence, identity, notes=notes)


def _read_file(file: Path, poses: Numbers, scores: Numbers, frames: list[int]) -> None:
    known = False
    for key, text in members(file):
        if key != "data":
            text.value()
            continue
        known = True
        for count, record in enumerate(objects(text, "'data'")):
            where = f"{file}: entry {count}"
            frame = whole(record.get("frame_index"), where, "frame_index")
            skeletons = record.get("skeleton")
            if not isinstance(skeletons, list):
                raise UserError(f"{where} has skeleton {shown(skeletons)}, expected a list of skeletons.")
            for place, skeleton in enumerate(skeletons):
                here = f"{where}, skeleton {place}"
                if not isinstance(skeleton, dict):
                    raise UserError(f"{here} is {shown(skeleton)}, expected an object with 'pose' and 'score'.")
                poses.add(skeleton.get("pose"), here)
                scores.add(skeleton.get("score"), here)
                frames.append(frame)
    if not known:
        raise UserError(f"{file} has no 'data', expected the frames of a video with their skeletons.")


FORMAT = Format("kinetics_skeleton", "Kinetics skeletons (ST-GCN)", _fits, _read, ".json")
