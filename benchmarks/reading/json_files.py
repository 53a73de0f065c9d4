"""Files of JSON as trackers and annotation tools write them, and Ultralytics' label files, of many bodies."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from benchmarks.reading.bodies import SIZE_PX, Chunk, Walk
from benchmarks.reading.lines import GAP, decimals, filled, whole_numbers
from uplift.datasets.coco import COCO_JOINTS

__all__ = [
    "alphapose", "alphatracker", "coco", "coco_results", "kinetics", "mediapipe_json", "mmpose", "mmpose_tracked",
    "mpii", "openpose", "ultralytics", "ultralytics_json",
]  # fmt: skip

_POINT, _SCORE = 13, 16  # decimals of a network's numbers: all that a double has
Cells = list[np.ndarray]


def _gaps(count: int, of: str = GAP) -> str:
    return ", ".join([of] * count)


def _lists(path: Path, walk: Walk, start: str, template: str, cells: Callable[[Chunk], Cells], end: str) -> None:
    """Write a list with one record a frame of ``walk``."""
    with path.open("wb") as file:
        file.write(start.encode())
        for chunk in walk.chunks():
            text = filled(template + ", ", cells(chunk))
            last = chunk.frame[-1] == walk.frames - 1
            file.write(text[:-2] if last else text)
        file.write(end.encode())


def _together(*arrays: np.ndarray) -> Cells:
    """Return the arrays' gaps in turns."""
    return [array[:, gap : gap + 1] for gap in range(arrays[0].shape[1]) for array in arrays]


def _number(values: np.ndarray) -> np.ndarray:
    return whole_numbers(values)[:, None]


def _xyc(chunk: Chunk, body: int, points: int = _POINT, scores: int = _SCORE) -> tuple[np.ndarray, ...]:
    """Return the (frames, joints, width) bytes of x, y and score of one body."""
    lost = chunk.missing[:, body]
    xy = (decimals(chunk.xy[:, body, :, axis], points, lost, seed=axis) for axis in (0, 1))
    return (*xy, decimals(chunk.score[:, body], scores, lost, seed=2))


def _each(walk: Walk, body: Callable[[Chunk, int], Cells], *, numbers: int = 1) -> Callable[[Chunk], Cells]:
    """Return what fills a frame's record: its number so many times, then its bodies."""

    def cells(chunk: Chunk) -> Cells:
        found = [_number(chunk.frame)] * numbers
        for one in range(walk.bodies):
            found += body(chunk, one)
        return found

    return cells


def coco(path: Path, walk: Walk) -> None:
    """Annotations by hand: whole pixels and flags; a frame is an image."""
    images = f'{{"id": {GAP}, "file_name": "{GAP}.jpg", "width": {SIZE_PX[0]}, "height": {SIZE_PX[1]}}}'
    _lists(path, walk, '{"images": [', images, lambda chunk: [_number(chunk.frame)] * 2, '], "annotations": [')
    walk.spots.clear()
    annotation = (
        f'{{"id": {GAP}, "image_id": {GAP}, "category_id": 1, "iscrowd": 0, "area": 34567.0, "num_keypoints": 16, '
        f'"bbox": [312.5, 201.25, 180.0, 320.5], "keypoints": [{_gaps(3 * walk.joints)}]}}'
    )

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        xy = (np.where(lost, 0, np.round(chunk.xy[:, one, :, axis])) for axis in (0, 1))
        flags = np.where(lost, 0, 2)
        points = _together(*(whole_numbers(values) for values in (*xy, flags)))
        return [_number(chunk.frame * walk.bodies + one), _number(chunk.frame), *points]

    own = _part(path, walk, ", ".join([annotation] * walk.bodies), _each(walk, body, numbers=0))
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
    record = f'{{"image_id": {GAP}, "category_id": 1, "keypoints": [{_gaps(3 * walk.joints)}], "score": 0.8731236}}'
    cells = _each(walk, lambda chunk, one: [_number(chunk.frame), *_together(*_xyc(chunk, one))], numbers=0)
    _lists(path, walk, "[", ", ".join([record] * walk.bodies), cells, "]")


def alphapose(path: Path, walk: Walk) -> None:
    """A video's results, with tracks."""
    record = (
        f'{{"image_id": "{GAP}.jpg", "category_id": 1, "keypoints": [{_gaps(3 * walk.joints)}], "score": 2.91328125, '
        '"box": [312.5, 201.25, 180.0, 320.5], "idx": [%d.0]}'
    )
    template = ", ".join(record % (body + 1) for body in range(walk.bodies))
    cells = _each(walk, lambda chunk, one: [_number(chunk.frame), *_together(*_xyc(chunk, one))], numbers=0)
    _lists(path, walk, "[", template, cells, "]")


def mmpose(path: Path, walk: Walk) -> None:
    """A video's predictions, bodies without numbers."""
    _mmpose(path, walk, lambda body: "")


def mmpose_tracked(path: Path, walk: Walk) -> None:
    """A video's predictions, bodies with tracks."""
    _mmpose(path, walk, lambda body: f', "track_id": {body}')


def _mmpose(path: Path, walk: Walk, track: Callable[[int], str]) -> None:
    names = json.dumps({str(number): name for number, name in enumerate(COCO_JOINTS)})
    bodies = ", ".join(
        f'{{"keypoints": [{_gaps(walk.joints, f"[{GAP}, {GAP}]")}], "keypoint_scores": [{_gaps(walk.joints)}], '
        f'"bbox": [[312.5, 201.25, 492.5, 521.75]], "bbox_score": 0.8731236{track(body)}}}'
        for body in range(walk.bodies)
    )

    def body(chunk: Chunk, one: int) -> Cells:
        x, y, score = _xyc(chunk, one)
        return [*_together(x, y), score]

    start = f'{{"meta_info": {{"dataset_name": "coco", "keypoint_id2name": {names}}}, "instance_info": ['
    template = f'{{"frame_id": {GAP}, "instances": [{bodies}]}}'
    _lists(path, walk, start, template, _each(walk, body), "]}")


def kinetics(path: Path, walk: Walk) -> None:
    """Skeletons of one video, coordinates as shares of three decimals in its data set, of six here."""
    bodies = [f'{{"pose": [{_gaps(2 * walk.joints)}], "score": [{_gaps(walk.joints)}]}}'] * walk.bodies
    template = f'{{"frame_index": {GAP}, "skeleton": [{", ".join(bodies)}]}}'

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        xy = (decimals(chunk.xy[:, one, :, axis] / SIZE_PX[axis], 6, lost) for axis in (0, 1))
        return [*_together(*xy), decimals(chunk.score[:, one], 3, lost)]

    _lists(path, walk, '{"data": [', template, _each(walk, body), '], "label": "walking", "label_index": 3}')


def mpii(path: Path, walk: Walk) -> None:
    """A list of people."""
    record = (
        f'{{"joints_vis": [{_gaps(walk.joints)}], "joints": [{_gaps(walk.joints, f"[{GAP}, {GAP}]")}], '
        f'"image": "{GAP}.jpg", "scale": 4.718488, "center": [966.0, 340.0]}}'
    )

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        xy = (decimals(chunk.xy[:, one, :, axis], 6, lost, "-1.0") for axis in (0, 1))
        return [whole_numbers(1 - lost), *_together(*xy), _number(chunk.frame)]

    _lists(path, walk, "[", ", ".join([record] * walk.bodies), _each(walk, body, numbers=0), "]")
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
            _together(*(decimals(chunk.xy[:, one, :, axis], _POINT, seed=axis) for axis in (0, 1)))
            for one in range(walk.bodies)
        ]
        return [*(cell for body in bodies for cell in body), _number(chunk.frame)]

    _lists(path, walk, "[", template, cells, "]")
    for spot in walk.spots:
        spot["confidence"] = [1.0] * walk.joints


def ultralytics_json(path: Path, walk: Walk) -> None:
    """A list with a list of results for each frame, with tracks."""
    body = (
        '{"name": "person", "class": 0, "confidence": 0.87312, "box": {"x1": 312.5, "y1": 201.25, "x2": 492.5, '
        f'"y2": 521.75}}, "track_id": %d, "keypoints": {{"x": [{_gaps(walk.joints)}], "y": [{_gaps(walk.joints)}], '
        f'"visible": [{_gaps(walk.joints)}]}}}}'
    )
    template = "[" + ", ".join(body % (number + 1) for number in range(walk.bodies)) + "]"
    _lists(path, walk, "[", template, _each(walk, lambda chunk, one: [*_xyc(chunk, one, 5, 5)], numbers=0), "]")


def mediapipe_json(path: Path, walk: Walk) -> None:
    """A list of landmarks for each frame."""
    mark = f'{{"x": {GAP}, "y": {GAP}, "z": {GAP}, "visibility": {GAP}}}'

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        xy = [decimals(chunk.xy[:, one, :, axis] / SIZE_PX[axis], _SCORE, lost, seed=axis) for axis in (0, 1)]
        score = decimals(chunk.score[:, one], _SCORE, lost, seed=2)
        return _together(*xy, score, score)

    _lists(path, walk, "[", f"[{_gaps(walk.joints, mark)}]", _each(walk, body, numbers=0), "]")


def openpose(path: Path, walk: Walk) -> None:
    """A folder with a file a frame: people of 25 keypoints, without numbers."""
    empty = ", ".join(f'"{part}_keypoints_2d": []' for part in ("face", "hand_left", "hand_right"))
    person = f'{{"person_id": [-1], "pose_keypoints_2d": [{_gaps(3 * walk.joints, GAP)}], {empty}}}'
    template = f'{{"version": 1.3, "people": [{", ".join([person] * walk.bodies)}]}}\n'
    cells = _each(walk, lambda chunk, one: _together(*_xyc(chunk, one, 3, 6)), numbers=0)
    _folder(path, walk, template, cells, "video_%012d_keypoints.json")


def ultralytics(path: Path, walk: Walk) -> None:
    """A folder with a file of predictions a frame: class, box, keypoints as shares, score, track."""
    row = f"0 {' '.join([GAP] * (4 + 3 * walk.joints))} 0.873124 %d\n"
    template = "".join(row % (body + 1) for body in range(walk.bodies)) + "\n"

    def body(chunk: Chunk, one: int) -> Cells:
        lost = chunk.missing[:, one]
        shares = chunk.xy[:, one] / SIZE_PX
        low = np.where(lost[..., None], 1, shares).min(1)
        high = np.where(lost[..., None], 0, shares).max(1)
        box = decimals(np.concatenate([(low + high) / 2, high - low], -1), 6)
        xy = (decimals(shares[..., axis], 6, lost, "0") for axis in (0, 1))
        return [box, *_together(*xy, decimals(chunk.score[:, one], 6, lost, "0"))]

    (path / "labels").mkdir(parents=True)
    _folder(path / "labels", walk, template, _each(walk, body, numbers=0), "video_%d.txt", between=b"\n\n")


def _folder(
    path: Path, walk: Walk, template: str, cells: Callable[[Chunk], Cells], name: str, between: bytes = b"\n"
) -> None:
    path.mkdir(parents=True, exist_ok=True)
    for chunk in walk.chunks():
        texts = filled(template, cells(chunk)).split(between)[:-1]
        for number, text in zip(chunk.frame.tolist(), texts, strict=True):
            (path / (name % number)).write_bytes(text + b"\n")
