"""Files of text, as trackers write them: JSON, tables, and folders with a file per frame."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.reading.bodies import SIZE_PX, Chunk, Walk
from uplift.data.formats.layouts import COCO_JOINTS
from uplift.skeleton import load_skeleton

__all__ = [
    "DLC_PARTS", "GAP", "alphapose", "alphatracker", "coco", "coco_results", "csv_long", "csv_named", "csv_wide",
    "decimals", "deeplabcut_csv", "filled", "kinetics", "mediapipe_csv", "mediapipe_json", "mmpose", "mmpose_tracked",
    "mpii", "openpose", "ultralytics", "ultralytics_json", "whole_numbers", "words",
]  # fmt: skip

GAP = "\x01"
"""Marks where a number goes in a template."""

Cells = list[np.ndarray]
"""(rows, gaps, width) bytes: the text that fills the gaps of each row."""

_POINT, _SCORE = 13, 16  # decimals of a network's output: all that a double has
DLC_PARTS = ("x", "y", "likelihood")


# Text from templates: all rows at once


def filled(template: str, cells: Sequence[np.ndarray]) -> bytes:
    """Return the template once per row, its gaps filled in the order of ``cells``; zero bytes are dropped."""
    columns = [array[:, gap] for array in cells for gap in range(array.shape[1])]
    parts = template.encode().split(GAP.encode())
    if len(parts) != len(columns) + 1:
        raise ValueError(f"{len(parts) - 1} gaps, {len(columns)} cells")
    width = sum(map(len, parts)) + sum(column.shape[1] for column in columns)
    text = np.empty((len(columns[0]), width), np.uint8)
    at = 0
    for number, part in enumerate(parts):
        text[:, at : at + len(part)] = np.frombuffer(part, np.uint8)
        at += len(part)
        if number < len(columns):
            column = columns[number]
            text[:, at : at + column.shape[1]] = column
            at += column.shape[1]
    flat = text.ravel()
    return flat[flat != 0].tobytes()


def whole_numbers(values: np.ndarray, digits: int | None = None, zeros: bool = False) -> np.ndarray:
    """Return (..., digits) bytes of non-negative integers, with or without leading zeros."""
    digits = digits or len(str(int(values.max(initial=0))))
    text = np.empty((*values.shape, digits), np.uint8)
    rest = values.astype(np.int64)
    for place in range(digits - 1, -1, -1):
        rest, digit = np.divmod(rest, 10)
        text[..., place] = digit + 48
    if not zeros:
        for place in range(digits - 1):
            text[..., place][values < 10 ** (digits - 1 - place)] = 0
    return text


def decimals(
    values: np.ndarray, count: int, missing: np.ndarray | None = None, instead: str = "0.0", seed: int = 0
) -> np.ndarray:
    """Return (rows, gaps, width) bytes of non-negative numbers with so many decimals; ``instead`` where ``missing``.

    Decimals after the sixth are random.
    """
    known = min(count, 6)
    scaled = np.round(values * 10**known).astype(np.int64)
    whole = whole_numbers(scaled // 10**known)
    share = whole_numbers(scaled % 10**known, known, zeros=True)
    drawn = np.random.default_rng(seed).integers(48, 58, (*values.shape, count - known), np.uint8)
    point = np.full((*values.shape, 1), ord("."), np.uint8)
    text = np.concatenate([whole, point, share, drawn], -1)
    if missing is not None:
        word = np.zeros(text.shape[-1], np.uint8)
        word[: len(instead)] = np.frombuffer(instead.encode(), np.uint8)
        text[missing] = word
    return text.reshape(len(values), -1, text.shape[-1])


def words(names: Sequence[str], rows: int) -> np.ndarray:
    """Return (rows, names, width) bytes: the names in each row."""
    width = max(map(len, names))
    text = np.frombuffer(b"".join(name.encode().ljust(width, b"\0") for name in names), np.uint8)
    return np.broadcast_to(text.reshape(1, -1, width), (rows, len(names), width))


def _gaps(count: int, of: str = GAP) -> str:
    return ", ".join([of] * count)


def _interleaved(*arrays: np.ndarray) -> Cells:
    """Return the first gap of each array, then the second of each, and so on."""
    return [array[:, gap : gap + 1] for gap in range(arrays[0].shape[1]) for array in arrays]


def _number(values: np.ndarray) -> np.ndarray:
    return whole_numbers(values)[:, None]


def _xyc(
    chunk: Chunk, bodies: int | slice, points: int = _POINT, scores: int = _SCORE, instead: str = "0.0"
) -> tuple[np.ndarray, ...]:
    """Return the text of x, y and score of one or several bodies."""
    missing = chunk.missing[:, bodies]
    xy = (decimals(chunk.xy[:, bodies, :, axis], points, missing, instead, axis) for axis in (0, 1))
    return (*xy, decimals(chunk.score[:, bodies], scores, missing, instead, 2))


def _frames(walk: Walk, body: Callable[[Chunk, int], Cells], *, numbered: bool = False) -> Callable[[Chunk], Cells]:
    """Return what fills a frame's record: its number if ``numbered``, then its bodies."""

    def cells(chunk: Chunk) -> Cells:
        found = [_number(chunk.frame)] * numbered
        for one in range(walk.bodies):
            found += body(chunk, one)
        return found

    return cells


def _write_list(
    path: Path, walk: Walk, start: str, template: str, cells: Callable[[Chunk], Cells], end: str = "", mode: str = "wb"
) -> None:
    """Write a list with one record per frame of ``walk``."""
    with path.open(mode) as file:
        file.write(start.encode())
        for chunk in walk.chunks():
            text = filled(template + ", ", cells(chunk))
            file.write(text[:-2] if chunk.frame[-1] == walk.frames - 1 else text)
        file.write(end.encode())


def _binary_confidence(walk: Walk) -> None:
    """Expect confidence 1 for all joints that are not missing: the format has no scores."""
    for spot in walk.spots:
        spot["confidence"] = (np.array(spot["confidence"]) > 0).astype(float).tolist()


# JSON


def coco(path: Path, walk: Walk) -> None:
    """Manual annotations: integer pixels and flags; a frame is an image."""
    images = f'{{"id": {GAP}, "file_name": "{GAP}.jpg", "width": {SIZE_PX[0]}, "height": {SIZE_PX[1]}}}'
    _write_list(path, walk, '{"images": [', images, lambda chunk: [_number(chunk.frame)] * 2)
    walk.spots.clear()
    annotation = (
        f'{{"id": {GAP}, "image_id": {GAP}, "category_id": 1, "iscrowd": 0, "area": 34567.0, "num_keypoints": 16, '
        f'"bbox": [312.5, 201.25, 180.0, 320.5], "keypoints": [{_gaps(3 * walk.joints)}]}}'
    )

    def body(chunk: Chunk, one: int) -> Cells:
        missing = chunk.missing[:, one]
        xy = (np.where(missing, 0, np.round(chunk.xy[:, one, :, axis])) for axis in (0, 1))
        points = _interleaved(*(whole_numbers(values) for values in (*xy, np.where(missing, 0, 2))))
        return [_number(chunk.frame * walk.bodies + one), _number(chunk.frame), *points]

    names = json.dumps(COCO_JOINTS)
    category = f'], "categories": [{{"id": 1, "name": "person", "keypoints": {names}, "skeleton": [[1, 2]]}}]}}'
    template = ", ".join([annotation] * walk.bodies)
    _write_list(path, walk, '], "annotations": [', template, _frames(walk, body), category, mode="ab")
    for spot in walk.spots:
        spot["keypoints"] = np.round(spot["keypoints"]).tolist()
    _binary_confidence(walk)


def coco_results(path: Path, walk: Walk) -> None:
    """A detector's results."""
    record = f'{{"image_id": {GAP}, "category_id": 1, "keypoints": [{_gaps(3 * walk.joints)}], "score": 0.8731236}}'
    cells = _frames(walk, lambda chunk, one: [_number(chunk.frame), *_interleaved(*_xyc(chunk, one))])
    _write_list(path, walk, "[", ", ".join([record] * walk.bodies), cells, "]")


def alphapose(path: Path, walk: Walk) -> None:
    """A video's results, with tracks."""
    record = (
        f'{{"image_id": "{GAP}.jpg", "category_id": 1, "keypoints": [{_gaps(3 * walk.joints)}], "score": 2.91328125, '
        '"box": [312.5, 201.25, 180.0, 320.5], "idx": [%d.0]}'
    )
    template = ", ".join(record % (body + 1) for body in range(walk.bodies))
    cells = _frames(walk, lambda chunk, one: [_number(chunk.frame), *_interleaved(*_xyc(chunk, one))])
    _write_list(path, walk, "[", template, cells, "]")


def mmpose(path: Path, walk: Walk) -> None:
    """A video's predictions, without track ids."""
    _mmpose(path, walk, lambda body: "")


def mmpose_tracked(path: Path, walk: Walk) -> None:
    """A video's predictions, with track ids."""
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
        return [*_interleaved(x, y), score]

    start = f'{{"meta_info": {{"dataset_name": "coco", "keypoint_id2name": {names}}}, "instance_info": ['
    template = f'{{"frame_id": {GAP}, "instances": [{bodies}]}}'
    _write_list(path, walk, start, template, _frames(walk, body, numbered=True), "]}")


def kinetics(path: Path, walk: Walk) -> None:
    """Skeletons of one video; coordinates are fractions with six decimals (three in the data set)."""
    bodies = [f'{{"pose": [{_gaps(2 * walk.joints)}], "score": [{_gaps(walk.joints)}]}}'] * walk.bodies
    template = f'{{"frame_index": {GAP}, "skeleton": [{", ".join(bodies)}]}}'

    def body(chunk: Chunk, one: int) -> Cells:
        missing = chunk.missing[:, one]
        xy = (decimals(chunk.xy[:, one, :, axis] / SIZE_PX[axis], 6, missing) for axis in (0, 1))
        return [*_interleaved(*xy), decimals(chunk.score[:, one], 3, missing)]

    end = '], "label": "walking", "label_index": 3}'
    _write_list(path, walk, '{"data": [', template, _frames(walk, body, numbered=True), end)


def mpii(path: Path, walk: Walk) -> None:
    """A list of people."""
    record = (
        f'{{"joints_vis": [{_gaps(walk.joints)}], "joints": [{_gaps(walk.joints, f"[{GAP}, {GAP}]")}], '
        f'"image": "{GAP}.jpg", "scale": 4.718488, "center": [966.0, 340.0]}}'
    )

    def body(chunk: Chunk, one: int) -> Cells:
        missing = chunk.missing[:, one]
        xy = (decimals(chunk.xy[:, one, :, axis], 6, missing, "-1.0") for axis in (0, 1))
        return [whole_numbers(1 - missing), *_interleaved(*xy), _number(chunk.frame)]

    _write_list(path, walk, "[", ", ".join([record] * walk.bodies), _frames(walk, body), "]")
    _binary_confidence(walk)


def alphatracker(path: Path, walk: Walk) -> None:
    """Labels of animals: a box and points, none missing."""
    point = f'{{"class": "point", "x": {GAP}, "y": {GAP}}}'
    box = '{"class": "Face", "height": 320.5, "width": 180.0, "x": 312.5, "y": 201.25}'
    parts = ", ".join([box, *[point] * walk.joints] * walk.bodies)
    template = f'{{"annotations": [{parts}], "class": "image", "filename": "{GAP}.png"}}'

    def cells(chunk: Chunk) -> Cells:
        bodies = [
            _interleaved(*(decimals(chunk.xy[:, one, :, axis], _POINT, seed=axis) for axis in (0, 1)))
            for one in range(walk.bodies)
        ]
        return [*(cell for body in bodies for cell in body), _number(chunk.frame)]

    _write_list(path, walk, "[", template, cells, "]")
    for spot in walk.spots:
        spot["confidence"] = [1.0] * walk.joints


def ultralytics_json(path: Path, walk: Walk) -> None:
    """A list of results for each frame, with tracks."""
    body = (
        '{"name": "person", "class": 0, "confidence": 0.87312, "box": {"x1": 312.5, "y1": 201.25, "x2": 492.5, '
        f'"y2": 521.75}}, "track_id": %d, "keypoints": {{"x": [{_gaps(walk.joints)}], "y": [{_gaps(walk.joints)}], '
        f'"visible": [{_gaps(walk.joints)}]}}}}'
    )
    template = "[" + ", ".join(body % (number + 1) for number in range(walk.bodies)) + "]"
    _write_list(path, walk, "[", template, _frames(walk, lambda chunk, one: [*_xyc(chunk, one, 5, 5)]), "]")


def mediapipe_json(path: Path, walk: Walk) -> None:
    """A list of landmarks for each frame."""
    mark = f'{{"x": {GAP}, "y": {GAP}, "z": {GAP}, "visibility": {GAP}}}'

    def body(chunk: Chunk, one: int) -> Cells:
        missing = chunk.missing[:, one]
        xy = [decimals(chunk.xy[:, one, :, axis] / SIZE_PX[axis], _SCORE, missing, seed=axis) for axis in (0, 1)]
        score = decimals(chunk.score[:, one], _SCORE, missing, seed=2)
        return _interleaved(*xy, score, score)

    _write_list(path, walk, "[", f"[{_gaps(walk.joints, mark)}]", _frames(walk, body), "]")


# Folders with a file per frame


def openpose(path: Path, walk: Walk) -> None:
    """OpenPose: people of 25 keypoints, without track ids."""
    empty = ", ".join(f'"{part}_keypoints_2d": []' for part in ("face", "hand_left", "hand_right"))
    person = f'{{"person_id": [-1], "pose_keypoints_2d": [{_gaps(3 * walk.joints, GAP)}], {empty}}}'
    template = f'{{"version": 1.3, "people": [{", ".join([person] * walk.bodies)}]}}\n'
    cells = _frames(walk, lambda chunk, one: _interleaved(*_xyc(chunk, one, 3, 6)))
    _folder(path, walk, template, cells, "video_%012d_keypoints.json")


def ultralytics(path: Path, walk: Walk) -> None:
    """Ultralytics predictions: class, box, keypoints as fractions of the image size, score, track."""
    row = f"0 {' '.join([GAP] * (4 + 3 * walk.joints))} 0.873124 %d\n"
    template = "".join(row % (body + 1) for body in range(walk.bodies)) + "\n"

    def body(chunk: Chunk, one: int) -> Cells:
        missing = chunk.missing[:, one]
        shares = chunk.xy[:, one] / SIZE_PX
        low = np.where(missing[..., None], 1, shares).min(1)
        high = np.where(missing[..., None], 0, shares).max(1)
        box = decimals(np.concatenate([(low + high) / 2, high - low], -1), 6)
        xy = (decimals(shares[..., axis], 6, missing, "0") for axis in (0, 1))
        return [box, *_interleaved(*xy, decimals(chunk.score[:, one], 6, missing, "0"))]

    (path / "labels").mkdir(parents=True)
    _folder(path / "labels", walk, template, _frames(walk, body), "video_%d.txt", between=b"\n\n")


def _folder(
    path: Path, walk: Walk, template: str, cells: Callable[[Chunk], Cells], name: str, between: bytes = b"\n"
) -> None:
    path.mkdir(parents=True, exist_ok=True)
    for chunk in walk.chunks():
        texts = filled(template, cells(chunk)).split(between)[:-1]
        for number, text in zip(chunk.frame.tolist(), texts, strict=True):
            (path / (name % number)).write_bytes(text + b"\n")


# Tables

_SCORER = "DLC_resnet50_walkJan1shuffle1_100000"
_LEVELS = ("scorer", "individuals", "bodyparts", "coords")


def deeplabcut_csv(path: Path, walk: Walk) -> None:
    """Predictions; with individuals if there are several bodies."""
    individuals = [f"ind{body + 1}" for body in range(walk.bodies)]
    columns = [(_SCORER, who, joint, part) for who in individuals for joint in _joints(walk) for part in DLC_PARTS]
    levels = [level for level in range(4) if level != 1 or walk.bodies > 1]
    head = "".join(",".join([_LEVELS[level], *(column[level] for column in columns)]) + "\n" for level in levels)
    _write_table(path, walk, head, _row(1 + len(columns)), lambda chunk: [
        _number(chunk.frame), *_interleaved(*_xyc(chunk, slice(None), instead=""))
    ])  # fmt: skip


def mediapipe_csv(path: Path, walk: Walk) -> None:
    """A row per frame of named landmarks: fractions of the image size, depth, visibility."""
    names = tuple(name.upper() for name in load_skeleton("mediapipe33").joints if name not in ("pelvis", "neck"))
    head = "frame," + _columns(names, ("x", "y", "z", "visibility")) + "\n"

    def cells(chunk: Chunk) -> Cells:
        missing = chunk.missing[:, 0]
        xy = [decimals(chunk.xy[:, 0, :, axis] / SIZE_PX[axis], _SCORE, missing, "", axis) for axis in (0, 1)]
        score = decimals(chunk.score[:, 0], _SCORE, missing, "", 2)
        return [_number(chunk.frame), *_interleaved(*xy, score, score)]

    _write_table(path, walk, head, _row(1 + 4 * walk.joints), cells)


def csv_wide(path: Path, walk: Walk) -> None:
    """A row per frame and body, without names."""
    _csv_rows(path, walk)


def csv_named(path: Path, walk: Walk) -> None:
    """A row per frame and individual."""
    _csv_rows(path, walk, named=True)


def _csv_rows(path: Path, walk: Walk, *, named: bool = False) -> None:
    start = "frame,individual" if named else "frame"
    head = f"{start},{_columns(_joints(walk), ('x', 'y', 'confidence'))}\n"

    def body(chunk: Chunk, one: int) -> Cells:
        name = [words([f"mouse{one + 1}"], len(chunk.frame))] * named
        return [_number(chunk.frame), *name, *_interleaved(*_xyc(chunk, one, 6, 6, ""))]

    _write_table(path, walk, head, _row(1 + named + 3 * walk.joints) * walk.bodies, _frames(walk, body))


def csv_long(path: Path, walk: Walk) -> None:
    """A row per frame and joint."""
    template = "".join(f"{GAP},{name},{GAP},{GAP},{GAP}\n" for name in _joints(walk))

    def cells(chunk: Chunk) -> Cells:
        numbers = np.repeat(_number(chunk.frame), walk.joints, 1)
        return _interleaved(numbers, *_xyc(chunk, 0, 6, 6, ""))

    _write_table(path, walk, "frame,joint,x,y,confidence\n", template, cells)


def _write_table(path: Path, walk: Walk, head: str, template: str, cells: Callable[[Chunk], Cells]) -> None:
    with path.open("wb") as file:
        file.write(head.encode())
        file.writelines(filled(template, cells(chunk)) for chunk in walk.chunks())


def _row(columns: int) -> str:
    return ",".join([GAP] * columns) + "\n"


def _columns(names: Sequence[str], parts: Sequence[str]) -> str:
    return ",".join(f"{name}_{part}" for name in names for part in parts)


def _joints(walk: Walk) -> tuple[str, ...]:
    return COCO_JOINTS[: walk.joints]
