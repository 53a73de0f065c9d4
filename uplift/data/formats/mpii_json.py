"""MPII Human Pose as JSON: a list with one person an entry, 16 joints each."""

from __future__ import annotations

import numpy as np

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.formats.layouts import MPII16, names_for
from uplift.data.formats.rows import pose_data
from uplift.data.parsers.json import Numbers, entries, is_text, shown, texts
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    return peek.json_sign == "[" and "joints" in peek.json_keys and bool({"joints_vis", "image"} & set(peek.json_keys))


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    joints, visible = Numbers("joints"), Numbers("joints_vis")
    images: list[str] = []
    for count, record in entries(path, "the list of people"):
        where, image = f"{path}: entry {count}", record.get("image")
        if not is_text(image):
            raise UserError(f"{where} has image {shown(image)}, expected a name.")
        joints.add(record.get("joints"), where)
        visible.add(record.get("joints_vis"), where)
        images.append(str(image))
    if not images:
        raise UserError(f"{path} is an empty list, expected people of MPII.")
    count = visible.width or 0
    if joints.width != 2 * count:
        raise UserError(
            f"{path}: 'joints' has {joints.width} numbers and 'joints_vis' {count}, expected x, y for each."
        )
    names, notes = names_for(path, count, {16: ("MPII", MPII16)}, options)
    confidence = (visible.array() > 0).astype(np.float32)
    identity = {"image": texts(path, images), "instance": np.arange(len(images)).astype(str)}
    return pose_data(path, names, joints.array(count, 2), confidence, identity, notes=notes)


FORMAT = Format("mpii_json", "MPII JSON", _fits, _read)
