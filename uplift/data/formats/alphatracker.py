"""AlphaTracker's labels: a list of images, each with a box ("Face") and the points of every animal in turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import names_for
from uplift.data.formats.rows import Bodies, name_of, pose_data
from uplift.data.parsers.json import Numbers, entries, shown
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    return peek.json_sign == "[" and "annotations" in peek.json_keys and '"class"' in peek.text


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    points, bodies = Numbers("points"), Bodies(path)
    for count, record in entries(path, "the list of images"):
        where, found = f"{path}: image {count}", record.get("annotations")
        image = name_of(record.get("filename"), where, "filename", number=False)
        if not isinstance(found, list):
            raise UserError(f"{where} has annotations {shown(found)}, expected a list.")
        for number, animal in enumerate(_animals(found, where)):
            if animal:
                points.add(animal, f"{where}, animal {number}")
                bodies.add(image, track=str(number))
    if not len(bodies):
        raise UserError(f"{path} has no animal with points, expected labels of AlphaTracker.")
    keypoints = points.array((points.width or 0) // 2, 2)
    names, notes = names_for(path, keypoints.shape[1], {}, options, keypoints, "point")
    confidence = np.all(np.isfinite(keypoints), axis=-1).astype(np.float32)
    identity = bodies.images(bodies.name) | {"instance": np.array(bodies.track)}
    return pose_data(path, names, keypoints, confidence, identity, notes=notes)


def _animals(annotations: list[Any], where: str) -> list[list[list[Any]]]:
    """Return the points of each animal: those that follow its box."""
    found: list[list[list[Any]]] = []
    for count, one in enumerate(annotations):
        kind = one.get("class") if isinstance(one, dict) else None
        if kind == "Face":
            found.append([])
        elif kind != "point":
            raise UserError(f"{where}: annotation {count} is {shown(one)}, expected a 'Face' or a 'point'.")
        elif not found:
            raise UserError(f"{where}: annotation {count} is a point before the first 'Face', expected boxes first.")
        else:
            found[-1].append([one.get("x"), one.get("y")])
    return found


FORMAT = FileFormat("alphatracker", "AlphaTracker labels", _fits, _read)
