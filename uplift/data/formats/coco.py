"""COCO's JSON with keypoints: annotations of images and categories, and detectors' lists of results."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import COCO, WHOLEBODY133, names_for, pairs_by_name
from uplift.data.formats.rows import Bodies, name_of, pose_data, same_or_none, seen_by_flag
from uplift.data.parsers.json import Numbers, entries, is_text, members, objects, shown, texts, whole_number
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["ANNOTATIONS", "RESULTS"]

# COCO annotations with keypoints, of any category: an object with images, annotations and categories.

_PARTS = ("keypoints", "foot_kpts", "face_kpts", "lefthand_kpts", "righthand_kpts")


@dataclass
class _Image:
    name: str
    size: tuple[int, int] | None
    video: str | None
    frame: Any


@dataclass
class _Category:
    name: str
    joints: tuple[str, ...] | None
    """None: the category has no keypoints."""
    edges: list[Any]


def _are_annotations(peek: Peek) -> bool:
    keys = set(peek.json_keys) if peek.json_sign == "{" else set()
    return bool({"images", "annotations", "categories"} & keys) and not {"people", "instance_info", "data"} & keys


def _read_annotations(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    found = _Annotations(path)
    takes = {"images": found.image, "annotations": found.annotation, "categories": found.category}
    takes["videos"] = found.video
    for key, text in members(path):
        if key not in takes or (key == "videos" and text.next_sign() != "["):
            text.value()
            continue
        for record in objects(text, f"'{key}'"):
            takes[key](record)
    return found.finish(options)


def _text_of(value: Any) -> str | None:
    return str(value) if isinstance(value, int | str) and not isinstance(value, bool) and value != "" else None


class _Annotations:
    """What has been read so far of a file."""

    def __init__(self, path: Path):
        self.path = path
        self.images: dict[str, _Image] = {}
        self.categories: dict[str, _Category] = {}
        self.videos: dict[str, str] = {}
        self.tables: dict[int, Numbers] = {}
        """Number of keypoints -> their x, y, v."""
        self.rows: dict[int, list[tuple[str, str | None, str | None, str]]] = {}
        """Number of keypoints -> image, category, track and id of each annotation."""
        self.seen = 0
        self.kinds: set[str] = set()
        """Keys of annotations without keypoints."""

    def image(self, record: dict[str, Any]) -> None:
        where = f"{self.path}: image {len(self.images)}"
        number = name_of(record.get("id"), where, "id")
        name = name_of(record.get("file_name") or record.get("id"), where, "file_name")
        size: Any = record.get("width"), record.get("height")
        known = all(isinstance(side, int) and 0 < side < 10**6 for side in size)
        video = _text_of(record.get("video_id", record.get("vid_id")))
        self.images[number] = _Image(name, size if known else None, video, record.get("frame_id"))

    def video(self, record: dict[str, Any]) -> None:
        number, name = record.get("id"), record.get("name", record.get("file_name"))
        if isinstance(number, int | str) and is_text(name):
            self.videos[str(number)] = str(name)

    def category(self, record: dict[str, Any]) -> None:
        where = f"{self.path}: category {shown(record.get('name', record.get('id')))}"
        joints, edges = record.get("keypoints"), record.get("skeleton")
        if joints is not None and not (isinstance(joints, list) and all(is_text(joint) for joint in joints)):
            raise UserError(f"{where} has keypoints {shown(joints)}, expected a list of names.")
        number = name_of(record.get("id"), where, "id")
        edges = edges if isinstance(edges, list) else []
        self.categories[number] = _Category(str(record.get("name", number)), tuple(joints) if joints else None, edges)

    def annotation(self, record: dict[str, Any]) -> None:
        """Take one annotation, unless it is a crowd or has no keypoints."""
        self.seen += 1
        number = record.get("id", self.seen - 1)
        values = record.get("keypoints")
        if record.get("iscrowd") or values == []:
            return
        if values is None:
            self.kinds.update(list(record)[:20])
            return
        where = f"{self.path}: annotation {number if type(number) is int else shown(number)}"
        values = _flat(record, where)
        count = len(values) // 3
        if count not in self.tables:
            self.tables[count], self.rows[count] = Numbers("keypoints"), []
        self.tables[count].add(values, where)
        image = name_of(record.get("image_id"), where, "image_id")
        category = record.get("category_id")
        category = None if category is None else name_of(category, where, "category_id")
        track = _text_of(record.get("track_id", record.get("instance_id")))
        self.rows[count].append((image, category, track, str(number)))

    def finish(self, options: ReadOptions) -> PoseData:
        """Return the annotations of the layout that has most of them."""
        if not self.tables:
            raise UserError(f"{self.path}: none of its {self.seen:,} annotations has keypoints{self._instead()}.")
        notes: list[str] = []
        joints, count, kept = self._layout(notes)
        rows = [self.rows[count][place] for place in kept]
        values = self.tables[count].array(count, 3)[kept]
        if joints is None or options.layout is not None:
            joints, more = names_for(self.path, count, COCO, options, values)
            notes += more
        confidence = seen_by_flag(values[..., 2], notes)
        images = self._images(rows)
        known = self.categories.get(rows[0][1], next(iter(self.categories.values()), None))
        edges = [] if known is None else known.edges
        bones = pairs_by_name(edges, joints, first=1)
        if len(bones) < len(edges):
            notes.append(f"{len(edges) - len(bones)} lines of the file's skeleton name no keypoint: left out")
        identity = self._identity(images, rows) | self._classes(rows, joints)
        known = {"bones": bones, "image_size": same_or_none(image.size for image in images)}
        return pose_data(self.path, joints, values[..., :2], confidence, identity, notes=notes, **known)

    def _instead(self) -> str:
        if "caption" in self.kinds:
            return ": these are captions. Expected person_keypoints_*.json or the like"
        return ": these are outlines of objects, without poses" if "segmentation" in self.kinds else ""

    def _layout(self, notes: list[str]) -> tuple[tuple[str, ...] | None, int, np.ndarray]:
        """Return names, number and rows of the keypoints of the layout with most annotations."""
        kinds: Counter[tuple[int, tuple[str, ...] | None]] = Counter()
        for count, rows in self.rows.items():
            for category, found in Counter(row[1] for row in rows).items():
                kinds[count, self._names(category, count, rows)] += found
        (count, joints), _ = kinds.most_common(1)[0]
        kept = [n for n, row in enumerate(self.rows[count]) if self._names(row[1], count, self.rows[count]) == joints]
        left = kinds.total() - len(kept)
        if left:
            notes.append(
                f"the file has {len(kinds)} layouts of keypoints: read are the {len(kept):,} annotations of the "
                f"commonest ({count} keypoints), left out the {left:,} of the others"
            )
        return joints, count, np.array(kept)

    def _names(self, category: str | None, count: int, rows: list[tuple]) -> tuple[str, ...] | None:
        """Return the names of a category's keypoints; None where the file has none."""
        known = self.categories.get(category or "")
        if len(self.categories) == 1 and category is None:
            (known,) = self.categories.values()
        if known is None or known.joints is None:
            return None
        if len(known.joints) == count:
            return known.joints
        if count == len(WHOLEBODY133) and len(known.joints) in (17, 133):
            return WHOLEBODY133
        first = next(row for row in rows if row[1] == category)
        raise UserError(
            f"{self.path}: annotation {first[3]} has {count} keypoints, but its category '{known.name:.40}' names "
            f"{len(known.joints)}. Expected x, y, v of each."
        )

    def _images(self, rows: list[tuple]) -> list[_Image]:
        if not self.images:
            return [_Image(row[0], None, None, None) for row in rows]
        missing = next((row for row in rows if row[0] not in self.images), None)
        if missing is not None:
            raise UserError(
                f"{self.path}: annotation {missing[3]} is of image {missing[0]:.80}, which is not among its "
                f"{len(self.images):,} images: cut short?"
            )
        return [self.images[row[0]] for row in rows]

    def _identity(self, images: list[_Image], rows: list[tuple]) -> dict[str, np.ndarray]:
        """Return sequence, frame and track where the file is of videos; image and annotation otherwise."""
        if all(image.video is not None and image.frame is not None for image in images):
            frames = [whole_number(i.frame, f"{self.path}: image '{i.name:.60}'", "frame_id") for i in images]
            sequence = texts(self.path, [self.videos.get(str(i.video), str(i.video)) for i in images])
            found = {"sequence": sequence, "frame": np.array(frames, np.int64)}
            tracks = texts(self.path, [row[2] or "" for row in rows])
            return found | {"instance": tracks} if (tracks != "").any() else found
        image, number = [image.name for image in images], [row[3] for row in rows]
        return {"image": texts(self.path, image), "instance": texts(self.path, number)}

    def _classes(self, rows: list[tuple], joints: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Return the categories where there are several of this layout, whether or not they occur."""
        alike = {number for number, category in self.categories.items() if category.joints == joints}
        if len(alike | {row[1] for row in rows}) < 2:
            return {}
        names = {number: category.name for number, category in self.categories.items()}
        return {"category": texts(self.path, [names.get(row[1], str(row[1])) for row in rows])}


def _flat(record: dict[str, Any], where: str) -> list[Any]:
    """Return x, y, v of all keypoints of an annotation; those of COCO-WholeBody stand in five lists."""
    table, values = Numbers("keypoints"), record["keypoints"]
    if "foot_kpts" in record or "lefthand_kpts" in record:
        values = [value for part in _PARTS for value in table.flat(record.get(part), where)]
    if isinstance(values, list) and values and isinstance(values[0], list):  # triples in place of a flat list
        values = table.flat(values, where)
    if not isinstance(values, list) or len(values) % 3:
        given = f"{len(values)} numbers" if isinstance(values, list) else shown(values)
        raise UserError(f"{where} has {given} in 'keypoints', expected x, y, v of each keypoint.")
    return values


ANNOTATIONS = FileFormat("coco", "COCO annotations", _are_annotations, _read_annotations)


# Results of a detector: a list with one body an entry, the number of its image, its keypoints and a score.


def _are_results(peek: Peek) -> bool:
    return peek.json_sign == "[" and {"image_id", "keypoints"} <= set(peek.json_keys)


def _read_results(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    numbers, bodies = Numbers("keypoints"), Bodies(path)
    for count, record in entries(path, "the list of results"):
        where = f"{path}: entry {count}"
        category = name_of(record.get("category_id", 1), where, "category_id")
        bodies.add(name_of(record.get("image_id"), where, "image_id"), category=category)
        numbers.add(record.get("keypoints"), where)
    if not len(bodies):
        raise UserError(f"{path} is an empty list, expected results of a detector.")
    values = numbers.triples(path)
    names, more = names_for(path, values.shape[1], COCO, options, values)
    notes = list(more)
    confidence = seen_by_flag(values[..., 2], notes)
    return pose_data(path, names, values[..., :2], confidence, bodies.images(bodies.name), notes=notes)


RESULTS = FileFormat("coco_results", "COCO results", _are_results, _read_results)
