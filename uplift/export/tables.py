"""Poses as tables: CSV, self-describing JSON, and npz in the layout of the data files."""

from __future__ import annotations

import json
import math
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.config.files import as_bytes, scratch
from uplift.data.parsers.table import safe_cell
from uplift.export.scene import AXES
from uplift.export.stream import Stream
from uplift.models.prediction import Prediction

__all__ = [
    "CsvStream", "JsonStream", "NpzStream", "cell", "in_parts", "labels", "lines_of", "plain", "unique", "write_csv", "write_json",
    "write_npz",
]  # fmt: skip

# What writers of text share: numbers as text, identities as plain values, names, keypoints that were seen.

_NUMBER = {"place": "%.7g", "px": "%.6g", "share": "%.4g"}
"""How numbers are rounded: places to the seven digits of a 32-bit number, pixels to six, confidence to four."""
_ROWS = 256


def plain(values: Any) -> list[Any]:
    """Return numbers and texts as Python has them, None for what is not finite; anything else as its text."""
    found = []
    for value in np.asarray(values).tolist():
        if isinstance(value, float) and not math.isfinite(value):
            value = None
        elif isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        found.append(value if value is None or isinstance(value, bool | int | float | str) else str(value))
    return found


def _seen_keypoints(prediction: Prediction) -> Float[np.ndarray, "frames joints 2"]:
    """Return the keypoints, px, NaN where a joint was not seen."""
    seen = np.isfinite(prediction.keypoints).all(-1) & (prediction.confidence > 0)
    return np.where(seen[..., None], prediction.keypoints, np.nan)


def in_parts(prediction: Prediction, rows: int = _ROWS) -> Iterator[Prediction]:
    """Yield the frames in parts small enough to be held as text."""
    for start in range(0, len(prediction), rows):
        yield prediction.select(slice(start, start + rows))


def lines_of(template: str, *columns: np.ndarray, missing: str = "") -> list[str]:
    """Return ``template`` with the numbers of each frame in their places, out of arrays (frames ...) in their order.

    ``missing`` stands for what is not finite. The template has no line ends.
    """
    rows = np.concatenate([column.reshape(len(column), -1).astype(np.float64) for column in columns], 1)
    rows = np.where(np.isfinite(rows), rows, np.nan) + 0.0  # + 0.0: -0 is written 0
    text = (template + "\n") * len(rows) % tuple(rows.ravel().tolist())
    return (text.replace("nan", missing) if "nan" in text else text).split("\n")[:-1]


def unique(names: Iterable[str], same: Callable[[str], str] = str) -> list[str]:
    """Return names with ``_2``, ``_3``, ... behind those that were there before; ``same`` is what is compared."""
    found: dict[str, str] = {}
    for name in names:
        number, fresh = 1, name
        while same(fresh) in found:
            number += 1
            fresh = f"{name}_{number}"
        found[same(fresh)] = fresh
    return list(found.values())


def labels(names: Iterable[str], without: str = "") -> list[str]:
    """Return names for other programs: ``_`` in place of control characters, of what is no text, and of ``without``, part of a regular expression's set; none is empty, all differ."""
    wrong = rf"[\x00-\x1f\x7f-\x9f\ud800-\udfff{without}]+"
    return unique(re.sub(wrong, "_", name) or "_" for name in names)


# CSV: one row per frame and individual, for spreadsheets, R and pandas.


class CsvStream(Stream):
    """The table of `write_csv`, part by part."""

    def __init__(self, path: str | Path, axes: str | None = None, *, csv_safe: bool = False):
        super().__init__(path, axes)
        self._written = partial(cell, safe=csv_safe)

    def write_part(self, prediction: Prediction, first: bool) -> None:
        facts = {
            "unit": prediction.unit,
            "axes": prediction.axes,
            "origin": "root" if prediction.root is None else "camera",
        }
        if prediction.fps is not None and math.isfinite(prediction.fps):
            facts["fps"] = f"{prediction.fps:.7g}"
        columns, written = _columns(prediction), self._written
        if first:
            names = [*prediction.identity, *facts, *(name for name, _ in columns)]
            if len(set(names)) < len(names):
                twice = sorted({name for name in names if names.count(name) > 1})
                raise ValueError(f"prediction: several columns would be called {', '.join(twice)}")
            self._handle.write(as_bytes(",".join(map(written, names)) + "\n"))
        template = ",".join(style for _, style in columns)
        known = ",".join(map(written, facts.values())) + ","
        for part in in_parts(prediction):
            keys = [[f"{written(value)}," for value in plain(values)] for values in part.identity.values()]
            rows = zip(*keys, repeat(known), lines_of(template, *_csv_arrays(part)), repeat("\n"), strict=False)
            self._handle.write(as_bytes("".join(chain.from_iterable(rows))))


def write_csv(prediction: Prediction, path: str | Path, *, csv_safe: bool = False) -> None:
    """Write identity, unit and axes, then of every joint its place, keypoint and confidence; UTF-8, commas.

    ``NAME_x``, ``NAME_y``, ``NAME_z`` are in the row's ``unit`` and ``axes``, from its ``origin``: the
    ``camera`` where the root has a known place, else the ``root`` joint. ``NAME_u_px`` and ``NAME_v_px``
    are the keypoint as seen; ``NAME_uncertainty`` and ``NAME_filled`` (0 or 1) are there where they are
    known. What is missing is an empty cell. With ``csv_safe`` names that a spreadsheet would run as a formula
    begin with an apostrophe. Raises ValueError where two columns would have one name.
    """
    with CsvStream(path, csv_safe=csv_safe) as stream:
        stream.append(prediction)


def _columns(prediction: Prediction) -> list[tuple[str, str]]:
    """Return the name of each column of numbers and how its numbers are written, in the order of `_csv_arrays`."""
    place, px, share = _NUMBER["place"], _NUMBER["px"], _NUMBER["share"]
    joint = {"x": place, "y": place, "z": place, "u_px": px, "v_px": px, "confidence": share}
    optional = {"uncertainty": (prediction.uncertainty, px), "filled": (prediction.filled, "%d")}
    joint |= {key: style for key, (values, style) in optional.items() if values is not None}
    columns = [(f"{name}_{key}", style) for name in prediction.joint_names for key, style in joint.items()]
    return [*((name, px) for name in _camera_angles(prediction)), *columns]


def _csv_arrays(prediction: Prediction) -> list[np.ndarray]:
    optional = [values[..., None] for values in (prediction.uncertainty, prediction.filled) if values is not None]
    seen = _seen_keypoints(prediction)
    table = np.concatenate([prediction.points, seen, prediction.confidence[..., None], *optional], -1)
    return [*_camera_angles(prediction).values(), table]


def _camera_angles(prediction: Prediction) -> dict[str, np.ndarray]:
    """Return the camera's tilt and roll, those that are known."""
    angles = {"tilt_deg": prediction.tilt_deg, "roll_deg": prediction.roll_deg}
    return {name: values for name, values in angles.items() if values is not None}


def cell(value: object, safe: bool = False) -> str:
    """Return a value as the text of one cell, in quotes where it would not be one cell without."""
    text = "" if value is None else str(value)
    text = safe_cell(text) if safe and isinstance(value, str) else text
    if text.strip() != text or any(sign in text for sign in ',"\r\n'):
        return '"' + text.replace('"', '""') + '"'
    return text


# Self-describing JSON: one object, one line per frame and individual.

_MEANING = {
    "identity": "which frame, and of whom",
    "pose": "joints x [x, y, z], relative to the root joint, in unit and axes",
    "root": "[x, y, z] of the root joint, from the camera, in unit and axes",
    "keypoints": "joints x [u, v] as seen, px, u right, v down",
    "confidence": "joints, 0 to 1; 0 is not seen",
    "uncertainty": "joints, the error to expect of the depth, of a filled joint of its whole place, in unit",
    "filled": "joints, true where the joint was not seen",
    "tilt_deg": "how far the camera looks down, degrees",
    "roll_deg": "how far up leans to the right in the image, degrees",
    "gravity": "[x, y, z], a unit vector in the camera's axes (x right, y down, z away)",
    "hypotheses": "whole poses that fit the keypoints, the most likely first, each as in pose",
    "weights": "hypotheses, how likely each is, 0 to 1",
    "ground_point": "[x, y, z] of a point on the ground, from the camera, in unit and axes",
    "ground_normal": "[x, y, z], a unit vector that points up from the ground, in axes",
    "contact": "joints, true where the joint stands on the ground",
}


class JsonStream(Stream):
    """The object of `write_json`, part by part."""

    alike = (*Stream.alike, "image_size")

    def write_part(self, prediction: Prediction, first: bool) -> None:
        if first:
            facts = _head(prediction).items()
            head = [f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)},\n" for key, value in facts]
            self._handle.write(("{\n" + "".join(head) + ' "frames": [').encode())
            self._before = "\n  "
        for part in in_parts(prediction):
            self._handle.write((self._before + ",\n  ".join(_frames(part))).encode())
            self._before = ",\n  "

    def finish(self) -> str:
        self._handle.write(b"\n ]\n}\n")
        return ""


def write_json(prediction: Prediction, path: str | Path) -> None:
    """Write names, bones, unit and axes, then every frame; what is missing is null.

    Coordinates are rounded to seven significant digits. The text is written part by part and never in memory at once.
    """
    with JsonStream(path) as stream:
        stream.append(prediction)


def _head(prediction: Prediction) -> dict[str, Any]:
    fps = prediction.fps
    return {
        "format": "uplift poses",
        "version": 1,
        "skeleton": prediction.skeleton.name,
        "joint_names": list(prediction.joint_names),
        "root_joint": prediction.skeleton.root,
        "bones": [list(bone) for bone in prediction.skeleton.bones],
        "unit": prediction.unit,
        "axes": prediction.axes,
        "axes_meaning": AXES.get(prediction.axes),
        "fps": float(f"{fps:.7g}") if fps is not None and math.isfinite(fps) else None,
        "image_size": None if prediction.image_size is None else [int(side) for side in prediction.image_size],
        "fields": {name: meaning for name, meaning in _MEANING.items() if getattr(prediction, name) is not None},
    }


def _frames(prediction: Prediction) -> Iterator[str]:
    seen, place, px = _seen_keypoints(prediction), _NUMBER["place"], _NUMBER["px"]
    styles = {
        "pose": place,
        "root": place,
        "keypoints": px,
        "confidence": _NUMBER["share"],
        "uncertainty": px,
        "tilt_deg": px,
        "roll_deg": px,
        "gravity": place,
        "hypotheses": place,
        "weights": _NUMBER["share"],
        "ground_point": place,
        "ground_normal": place,
    }
    found = {name: seen if name == "keypoints" else getattr(prediction, name) for name in styles}
    blocks = {name: (values, styles[name]) for name, values in found.items() if values is not None}
    template = "".join(f', "{name}": {_shaped(values.shape[1:], style)}' for name, (values, style) in blocks.items())
    marks = {name: getattr(prediction, name) for name in ("filled", "contact")}
    marks = {name: np.asarray(values, bool) for name, values in marks.items() if values is not None}
    keys = [json.dumps(key) for key in prediction.identity]
    columns = [plain(values) for values in prediction.identity.values()]
    labels = zip(*columns, strict=True) if columns else ((),) * len(prediction)
    rows = lines_of(template, *(values for values, _ in blocks.values()), missing="null")
    for index, (label, row) in enumerate(zip(labels, rows, strict=True)):
        known = ", ".join(f"{key}: {json.dumps(value)}" for key, value in zip(keys, label, strict=True))
        flags = "".join(
            f', "{name}": {json.dumps(values[index].tolist(), separators=(",", ":"))}' for name, values in marks.items()
        )
        yield f'{{"identity": {{{known}}}{row}{flags}}}'


def _shaped(shape: tuple[int, ...], style: str) -> str:
    """Return nested lists of this shape as text, ``style`` for every number."""
    return style if not shape else "[" + ",".join([_shaped(shape[1:], style)] * shape[0]) + "]"


# npz in the layout of the data files, readable without pickle.

_OLDEST = (1980, 1, 1, 0, 0, 0)
_BLOCK = 1 << 20
"""Bytes that are moved at once. All blocks are as large but the last: what Deflate makes of text may depend on them."""


def write_npz(prediction: Prediction, path: str | Path) -> None:
    """Write keypoints, poses, unit, gravity, names, bones and identity; the same poses give the same bytes.

    ``pose`` and ``level_pose`` (frames joints 3) are in ``unit``, relative to the root; ``bones``
    (bones 2) indexes ``joint_names``; ``root`` (frames 3) is its place where that is known; ``hypotheses``
    (frames hypotheses joints 3) and their ``weights`` (frames hypotheses), ``ground_point``, ``ground_normal``
    (frames 3) and ``contact`` (frames joints) are there where they were asked for. The truth is not written: ``pose`` is the prediction.
    """
    with NpzStream(path) as stream:
        stream.append(prediction)


class NpzStream(Stream):
    """The arrays of `write_npz`, part by part: each grows in a nameless file until they are packed at the end."""

    alike = (*Stream.alike, "image_size")

    def __init__(self, path: str | Path, axes: str | None = None):
        super().__init__(path, axes)
        self._columns: dict[str, _Column] = {}

    def write_part(self, prediction: Prediction, first: bool) -> None:
        for name, array in _npz_arrays(prediction).items():
            if first:
                self._columns[name] = _Column(array, lambda: self._stack.enter_context(scratch(self.path)))
            elif name not in _OF_ALL:
                self._columns[name].append(array)

    def finish(self) -> str:
        with zipfile.ZipFile(self._handle, "w") as archive:
            for name, column in self._columns.items():
                entry = zipfile.ZipInfo(f"{name}.npy", date_time=_OLDEST)
                # Names repeat and shrink a hundredfold; floats hardly shrink and would make writing slow.
                entry.compress_type = zipfile.ZIP_DEFLATED if column.kind.kind in "US" else zipfile.ZIP_STORED
                with archive.open(entry, "w", force_zip64=True) as member:
                    column.write(member)
        return ""


class _Column:
    """An array that grows by rows, in a file as soon as there is a second part: a lone one is written from memory."""

    def __init__(self, first: np.ndarray, scratch: Callable[[], Any]):
        self._waiting, self._parts = first, [(first.dtype, first.shape)]
        self._scratch, self._file = scratch, None

    @property
    def kind(self) -> np.dtype:
        """Of all rows: text is as long as the longest."""
        return np.result_type(*{kind for kind, _ in self._parts})

    def append(self, rows: np.ndarray) -> None:
        if self._file is None:
            self._file = self._scratch()
            self._file.write(_raw(self._waiting))
            self._waiting = rows[:0]
        self._file.write(_raw(rows))
        self._parts.append((rows.dtype, rows.shape))

    def write(self, member: Any) -> None:
        """Write the header and the rows of an .npy."""
        shape = self._parts[0][1]
        shape = (sum(shape[0] for _, shape in self._parts), *shape[1:]) if self._file else shape
        facts = {"descr": np.lib.format.dtype_to_descr(self.kind), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, facts)
        waiting = bytearray()
        for piece in self._pieces():
            waiting += _raw(piece.astype(self.kind, copy=False))
            while len(waiting) >= _BLOCK:
                member.write(waiting[:_BLOCK])
                del waiting[:_BLOCK]
        member.write(waiting)

    def _pieces(self) -> Iterator[np.ndarray]:
        """Yield the values of all rows in order, few at a time."""
        if self._file is not None:
            self._file.seek(0)
        for kind, shape in self._parts:
            count, most = math.prod(shape), max(_BLOCK // max(kind.itemsize, 1), 1)
            for start in range(0, count, most):
                end = min(start + most, count)
                if self._file is None:
                    yield self._waiting.reshape(-1)[start:end]
                else:
                    yield np.frombuffer(self._file.read((end - start) * kind.itemsize), kind)


def _raw(values: np.ndarray) -> memoryview:
    return np.ascontiguousarray(values).reshape(-1).view(np.uint8).data


_OF_ALL = {"joint_names", "unit", "bones", "skeleton", "axes", "fps", "image_size"}
"""Arrays that are not of frames."""


def _npz_arrays(prediction: Prediction) -> dict[str, np.ndarray]:
    found = {
        "keypoints": (prediction.keypoints, np.float32),
        "confidence": (prediction.confidence, np.float32),
        "joint_names": (prediction.joint_names, np.str_),
        "pose": (prediction.pose, np.float32),
        "level_pose": (prediction.level_pose, np.float32),
        "unit": (prediction.unit, np.str_),
        "bones": (prediction.bone_indices, np.int64),
        "skeleton": (prediction.skeleton.name, np.str_),
        "axes": (prediction.axes, np.str_),
        "tilt_deg": (prediction.tilt_deg, np.float32),
        "roll_deg": (prediction.roll_deg, np.float32),
        "gravity": (prediction.gravity, np.float32),
        "hypotheses": (prediction.hypotheses, np.float32),
        "weights": (prediction.weights, np.float32),
        "ground_point": (prediction.ground_point, np.float32),
        "ground_normal": (prediction.ground_normal, np.float32),
        "contact": (prediction.contact, np.bool_),
        "uncertainty": (prediction.uncertainty, np.float32),
        "root": (prediction.root, np.float32),
        "filled": (prediction.filled, np.bool_),
        "fps": (prediction.fps, np.float32),
        "image_size": (prediction.image_size, np.int64),
    }
    arrays = {name: np.asarray(value, kind) for name, (value, kind) in found.items() if value is not None}
    for name, values in prediction.identity.items():
        if name in arrays:
            raise ValueError(f"prediction: identity '{name}' would overwrite the array of that name")
        values = np.asarray(values)
        arrays[name] = values.astype(np.str_) if values.dtype.kind == "O" else values
    return arrays
