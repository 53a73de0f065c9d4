"""MPII Human Pose as JSON: a list with one person an entry, ``joints`` and ``joints_vis``, or ``joint_self``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import COCO, MPII16, names_for
from uplift.data.formats.rows import Bodies, name_of, pose_data, same_or_none
from uplift.data.parsers.json import JsonText, Numbers, entries, objects
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]

_MPII = ("MPII", MPII16)


def _fits(peek: Peek) -> bool:
    if _in_root(peek):
        return '"joint_self"' in peek.text
    keys = set(peek.json_keys)
    return peek.json_sign == "[" and (
        "joint_self" in keys or ("joints" in keys and bool({"joints_vis", "image"} & keys))
    )


def _in_root(peek: Peek) -> bool:
    return peek.json_sign == "{" and peek.json_keys[:1] == ("root",)


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    return _read_selves(peek, options) if '"joint_self"' in peek.text else _read_joints(peek, options)


def _read_joints(peek: Peek, options: ReadOptions) -> PoseData:
    """Read people as HRNet has them: ``joints_vis`` says which are labelled."""
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
    names, notes = names_for(path, keypoints.shape[1], {16: _MPII}, options)
    confidence = (seen > 0).astype(np.float32)
    return pose_data(path, names, keypoints, confidence, bodies.images(bodies.name), notes=notes)


# As Convolutional Pose Machines and what came from it have them: one person an entry, x, y and a flag of each joint.


def _read_selves(peek: Peek, options: ReadOptions) -> PoseData:
    """Read ``joint_self``: 1 is visible, 0 hidden, 2 not labelled, as are joints at (0, 0).

    ``joint_others`` are not read: the other people of an image have entries of their own.
    """
    path = peek.path
    joints, bodies, sizes = Numbers("joint_self"), Bodies(path), []
    for count, record in _people(path, _in_root(peek)):
        if not record.get("joint_self"):  # someone without annotation
            continue
        where = f"{path}: entry {count}"
        joints.add(record["joint_self"], where)
        bodies.add(name_of(record.get("img_paths"), where, "img_paths", number=False))
        sizes.append(_size(record))
    if not len(bodies):
        raise UserError(f"{path} has nobody with 'joint_self', expected people of MPII.")
    values = joints.triples(path)
    labelled = (values[..., :2] != 0).any(-1) & (values[..., 2] != 2)
    names, notes = names_for(path, values.shape[1], {**COCO, 16: _MPII}, options, values[..., :2])
    confidence = np.where(labelled, np.where(values[..., 2] > 0, 1.0, 0.5), 0.0).astype(np.float32)
    size = same_or_none(sizes)
    identity = bodies.images(bodies.name)
    return pose_data(path, names, values[..., :2], confidence, identity, notes=notes, image_size=size)


def _size(record: dict[str, Any]) -> tuple[int, int] | None:
    """Return width and height of a person's image, px; None where they are not said."""
    sides = [record.get(key) for key in ("img_width", "img_height")]
    known = [int(side) for side in sides if isinstance(side, int | float) and 1 <= side < 1e6]
    return (known[0], known[1]) if len(known) == 2 else None


def _people(path: Path, in_root: bool) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the number and object of each person of the list, or of the list under ``root``."""
    if not in_root:
        yield from entries(path, "the list of people")
        return
    text = JsonText(path)
    for key in text.members():
        if key == "root":
            yield from enumerate(objects(text, "'root'"))
        else:
            text.value()
    text.end()


FORMAT = FileFormat("mpii_json", "MPII JSON", _fits, _read)
