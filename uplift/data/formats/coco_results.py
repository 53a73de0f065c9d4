"""COCO's list of results: one body an entry, with the number of its image, its keypoints and a score."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.formats.layouts import COCO, names_for
from uplift.data.formats.rows import pose_data, seen_by_flag
from uplift.data.parsers.json import Numbers, entries, shown, texts
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT"]


def _fits(peek: Peek) -> bool:
    return peek.json_sign == "[" and {"image_id", "keypoints"} <= set(peek.json_keys)


def _read(path: Path, options: ReadOptions) -> PoseData:
    numbers = Numbers("keypoints")
    images: list[str] = []
    categories: list[str] = []
    for count, record in entries(path, "the list of results"):
        where = f"{path}: entry {count}"
        image, category = record.get("image_id"), record.get("category_id", 1)
        if isinstance(image, bool) or not isinstance(image, int | str):
            raise UserError(f"{where} has image_id {shown(image)}, expected the number or name of an image.")
        if isinstance(category, bool) or not isinstance(category, int | str):
            raise UserError(f"{where} has category_id {shown(category)}, expected a number.")
        numbers.add(record.get("keypoints"), where)
        images.append(str(image))
        categories.append(str(category))
    if not numbers.rows:
        raise UserError(f"{path} is an empty list, expected results of a detector.")
    if numbers.width is None or not numbers.width or numbers.width % 3:
        raise UserError(f"{path}: entry 0 has {numbers.width} numbers in 'keypoints', expected x, y, score of each.")
    values = numbers.array(numbers.width // 3, 3)
    names, told = names_for(path, values.shape[1], COCO, options, values)
    notes = list(told)
    confidence = seen_by_flag(values[..., 2], notes)
    identity = {"image": texts(path, images), "instance": np.arange(len(images)).astype(str)}
    if len(set(categories)) > 1:
        identity["category"] = texts(path, categories)
    return pose_data(path, names, values[..., :2], confidence, identity, notes=notes)


FORMAT = Format("coco_results", "COCO results", _fits, _read)
