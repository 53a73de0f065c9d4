"""Poses as markers of one motion capture trial: TRC (OpenSim) and C3D."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uplift.config.files import replacing, replacing_by_name
from uplift.errors import UserError
from uplift.export.clips import evenly, frame_rate, one_body
from uplift.export.scene import AXES, known_points
from uplift.export.tables import labels, lines_of, unique
from uplift.models.prediction import Prediction

__all__ = ["Trial", "marker_names", "trial_of", "write_c3d", "write_trc"]

# A trial: markers of one clip, a row for every moment.

_LONGEST_BYTES = 120  # of a marker's name; C3D has room for 127


@dataclass(frozen=True)
class Trial:
    """One body: ``points`` (moments markers 3) in mm, NaN where missing; the first is frame ``start``, from 0."""

    names: tuple[str, ...]
    points: np.ndarray
    start: int
    fps: float


def trial_of(prediction: Prediction, path: str | Path, individual: str | None, kind: str) -> Trial:
    """Return the markers of one body of the only clip of ``prediction``, gaps between its frames as blank moments.

    Frames are as far apart as the largest step that divides all distances of the clip's numbers: thinned out
    films have no blanks, and ``start`` counts in those steps. ``kind`` is what the file is called in errors.

    Raises:
        UserError: poses that are not in mm, no frame rate, not exactly one clip and body, or a body twice in a frame.
    """
    if prediction.unit != "mm":
        raise UserError(
            f"{path}: {kind} holds mm, these poses are in {prediction.unit}. Give the size of the body "
            "(height_mm=1750, or bone=), or write .csv, .json or .npz: they say their unit."
        )
    rate = frame_rate(prediction, None)
    if rate is None:
        found = "is not known" if prediction.fps is None else f"is {prediction.fps}"
        raise UserError(f"{path}: {kind} needs the frame rate, which {found}. Give it: fps=30.")
    clip = one_body(prediction, path, individual)
    clip, start = evenly(clip, path)
    first, last = int(clip.moment.min()), int(clip.moment.max())
    points = clip.by_moment(known_points(prediction.points, None))[first : last + 1, 0]
    return Trial(marker_names(prediction.joint_names), points, max(start + first, 0), rate)


def marker_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return names that motion capture programs can read: no white space or control characters, not long, all different."""
    plain = (name.encode()[:_LONGEST_BYTES].decode(errors="ignore") for name in labels(names, r"\s"))
    return tuple(unique(plain))


# TRC, the marker file of OpenSim: one body, tabs, blank cells for what is missing.

_ROWS = 512


def write_trc(prediction: Prediction, path: str | Path, individual: str | None = None) -> None:
    """Write one body of one clip in mm, in the axes the prediction is in; frames count from 1, frame 1 is at 0 s.

    ``individual`` is which, of several. Joint names lose their white space. Frames that are not there are blank rows.
    Raises UserError for poses without a size in mm or a frame rate, and for more than one clip or body.
    """
    trial = trial_of(prediction, path, individual, "TRC")
    # OpenSim drops an empty cell at the end of a line, so that every line of markers ends in a tab.
    template = "\t".join(["%.0f", "%.6f", *["%.5f"] * (3 * len(trial.names))]) + "\t"
    frames = trial.start + np.arange(len(trial.points))
    with replacing(path) as handle:
        handle.write(_head(trial, Path(path).name).encode())
        for start in range(0, len(trial.points), _ROWS):
            some = slice(start, start + _ROWS)
            rows = lines_of(template, frames[some] + 1, frames[some] / trial.fps, trial.points[some])
            handle.write(("\n".join(rows) + "\n").encode())


def _head(trial: Trial, name: str) -> str:
    rate, count = f"{trial.fps:.7g}", len(trial.points)
    called = " ".join(name.encode("utf-8", "replace").decode().split())
    facts = {"DataRate": rate, "CameraRate": rate, "NumFrames": count, "NumMarkers": len(trial.names), "Units": "mm"}
    facts |= {"OrigDataRate": rate, "OrigDataStartFrame": trial.start + 1, "OrigNumFrames": count}
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{called}",
        "\t".join(facts),
        "\t".join(map(str, facts.values())),
        "Frame#\tTime\t" + "".join(f"{marker}\t\t\t" for marker in trial.names),
        "\t\t" + "".join(f"X{n}\tY{n}\tZ{n}\t" for n in range(1, len(trial.names) + 1)),
    ]
    return "\n".join([*lines, "", ""])


# C3D: one body of labelled points, no analog channels.

_MOST_FRAMES = 65_535
_SCREEN_UP = {"camera": "-Y", "opencv": "-Y", "level": "-Y", "blender": "+Z", "opensim": "+Y", "unity": "+Y"}


def write_c3d(prediction: Prediction, path: str | Path, individual: str | None = None) -> None:
    """Write one body of one clip in mm, in the axes the prediction is in; a missing point has residual -1.

    ``individual`` is which, of several. Numbers are 32-bit. ``UPLIFT:AXES`` names the axes. Frames count from 1 as in the video, or from the
    first of the clip where their numbers do not fit the format's 16 bits. Raises UserError
    for poses without a size in mm or a frame rate, more than one clip or body, or 65,536 frames.
    """
    import ezc3d

    trial = trial_of(prediction, path, individual, "C3D")
    count = len(trial.points)
    if count > _MOST_FRAMES:
        raise UserError(f"{path}: C3D holds {_MOST_FRAMES} frames, found {count}. Write .trc, or shorter clips.")
    file = ezc3d.c3d()
    _fill(file, trial, prediction.axes)
    with replacing_by_name(path) as written:
        file.write(str(written))
        # ezc3d does not report a full disk.
        if not written.is_file() or written.stat().st_size < 16 * count * len(trial.names):
            where = tempfile.gettempdir()
            raise OSError(f"{path}: the C3D could not be written completely in {where}: is the disk full?")


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
