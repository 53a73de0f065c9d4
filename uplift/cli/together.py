"""`predict together=true`: files or cameras as views of one scene, calibrated cameras in, found cameras out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from uplift.config.files import files_of, refuse_output
from uplift.data.calibration import SceneCamera, read_cameras, write_cameras
from uplift.data.formats.deeplabcut_files import keypoint_files
from uplift.data.poses import PoseData
from uplift.errors import UserError
from uplift.export.scene import rotations_to
from uplift.models.model import Model
from uplift.models.prediction import Prediction

__all__ = ["TOGETHER_KEYS", "check_together", "lift_views", "views_of", "write_found"]

TOGETHER_KEYS = ("cameras", "cameras_unit", "cameras_output")
"""Words of predict that go with together=true alone."""


def check_together(options: dict[str, Any], outputs: Sequence[str]) -> dict[str, Any]:
    """Take what is about several cameras out of ``options`` and return it; empty where nothing is solved together.

    Raises UserError: words that need together=true, or a file of cameras that cannot be written.
    """
    found = {key: options.pop(key) for key in TOGETHER_KEYS if options.get(key) is not None}
    together = options.pop("together", None) in (True, "true")
    if found and not together:
        raise UserError(f"{next(iter(found))}= is about several cameras of one scene: it needs together=true.")
    if "cameras_unit" in found and "cameras" not in found:
        raise UserError("cameras_unit= is the unit of the places in cameras=FILE, which is not given.")
    if "cameras_output" in found:
        path = Path(str(found["cameras_output"]))
        if path.suffix.lower() != ".toml" or str(path) in outputs:
            raise UserError(
                f"cameras_output={path}: cameras are written as .toml, expected a name of its own that ends so."
            )
        refuse_output(path)
    return {"together": True, **found} if together else {}


def views_of(input: str | Path, read: Callable[[str], PoseData]) -> list[PoseData]:
    """Return the views that ``input`` names, as ``read`` reads files: each file is one, or each `camera` where a file has several."""
    files = (
        [str(input)]
        if ":" in str(input) and not Path(input).exists()
        else list(map(str, keypoint_files(files_of(input))[0]))
    )
    parts = [read(one) for one in files]
    if len(parts) > 1 and all(len(_cameras(part)) < 2 for part in parts):
        return [_as_film(part) for part in parts]
    whole = parts[0] if len(parts) == 1 else read(str(input))
    cameras = _cameras(whole)
    return [whole.select(whole.identity["camera"] == one) for one in cameras] if len(cameras) > 1 else [whole]


def _cameras(data: PoseData) -> np.ndarray:
    return np.unique(data.identity["camera"]) if "camera" in data.identity else np.array([])


def _as_film(data: PoseData) -> PoseData:
    """Return a file without names of sequences as one sequence, as several files are read without together=true."""
    if "sequence" in data.identity or "image" in data.identity:
        return data
    return replace(data, identity={**data.identity, "sequence": np.full(len(data), Path(data.source).stem)})


def lift_views(
    model: Model, views: list[PoseData], given: dict[str, Any], **options: Any
) -> tuple[Prediction, list[SceneCamera]]:
    """Return the bodies that the views show, and the cameras; ``options`` are those of `Model.predict_together`."""
    cameras, note = None, ""
    if "cameras" in given:
        cameras, note = read_cameras(given["cameras"], given.get("cameras_unit"))
    prediction, found = model.predict_together(views, cameras=cameras, **options)
    notes = [*([note] if note else []), *prediction.notes]
    if len(views) == 1:
        notes.append(
            "together=true: there is one view, which is lifted by itself; give several files, or a file with several cameras"
        )
    return replace(prediction, notes=tuple(notes)), found


def write_found(prediction: Prediction, cameras: list[SceneCamera], path: str | Path) -> None:
    """Write the cameras in level axes with z up (those of ``axes=blender``), about the first camera."""
    turn = rotations_to(prediction, "blender")[0]
    turned = [replace(one, rotation=one.rotation @ turn.T) for one in cameras if one.rotation is not None]
    write_cameras(turned, path, unit=prediction.unit)
