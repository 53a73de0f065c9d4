"""Skeletons of Kinetics, as ST-GCN takes them: one video a file, with the skeletons of each frame."""

from __future__ import annotations

from pathlib import Path

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import KINETICS, names_for
from uplift.data.formats.rows import Bodies, pose_data
from uplift.data.parsers.json import Numbers, json_files, members, objects, shown, whole_number
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    first = peek.first_json
    known = '"frame_index"' in first.text or {"label", "label_index"} <= set(first.json_keys)
    return first.json_sign == "{" and "data" in first.json_keys and known


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    poses, scores, bodies = Numbers("pose"), Numbers("score"), Bodies(path)
    for file in json_files(path):
        _read_file(file, poses, scores, bodies)
    if not len(bodies):
        raise UserError(f"{path} has no skeleton in any frame.")
    keypoints, confidence = poses.pairs(scores, path)
    names, notes = names_for(path, keypoints.shape[1], KINETICS, options, keypoints)
    return pose_data(path, names, keypoints, confidence, bodies.identity(), notes=notes)


def _read_file(file: Path, poses: Numbers, scores: Numbers, bodies: Bodies) -> None:
    found = False
    for key, text in members(file):
        if key != "data":
            text.value()
            continue
        found = True
        for count, record in enumerate(objects(text, "'data'")):
            where = f"{file}: entry {count}"
            frame = whole_number(record.get("frame_index"), where, "frame_index")
            skeletons = record.get("skeleton")
            if not isinstance(skeletons, list):
                raise UserError(f"{where} has skeleton {shown(skeletons)}, expected a list of skeletons.")
            for place, skeleton in enumerate(skeletons):
                here = f"{where}, skeleton {place}"
                if not isinstance(skeleton, dict):
                    raise UserError(f"{here} is {shown(skeleton)}, expected an object with 'pose' and 'score'.")
                poses.add(skeleton.get("pose"), here)
                scores.add(skeleton.get("score"), here)
                bodies.add(file.stem, frame)
    if not found:
        raise UserError(f"{file} has no 'data', expected the frames of a video with their skeletons.")


FORMAT = FileFormat("kinetics_skeleton", "Kinetics skeletons (ST-GCN)", _fits, _read, ".json", "shares")
