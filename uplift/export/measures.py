"""What is measured of moving bodies, as tables: joint angles (CSV, OpenSim's MOT) and gait (CSV)."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np

from uplift.biomechanics.angles import Angles, joint_angles
from uplift.config.files import as_bytes, replacing
from uplift.errors import UserError
from uplift.export.clips import arrange, frame_rate, one_body, steps
from uplift.export.markers import marker_names
from uplift.export.tables import cell, filled_in, numbers, plain
from uplift.models.prediction import Prediction

__all__ = ["write_angles_csv", "write_mot"]

_DEGREES = "%.6g"


def seconds(prediction: Prediction) -> np.ndarray | None:
    """Return the time of every row, where the frame rate is known; frame 0 of a video is at 0 s, as in .trc."""
    rate = frame_rate(prediction, None)
    if rate is None:
        return None
    found = np.zeros(len(prediction))
    for clip in arrange(prediction.identity, len(prediction)):
        since, span = steps(clip), clip.frames[-1] - clip.frames[0]
        apart = span / since[-1] if span > 0 else 1.0  # numbers from one frame to the next
        found[clip.rows] = (clip.frames[0] / apart + since)[clip.moment] / rate
    return found


def write_angles_csv(prediction: Prediction, path: str | Path, *, csv_safe: bool = False) -> str:
    """Write a row for each frame and body: identity, time_s, every angle, then the error to expect of each; UTF-8, commas.

    ``NAME_deg`` are the angles of `uplift.biomechanics.angles.joint_angles`, ``NAME_uncertainty_deg`` are there where
    uncertainty is known. What cannot be measured is an empty cell. Raises UserError for a skeleton without angles.
    """
    found, time = joint_angles(prediction), seconds(prediction)
    arrays = [found.values] + ([] if found.uncertainty is None else [found.uncertainty])
    head = [f"{name}_deg" for name in found.names]
    head += [f"{name}_uncertainty_deg" for name in found.names] if found.uncertainty is not None else []
    known = {} if time is None else {"time_s": np.char.mod("%.7g", time)}
    written = partial(cell, safe=csv_safe)
    labels = [[written(value) for value in plain(values)] for values in (*prediction.identity.values(), *known.values())]
    template = ",".join([_DEGREES] * len(head)) + "\n"
    with replacing(path) as handle:
        handle.write(as_bytes(",".join(map(written, [*prediction.identity, *known, *head])) + "\n"))
        for *label, row in zip(*labels, numbers(*arrays), strict=True):
            handle.write(as_bytes("".join(f"{text}," for text in label) + filled_in(template, row, "")))
    return f"{len(found.names)} joint angles, degrees{_blank(found)}"


def _blank(found: Angles) -> str:
    """Return a remark on angles that no frame has."""
    never = [name for name, values in zip(found.names, found.values.T, strict=True) if np.isnan(values).all()]
    return f"; {', '.join(never[:4])}{', ...' if len(never) > 4 else ''} cannot be measured in any frame" if never else ""


def write_mot(prediction: Prediction, path: str | Path, individual: str | None = None) -> str:
    """Write the joint angles of one body of one clip as a motion file of OpenSim: a row for each frame, time and degrees.

    The columns have the names of the skeleton's angles, not those of a model's coordinates: OpenSim reads it as a table
    of motion. Frames that are not there have no row; what cannot be measured is NaN. Raises UserError without a frame
    rate, and for more than one clip or body.
    """
    time = seconds(prediction)
    if time is None:
        rate = prediction.fps
        found = "is not known" if rate is None or math.isnan(rate) else f"is {rate}"
        raise UserError(f"{path}: MOT needs the frame rate, which {found}. Give it: fps=30.")
    clip = one_body(prediction, path, individual)
    rows = clip.rows[np.argsort(time[clip.rows], kind="stable")]
    when = time[rows]
    if (np.diff(when) <= 0).any():
        raise UserError(f"{path}: a body is in one frame twice. Name what tells its rows apart ('instance' or 'sequence').")
    found = joint_angles(prediction.select(rows))
    head = [Path(path).stem, "version=1", f"nRows={len(rows)}", f"nColumns={len(found.names) + 1}", "inDegrees=yes", "endheader"]
    names = "\t".join(["time", *marker_names(found.names)])
    template = "\t".join(["%.6f", *[_DEGREES] * len(found.names)]) + "\n"
    with replacing(path) as handle:
        handle.write(("\n".join([*head, names]) + "\n").encode())
        for row in numbers(when, found.values):
            handle.write(filled_in(template, row, "NaN").encode())
    return f"{len(found.names)} joint angles, degrees{_blank(found)}"
