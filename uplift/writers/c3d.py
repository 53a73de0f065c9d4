"""Predictions as a C3D, the file of motion capture: one clip of labelled points, no analog channels."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np

from uplift.axes import AXES
from uplift.errors import UserError
from uplift.prediction import Prediction
from uplift.saving import replacing
from uplift.writers.markers import Trial, trial_of

__all__ = ["write_c3d"]

_MOST_FRAMES = 65_535
_SCREEN_UP = {"camera": "-Y", "opencv": "-Y", "level": "-Y", "blender": "+Z", "opensim": "+Y"}


def write_c3d(prediction: Prediction, path: str | Path) -> None:
    """Write one clip in mm, in the axes the prediction is in; a missing point has residual -1.

    Numbers are 32-bit. ``UPLIFT:AXES`` names the axes. Frames count from 1 as in the video, or from the
    first of the clip where their numbers do not fit the format's 16 bits. Raises UserError without
    ezc3d, for poses without a size in mm or a frame rate, more than one clip, or 65,536 frames.
    """
    try:
        import ezc3d
    except ImportError as error:
        raise UserError(f'{path}: writing C3D needs ezc3d: pip install "uplift3d[c3d]".') from error
    trial = trial_of(prediction, path, "C3D")
    if len(trial.points) > _MOST_FRAMES:
        raise UserError(
            f"{path}: C3D holds {_MOST_FRAMES} frames, found {len(trial.points)}. Write .trc, or shorter clips."
        )
    file = ezc3d.c3d()
    _fill(file, trial, prediction.axes)
    with replacing(path) as handle, tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "trial.c3d"
        file.write(str(written))
        least = 16 * trial.points.shape[0] * trial.points.shape[1]
        if not written.is_file() or written.stat().st_size < least:  # ezc3d says nothing of a full disk
            raise OSError(f"{path}: the C3D could not be written whole in {tempfile.gettempdir()}: is the disk full?")
        with written.open("rb") as whole:
            shutil.copyfileobj(whole, handle)


def _fill(file, trial: Trial, axes: str) -> None:
    """Put a trial into an empty ``ezc3d.c3d``."""
    point = file["parameters"]["POINT"]
    point["RATE"]["value"] = [trial.fps]
    point["LABELS"]["value"] = list(trial.names)
    point["UNITS"]["value"] = ["mm"]
    if axes in _SCREEN_UP:
        file.add_parameter("POINT", "X_SCREEN", "+X", "Axis to the right")
        file.add_parameter("POINT", "Y_SCREEN", _SCREEN_UP[axes], "Axis upwards")
    file.add_parameter("UPLIFT", "AXES", axes, AXES.get(axes, ""))
    missing = np.asarray(np.isnan(trial.points).any(-1))
    points = np.ones((4, *missing.T.shape))
    points[:3] = trial.points.transpose(2, 1, 0)
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = np.where(missing, -1.0, 0.0).T[None]
    last = trial.start + len(missing)
    file["header"]["points"]["first_frame"] = trial.start if last <= _MOST_FRAMES else 0
