"""Predictions as a table, CSV: one row per frame and individual, for spreadsheets, R and pandas."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import numpy as np

from uplift.prediction import Prediction
from uplift.saving import replacing
from uplift.writers.plain import NUMBER, filled_in, plain, row_numbers, seen_keypoints

__all__ = ["write_csv"]


def write_csv(prediction: Prediction, path: str | Path) -> None:
    """Write identity, unit and axes, then of every joint its place, keypoint and confidence; UTF-8, commas.

    ``NAME_x``, ``NAME_y``, ``NAME_z`` are in the row's ``unit`` and ``axes``, from its ``origin``: the
    ``camera`` where the root has a known place, else the ``root`` joint. ``NAME_u_px`` and ``NAME_v_px``
    are the keypoint as it was seen; ``NAME_spread`` and ``NAME_filled`` (0 or 1) are there where they are
    known. What is missing is an empty cell. Raises ValueError where two columns would have one name.
    """
    facts = {
        "unit": prediction.unit,
        "axes": prediction.axes,
        "origin": "root" if prediction.root is None else "camera",
    }
    if prediction.fps is not None:
        facts["fps"] = "%.7g" % prediction.fps
    numbers, columns = _columns(prediction)
    names = [*prediction.identity, *facts, *columns]
    twice = {name for name in names if names.count(name) > 1} if len(set(names)) < len(names) else set()
    if twice:
        raise ValueError(f"prediction: several columns would be called {', '.join(sorted(twice))}")
    template = ",".join(columns.values()) + "\n"
    known = ",".join(map(_cell, facts.values())) + ","
    keys = [[_cell(value) for value in plain(values)] for values in prediction.identity.values()]
    labels = zip(*keys, strict=True) if keys else ((),) * len(prediction)
    with replacing(path) as handle:
        handle.write(_bytes(",".join(map(_cell, names)) + "\n"))
        for label, row in zip(labels, row_numbers(*numbers), strict=True):
            handle.write(_bytes(",".join((*label, known)) + filled_in(template, row, "")))


def _columns(prediction: Prediction) -> tuple[list[np.ndarray], dict[str, str]]:
    """Return the arrays of numbers and, by the name of each column, how its numbers are written."""
    per_joint: dict[str, tuple[np.ndarray | None, str]] = {}
    for place, axis in enumerate("xyz"):
        per_joint[axis] = prediction.points[..., place], NUMBER["place"]
    for place, axis in enumerate(("u_px", "v_px")):
        per_joint[axis] = seen_keypoints(prediction)[..., place], NUMBER["px"]
    per_joint["confidence"] = prediction.confidence, NUMBER["share"]
    per_joint["spread"] = prediction.spread, NUMBER["px"]
    per_joint["filled"] = prediction.filled, "%d"
    known = {key: (values, style) for key, (values, style) in per_joint.items() if values is not None}
    table = np.stack([np.asarray(values, np.float64) for values, _ in known.values()], -1)
    named = ([(f"{name}_{key}", style) for key, (_, style) in known.items()] for name in prediction.joint_names)
    names = list(chain.from_iterable(named))
    if prediction.tilt_deg is None:
        return [table], _unlike(names)
    return [prediction.tilt_deg, table], _unlike([("tilt_deg", NUMBER["px"]), *names])


def _cell(value: object) -> str:
    """Return a value as the text of one cell, in quotes where it would not be one cell without."""
    text = "" if value is None else str(value)
    if text.strip() != text or any(sign in text for sign in ',"\r\n'):
        return '"' + text.replace('"', '""') + '"'
    return text


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "backslashreplace")
