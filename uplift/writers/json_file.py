"""Predictions as JSON that says what it holds: one object, one line per frame and individual."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from uplift.axes import AXES
from uplift.prediction import Prediction
from uplift.saving import replacing
from uplift.writers.plain import NUMBER, filled_in, numbers, parts, plain, seen_keypoints

__all__ = ["write_json"]

_FORMAT = "uplift poses"
_VERSION = 1
_MEANING = {
    "identity": "which frame, and of whom",
    "pose": "joints x [x, y, z], relative to the root joint, in unit and axes",
    "root": "[x, y, z] of the root joint, from the camera, in unit and axes",
    "keypoints": "joints x [u, v] as seen, px, u right, v down",
    "confidence": "joints, 0 to 1; 0 is not seen",
    "spread": "joints, the error to expect of the depth, of a filled joint of its whole place, in unit",
    "filled": "joints, true where the joint was not seen",
    "tilt_deg": "how far the camera looks down, degrees",
}


def write_json(prediction: Prediction, path: str | Path) -> None:
    """Write names, bones, unit and axes, then every frame; what is missing is null.

    Places are rounded to seven significant digits. Long films are written part by part: their text is
    never in memory as a whole.
    """
    with replacing(path) as handle:
        lines = (
            f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)},\n" for key, value in _head(prediction).items()
        )
        handle.write(("{\n" + "".join(lines) + ' "frames": [').encode())
        before = "\n  "
        for part in parts(prediction):
            handle.write((before + ",\n  ".join(_frames(part))).encode())
            before = ",\n  "
        handle.write(b"\n ]\n}\n")


def _head(prediction: Prediction) -> dict[str, Any]:
    fps = prediction.fps
    unknown = [name for name in _MEANING if getattr(prediction, name) is None]
    return {
        "format": _FORMAT,
        "version": _VERSION,
        "skeleton": prediction.skeleton.name,
        "joint_names": list(prediction.joint_names),
        "root_joint": prediction.skeleton.root,
        "bones": [list(bone) for bone in prediction.skeleton.bones],
        "unit": prediction.unit,
        "axes": prediction.axes,
        "axes_meaning": AXES.get(prediction.axes),
        "fps": float(f"{fps:.7g}") if fps is not None and math.isfinite(fps) else None,
        "image_size": None if prediction.image_size is None else [int(side) for side in prediction.image_size],
        "fields": {name: told for name, told in _MEANING.items() if name not in unknown},
    }


def _blocks(prediction: Prediction) -> dict[str, tuple[np.ndarray, str]]:
    """Return the numbers that each frame holds, with how they are written."""
    optional: dict[str, tuple[np.ndarray | None, str]] = {
        "pose": (prediction.pose, NUMBER["place"]),
        "root": (prediction.root, NUMBER["place"]),
        "keypoints": (seen_keypoints(prediction), NUMBER["px"]),
        "confidence": (prediction.confidence, NUMBER["share"]),
        "spread": (prediction.spread, NUMBER["px"]),
        "tilt_deg": (prediction.tilt_deg, NUMBER["px"]),
    }
    return {name: (values, style) for name, (values, style) in optional.items() if values is not None}


def _frames(prediction: Prediction) -> Iterator[str]:
    """Yield each frame as one line of JSON."""
    blocks = _blocks(prediction)
    template = "".join(f', "{name}": {_shaped(values.shape[1:], style)}' for name, (values, style) in blocks.items())
    keys = [json.dumps(key) for key in prediction.identity]
    columns = [plain(values) for values in prediction.identity.values()]
    labels = zip(*columns, strict=True) if columns else ((),) * len(prediction)
    rows = numbers(*(values for values, _ in blocks.values()))
    for index, (label, row) in enumerate(zip(labels, rows, strict=True)):
        known = ", ".join(f"{key}: {json.dumps(value)}" for key, value in zip(keys, label, strict=True))
        line = f'{{"identity": {{{known}}}{filled_in(template, row, "null")}'
        if prediction.filled is not None:
            line += (
                f', "filled": {json.dumps(np.asarray(prediction.filled[index], bool).tolist(), separators=(",", ":"))}'
            )
        yield line + "}"


def _shaped(shape: tuple[int, ...], style: str) -> str:
    """Return the text of nested lists of this shape with ``style`` in the place of every number."""
    return style if not shape else "[" + ",".join([_shaped(shape[1:], style)] * shape[0]) + "]"
