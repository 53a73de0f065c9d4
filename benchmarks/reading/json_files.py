"""Files of JSON as trackers and annotation tools write them, of many bodies."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from benchmarks.reading.bodies import SIZE_PX, Chunk, Walk
from benchmarks.reading.lines import GAP, decimals, filled, whole_numbers
from benchmarks.reading.records import POINT, SCORE, Cells, each, gaps, lists, number, together, xyc
from uplift.data.datasets.coco import COCO_JOINTS

__all__ = [
    "alphapose", "alphatracker", "coco", "coco_results", "kinetics", "mediapipe_json", "mmpose", "mmpose_tracked",
    "mpii", "ultralytics_json",
]  # fmt: skip


def coco(path: Path, walk: Walk) -> None:
    """Annotations by hand: whole pixels and flags; a frame is an image."""
    images = f'{{"id": {GAP}, "file_name": "{GAP}.jpg", "width": {SIZE_PX[0]}, "height": {SIZE_PX[1]}}}'
    lists(path, walk, '{"images": [', images, lambda chunk: [number(chunk.frame)] * 2, '], "annotations": [')
    walk.spots.clear()
    annotation = (
        f'{{"id": {GAP}, "image_id": {GAP}, "category_id": 1, "iscrowd": 0, "area": 34567.0, "num_keypoints": 16, '
        f'"bbox": [312.5, 201.25, 180.0, 320.5], "keypoints": [{gaps(3 * walk.joints)}]}}'
    )

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        xy = (np.where(lost, 0, np.round(chunk.xy[:, one, :, axis])) for axis in (0, 1))
        flags = np.where(lost, 0, 2)
        points = together(*(whole_numbers(values) for values in (*xy, flags)))
        return [number(chunk.frame * walk.bodies + one), number(chunk.frame), *points]

    own = _part(path, walk, ", ".join([annotation] * walk.bodies), each(walk, body, numbers=0))
    names = json.dumps(COCO_JOINTS)
    category = f'], "categories": [{{"id": 1, "name": "person", "keypoints": {names}, "skeleton": [[1, 2]]}}]}}'
    with path.open("ab") as file:
        file.writelines(own)
        file.write(category.encode())
    for spot in walk.spots:
        spot["keypoints"] = np.round(spot["keypoints"]).tolist()
        spot["confidence"] = (np.array(spot["confidence"]) > 0).astype(float).tolist()


def _part(path: Path, walk: Walk, template: str, cells: Callable[[Chunk], Cells]) -> Iterator[bytes]:
    for chunk in walk.chunks():
        text = filled(template + ", ", cells(chunk))
        yield text[:-2] if chunk.frame[-1] == walk.frames - 1 else text


def coco_results(path: Path, walk: Walk) -> None:
    """A detector's results."""
    record = f'{{"image_id": {GAP}, "category_id": 1, "keypoints": [{gaps(3 * walk.joints)}], "score": 0.8731236}}'
    cells = each(walk, lambda chunk, one: [number(chunk.frame), *together(*xyc(chunk, one))], numbers=0)
    lists(path, walk, "[", ", ".join([record] * walk.bodies), cells, "]")


def alphapose(path: Path, walk: Walk) -> None:
    """A video's results, with tracks."""
    record = (
        f'{{"image_id": "{GAP}.jpg", "category_id": 1, "keypoints": [{gaps(3 * walk.joints)}], "score": 2.91328125, '
        '"box": [312.5, 201.25, 180.0, 320.5], "idx": [%d.0]}'
    )
    template = ", ".join(record % (body + 1) for body in range(walk.bodies))
    cells = each(walk, lambda chunk, one: [number(chunk.frame), *together(*xyc(chunk, one))], numbers=0)
    lists(path, walk, "[", template, cells, "]")


def mmpose(path: Path, walk: Walk) -> None:
    """A video's predictions, bodies without numbers."""
    _mmpose(path, walk, lambda body: "")


def mmpose_tracked(path: Path, walk: Walk) -> None:
    """A video's predictions, bodies with tracks."""
    _mmpose(path, walk, lambda body: f', "track_id": {body}')


def _mmpose(path: Path, walk: Walk, track: Callable[[int], str]) -> None:
    names = json.dumps({str(number): name for number, name in enumerate(COCO_JOINTS)})
    bodies = ", ".join(
        f'{{"keypoints": [{gaps(walk.joints, f"[{GAP}, {GAP}]")}], "keypoint_scores": [{gaps(walk.joints)}], '
        f'"bbox": [[312.5, 201.25, 492.5, 521.75]], "bbox_score": 0.8731236{track(body)}}}'
        for body in range(walk.bodies)
    )

    def body(chunk: Chunk, one: int) -> Cells:
        x, y, score = xyc(chunk, one)
        return [*together(x, y), score]

    start = f'{{"meta_info": {{"dataset_name": "coco", "keypoint_id2name": {names}}}, "instance_info": ['
    template = f'{{"frame_id": {GAP}, "instances": [{bodies}]}}'
    lists(path, walk, start, template, each(walk, body), "]}")


def kinetics(path: Path, walk: Walk) -> None:
    """Skeletons of one video, coordinates as shares of three decimals in its data set, of six here."""
    bodies = [f'{{"pose": [{gaps(2 * walk.joints)}], "score": [{gaps(walk.joints)}]}}'] * walk.bodies
    template = f'{{"frame_index": {GAP}, "skeleton": [{", ".join(bodies)}]}}'

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        xy = (decimals(chunk.xy[:, one, :, axis] / SIZE_PX[axis], 6, lost) for axis in (0, 1))
        return [*together(*xy), decimals(chunk.score[:, one], 3, lost)]

    lists(path, walk, '{"data": [', template, each(walk, body), '], "label": "walking", "label_index": 3}')


def mpii(path: Path, walk: Walk) -> None:
    """A list of people."""
    record = (
        f'{{"joints_vis": [{gaps(walk.joints)}], "joints": [{gaps(walk.joints, f"[{GAP}, {GAP}]")}], '
        f'"image": "{GAP}.jpg", "scale": 4.718488, "center": [966.0, 340.0]}}'
    )

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        xy = (decimals(chunk.xy[:, one, :, axis], 6, lost, "-1.0") for axis in (0, 1))
        return [whole_numbers(1 - lost), *together(*xy), number(chunk.frame)]

    lists(path, walk, "[", ", ".join([record] * walk.bodies), each(walk, body, numbers=0), "]")
    for spot in walk.spots:
        spot["confidence"] = (np.array(spot["confidence"]) > 0).astype(float).tolist()


def alphatracker(path: Path, walk: Walk) -> None:
    """Labels of animals: a box and points, none of which is missing."""
    point = f'{{"class": "point", "x": {GAP}, "y": {GAP}}}'
    box = '{"class": "Face", "height": 320.5, "width": 180.0, "x": 312.5, "y": 201.25}'
    parts = ", ".join([box, *[point] * walk.joints] * walk.bodies)
    template = f'{{"annotations": [{parts}], "class": "image", "filename": "{GAP}.png"}}'

    def cells(chunk: Chunk) -> Cells:
        bodies = [
            together(*(decimals(chunk.xy[:, one, :, axis], POINT, seed=axis) for axis in (0, 1)))
            for one in range(walk.bodies)
        ]
        return [*(cell for body in bodies for cell in body), number(chunk.frame)]

    lists(path, walk, "[", template, cells, "]")
    for spot in walk.spots:
        spot["confidence"] = [1.0] * walk.joints


def ultralytics_json(path: Path, walk: Walk) -> None:
    """A list with a list of results for each frame, with tracks."""
    body = (
        '{"name": "person", "class": 0, "confidence": 0.87312, "box": {"x1": 312.5, "y1": 201.25, "x2": 492.5, '
        f'"y2": 521.75}}, "track_id": %d, "keypoints": {{"x": [{gaps(walk.joints)}], "y": [{gaps(walk.joints)}], '
        f'"visible": [{gaps(walk.joints)}]}}}}'
    )
    template = "[" + ", ".join(body % (number + 1) for number in range(walk.bodies)) + "]"
    lists(path, walk, "[", template, each(walk, lambda chunk, one: [*xyc(chunk, one, 5, 5)], numbers=0), "]")


def mediapipe_json(path: Path, walk: Walk) -> None:
    """A list of landmarks for each frame."""
    mark = f'{{"x": {GAP}, "y": {GAP}, "z": {GAP}, "visibility": {GAP}}}'

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        xy = [decimals(chunk.xy[:, one, :, axis] / SIZE_PX[axis], SCORE, lost, seed=axis) for axis in (0, 1)]
        score = decimals(chunk.score[:, one], SCORE, lost, seed=2)
        return together(*xy, score, score)

    lists(path, walk, "[", f"[{gaps(walk.joints, mark)}]", each(walk, body, numbers=0), "]")
