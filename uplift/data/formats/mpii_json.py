"""MPII Human Pose as JSON: a list with one person an entry, 16 joints each."""

from __future__ import annotations

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import MPII16, names_for
from uplift.data.formats.rows import Bodies, name_of, pose_data
from uplift.data.parsers.json import Numbers, entries
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    return peek.json_sign == "[" and "joints" in peek.json_keys and bool({"joints_vis", "image"} & set(peek.json_keys))


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    joints, visible, bodies = Numbers("joints"), Numbers("joints_vis"), Bodies(path)
    for count, record in entries(path, "the list of people"):
        where = f"{path}: entry {count}"
        image = name_of(record.get("image"), where, "image", number=False)
        joints.add(record.get("joints"), where)
        visible.add(record.get("joints_vis"), where)
        bodies.add(image)
    if not len(bodies):
        raise UserError(f"{path} is an empty list, expected people of MPII.")
    keypoints, seen = joints.pairs(visible, path)
    names, notes = names_for(path, keypoints.shape[1], {16: ("MPII", MPII16)}, options)
    confidence = (seen > 0).astype(np.float32)
    return pose_data(path, names, keypoints, confidence, bodies.images(bodies.name), notes=notes)


FORMAT = FileFormat("mpii_json", "MPII JSON", _fits, _read)
