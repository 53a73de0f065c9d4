"""Predictions as a table, CSV: one row per frame and individual, for spreadsheets, R and pandas."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from uplift.prediction import Prediction
from uplift.saving import replacing
from uplift.writers.plain import NUMBER, filled_in, numbers, parts, plain, seen_keypoints

__all__ = ["write_csv"]


def write_csv(prediction: Prediction, path: str | Path) -> None:
    """Write identity, unit and axes, then of every joint its place, keypoint and confidence; UTF-8, commas.

    ``NAME_x``, ``NAME_y``, ``NAME_z`` are in the row's ``unit`` and ``axes``, from its ``origin``: the
    ``camera`` where the root has a known place, else the ``root`` joint. ``NAME_u_px`` and ``NAME_v_px``
    are the keypoint as it was seen; ``NAME_spread`` and ``NAME_filled`` (0 or 1) are there where they are
    known. What is missing is an empty cell. Raises ValueError where two columns would have one name.
    """
    facts = _facts(prediction)
    columns = _columns(prediction)
    names = [*prediction.identity, *facts, *(name for name, _ in columns)]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise ValueError(f"prediction: several columns would be called {', '.join(twice)}")
    template = ",".join(style for _, style in columns) + "\n"
    known = ",".join(map(_cell, facts.values())) + ","
    with replacing(path) as handle:
        handle.write(_bytes(",".join(map(_cell, names)) + "\n"))
        for part in parts(prediction):
            keys = [[_cell(value) for value in plain(values)] for values in part.identity.values()]
            labels = zip(*keys, strict=True) if keys else ((),) * len(part)
            for label, row in zip(labels, numbers(*_arrays(part)), strict=True):
                handle.write(_bytes(",".join((*label, known)) + filled_in(template, row, "")))


def _facts(prediction: Prediction) -> dict[str, str]:
    """Return what is the same in every row."""
    origin = "root" if prediction.root is None else "camera"
    facts = {"unit": prediction.unit, "axes": prediction.axes, "origin": origin}
    known = prediction.fps is not None and math.isfinite(prediction.fps)
    return {**facts, "fps": f"{prediction.fps:.7g}"} if known else facts


def _columns(prediction: Prediction) -> list[tuple[str, str]]:
    """Return the name of each column of numbers and how its numbers are written, in the order of `_arrays`."""
    place, px, share = NUMBER["place"], NUMBER["px"], NUMBER["share"]
    joint = {"x": place, "y": place, "z": place, "u_px": px, "v_px": px, "confidence": share}
    if prediction.spread is not None:
        joint["spread"] = px
    if prediction.filled is not None:
        joint["filled"] = "%d"
    columns = [(f"{name}_{key}", style) for name in prediction.joint_names for key, style in joint.items()]
    return columns if prediction.tilt_deg is None else [("tilt_deg", px), *columns]


def _arrays(prediction: Prediction) -> list[np.ndarray]:
    """Return the numbers of each frame (frames ...)."""
    optional = [values[..., None] for values in (prediction.spread, prediction.filled) if values is not None]
    of_joints = [prediction.points, seen_keypoints(prediction), prediction.confidence[..., None], *optional]
    table = np.concatenate(of_joints, -1)
    return [table] if prediction.tilt_deg is None else [prediction.tilt_deg, table]


def _cell(value: object) -> str:
    """Return a value as the text of one cell, in quotes where it would not be one cell without."""
    text = "" if value is None else str(value)
    if text.strip() != text or any(sign in text for sign in ',"\r\n'):
        return '"' + text.replace('"', '""') + '"'
    return text


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "backslashreplace")
