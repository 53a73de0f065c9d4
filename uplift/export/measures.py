"""What is measured of moving bodies, as tables: joint angles (CSV, OpenSim's MOT) and gait (CSV)."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import chain, repeat
from pathlib import Path

import numpy as np

from uplift.biomechanics.angles import angles_of, joint_angles, no_angles
from uplift.biomechanics.gait import MEASURES, Gait, feet_of, gait_of, mean_of
from uplift.config.files import as_bytes, replacing
from uplift.errors import UserError, listed
from uplift.export.clips import Clip, arrange, clip_names, frame_rate, one_body, steps
from uplift.export.markers import marker_names
from uplift.export.stream import Stream
from uplift.export.tables import cell, lines_of, plain
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton

__all__ = ["AnglesStream", "GaitStream", "check_skeleton", "write_angles_csv", "write_gait_csv", "write_mot"]

_DEGREES = "%.6g"
_ROWS = 2048


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


def _known_seconds(prediction: Prediction, path: str | Path, kind: str) -> np.ndarray:
    time = seconds(prediction)
    if time is None:
        found = "is not known" if prediction.fps is None or math.isnan(prediction.fps) else f"is {prediction.fps}"
        raise UserError(f"{path}: {kind} needs the frame rate, which {found}. Give it: fps=30.")
    return time


def check_skeleton(skeleton: Skeleton, path: str | Path) -> None:
    """Raise UserError where a skeleton cannot have what ``path`` is to hold: angles, or gait."""
    if Path(path).suffix.lower() == ".csv" and Path(path).stem.lower().endswith("gait"):
        feet_of(skeleton)
    elif not angles_of(skeleton):
        raise no_angles(skeleton)


# Joint angles.


class AnglesStream(Stream):
    """The table of `write_angles_csv`, part by part."""

    of_clips = True

    def __init__(self, path: str | Path, axes: str | None = None, *, csv_safe: bool = False):
        super().__init__(path, axes)
        self._written = partial(cell, safe=csv_safe)
        self._measured: dict[str, bool] = {}

    def write_part(self, prediction: Prediction, first: bool) -> None:
        names, time = tuple(angles_of(prediction.skeleton)), seconds(prediction)
        kinds = ["_deg"] if prediction.uncertainty is None else ["_deg", "_uncertainty_deg"]
        columns = [f"{name}{kind}" for kind in kinds for name in names]
        if first:
            self._measured = dict.fromkeys(names, False)
            head = [*prediction.identity, *([] if time is None else ["time_s"]), *columns]
            self._handle.write(as_bytes(",".join(map(self._written, head)) + "\n"))
        template = ",".join([_DEGREES] * len(columns))
        for start in range(0, len(prediction), _ROWS):
            some = slice(start, start + _ROWS)
            self._write_rows(prediction.select(some), None if time is None else time[some], template)

    def _write_rows(self, part: Prediction, time: np.ndarray | None, template: str) -> None:
        found = joint_angles(part)
        for name, known in zip(found.names, np.asarray(np.isfinite(found.values).any(0)).tolist(), strict=True):
            self._measured[name] |= known
        arrays = [found.values] + ([] if found.uncertainty is None else [found.uncertainty])
        keys = [[f"{self._written(value)}," for value in plain(values)] for values in part.identity.values()]
        keys += [] if time is None else [[f"{at:.7g}," for at in time.tolist()]]
        rows = zip(*keys, lines_of(template, *arrays), repeat("\n"), strict=False)
        self._handle.write(as_bytes("".join(chain.from_iterable(rows))))

    def finish(self) -> str:
        never = [name for name, known in self._measured.items() if not known]
        blank = f"; {listed(never, 4)} cannot be measured in any frame" if never else ""
        return f"{len(self._measured)} joint angles, degrees{blank}"


def write_angles_csv(prediction: Prediction, path: str | Path, *, csv_safe: bool = False) -> str:
    """Write a row for each frame and body: identity, time_s, every angle, then the error to expect of each; UTF-8, commas.

    ``NAME_deg`` are the angles of `uplift.biomechanics.angles.joint_angles`, ``NAME_uncertainty_deg`` are there where
    uncertainty is known. What cannot be measured is an empty cell. Raises UserError for a skeleton without angles.
    """
    with AnglesStream(path, csv_safe=csv_safe) as stream:
        stream.append(prediction)
    return stream.remark


def write_mot(prediction: Prediction, path: str | Path, individual: str | None = None) -> str:
    """Write the joint angles of one body of one clip as a motion file of OpenSim: a row for each frame, time and degrees.

    The columns have the names of the skeleton's angles, not those of a model's coordinates: OpenSim reads it as a table
    of motion. It stops at a number that is not there: frames that are not lifted have no row, and angles that other
    frames lack have no column. Raises UserError without a frame rate, and for more than one clip or body.
    """
    time = _known_seconds(prediction, path, "MOT")
    clip = one_body(prediction, path, individual)
    rows = clip.rows[np.argsort(time[clip.rows], kind="stable")]
    if (np.diff(time[rows]) <= 0).any():
        raise UserError(
            f"{path}: a body is in one frame twice. Name what tells its rows apart ('instance' or 'sequence')."
        )
    bare, names = (
        replace(prediction, uncertainty=None),
        list(angles_of(prediction.skeleton)),
    )  # which it has no place for
    parts = [rows[start : start + _ROWS] for start in range(0, len(rows), _ROWS)]
    values = np.concatenate([joint_angles(bare.select(part)).values for part in parts])
    there = np.isfinite(values).any(1)
    values, when = values[there], time[rows][there]
    whole = np.asarray(np.isfinite(values).all(0))
    named = [name for name, known in zip(names, whole, strict=True) if known]
    head = [
        Path(path).stem,
        "version=1",
        f"nRows={len(when)}",
        f"nColumns={len(named) + 1}",
        "inDegrees=yes",
        "endheader",
    ]
    columns = "\t".join(["time", *marker_names(named)])
    template = "\t".join(["%.6f", *[_DEGREES] * len(named)])
    with replacing(path) as handle:
        handle.write(("\n".join([*head, columns]) + "\n").encode())
        for start in range(0, len(when), _ROWS):
            rows = lines_of(template, when[start : start + _ROWS], values[start : start + _ROWS, whole])
            handle.write(("\n".join(rows) + "\n").encode())
    lacking = [name for name in names if name not in named]
    return f"{len(named)} joint angles, degrees" + (
        f"; without {listed(lacking, 4)}, which some frames lack" if lacking else ""
    )


# Gait.

_EVENTS = ("strike_s", "toe_off_s", "end_s")
_OF_LENGTH = {"step_length": "step_length_mm", "stride_length": "stride_length_mm", "speed_per_s": "speed_m_per_s"}


class GaitStream(Stream):
    """The table of `write_gait_csv`, part by part: what clips are called is known at the end, when all are there."""

    of_clips = True

    def __init__(self, path: str | Path, axes: str | None = None, *, csv_safe: bool = False):
        super().__init__(path, axes)
        self._written = partial(cell, safe=csv_safe)
        self._head, self._metric, self._walkers, self._reasons = "", False, 0, []
        self._clips: list[tuple[dict[str, Any], str]] = []
        """The identity of each clip's first row, and the lines of its bodies."""

    def write_part(self, prediction: Prediction, first: bool) -> None:
        time = _known_seconds(prediction, self.path, "gait")
        feet_of(prediction.skeleton)
        self._metric = prediction.unit == "mm"
        measures = [name for name in MEASURES if self._metric or name not in _OF_LENGTH]
        columns = [*_EVENTS, *(_OF_LENGTH.get(name, name) for name in measures)]
        self._head = ",".join(["clip", "individual", "foot", "stride", *columns])
        for clip in arrange(prediction.identity, len(prediction)):
            lines = []
            for who in clip.individual_names:
                gait = _gait_of_body(prediction, clip.only(who), time)
                self._walkers += bool(gait.strides)
                self._reasons += [gait.why_not] if gait.why_not else []
                lines += [",".join(map(self._written, [who, *row])) for row in _gait_rows(gait, measures)]
            of = {key: values[[clip.rows.min()]] for key, values in prediction.identity.items()}
            self._clips.append((of, "\n".join(lines)))

    def finish(self) -> str:
        self._handle.write(as_bytes(f"{self._head}\n"))
        names = clip_names([of for of, _ in self._clips])
        for name, (_, lines) in zip(names, self._clips, strict=True):
            start = f"{self._written(name)},"
            self._handle.write(as_bytes("".join(f"{start}{line}\n" for line in lines.split("\n") if line)))
        return _gait_remark(self._walkers, self._reasons, self._metric)


def write_gait_csv(prediction: Prediction, path: str | Path, *, csv_safe: bool = False) -> str:
    """Write a row for each stride of each foot, then mean and sd of each foot and of ``all``, and the asymmetry of pairs.

    Columns are clip, individual, foot, stride (a number, ``mean``, ``sd`` or ``asymmetry_percent``), the times of the
    foot's strike, its toe-off and its next strike, and the measures of `uplift.biomechanics.gait`; lengths and speed are
    there for poses in mm alone. A file without walking has a header and no rows. Raises UserError without a frame rate,
    and for a skeleton without contacts, gravity or facing.
    """
    with GaitStream(path, csv_safe=csv_safe) as stream:
        stream.append(prediction)
    return stream.remark


def _gait_remark(walkers: int, reasons: list[str], metric: bool) -> str:
    if not walkers:
        return f"no rows: {max(reasons, key=reasons.count)}" if reasons else "no rows: no body"
    others = f"; {len(reasons)} others: {max(reasons, key=reasons.count)}" if reasons else ""
    scale = "" if metric else "; for lengths and speed give a size in millimetres (docs/output.md)"
    return f"gait of {walkers} bodies{others}{scale}" if walkers > 1 else f"gait of a body{others}{scale}"


def _gait_of_body(prediction: Prediction, clip: Clip, time: np.ndarray) -> Gait:
    rows = clip.rows[np.argsort(time[clip.rows], kind="stable")]
    rows = rows[np.append(True, np.diff(time[rows]) > 0)]
    contact = prediction.contact
    return gait_of(
        prediction.level_pose[rows], time[rows], prediction.skeleton, None if contact is None else contact[rows]
    )


def _gait_rows(gait: Gait, measures: list[str]) -> list[list[str]]:
    """Return foot, stride, events and measures of every row, as text."""

    def numbers_of(values: dict[str, float]) -> list[str]:
        scaled = {**values, "speed_per_s": values.get("speed_per_s", math.nan) / 1000}
        return [f"{scaled[name]:.5g}" if math.isfinite(scaled.get(name, math.nan)) else "" for name in measures]

    rows = [
        [
            one.foot,
            str(one.number),
            *(f"{at:.4f}" for at in (one.strike_s, one.toe_off_s, one.end_s)),
            *numbers_of(one.measures),
        ]
        for one in gait.strides
    ]
    for foot in [*gait.feet, "all"] if gait.strides else []:
        mine = [one.measures for one in gait.strides if foot in (one.foot, "all")]
        columns = {name: np.array([one[name] for one in mine]) for name in measures}
        spread = {name: _deviation(values) for name, values in columns.items()}
        for label, found in (("mean", {name: mean_of(values) for name, values in columns.items()}), ("sd", spread)):
            rows.append([foot, label, "", "", "", *numbers_of(found)])
    for pair, found in gait.asymmetry.items():
        rows.append([pair, "asymmetry_percent", "", "", "", *numbers_of(found)])
    return rows


def _deviation(values: np.ndarray) -> float:
    """Return the standard deviation of a sample; NaN for fewer than two values."""
    known = values[np.isfinite(values)]
    return float(known.std(ddof=1)) if len(known) > 1 else math.nan
