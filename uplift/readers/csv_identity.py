"""Which frame of what each row of a table shows, and how many there are a second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.csv_columns import Columns
from uplift.readers.table import Table
from uplift.readers.table_rows import by_appearance, confidence_of, frame_numbers, rows_of
from uplift.readers.tracks import link_bodies

__all__ = ["Identity", "bodies_of", "identity_of"]

_SECONDS = {"ms": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "s": 1.0, "sec": 1.0, "seconds": 1.0}
_CLIP = ("subject", "sequence", "camera", "instance")
_UNEVEN = 0.1
"""Steps of time that differ by more than this share of the usual one make the rate unknown."""


@dataclass
class Identity:
    """What the rows show."""

    values: dict[str, np.ndarray]
    fps: float | None = None
    image_size: tuple[int, int] | None = None
    notes: list[str] = field(default_factory=list)


def identity_of(table: Table, columns: Columns) -> Identity:
    """Return what the columns beside the keypoints say of the rows.

    Raises:
        UserError: frame numbers, an image size or a rate that are none.
    """
    values = {role: table.words[place].values() for role, place in columns.identity.items()}
    found = Identity({role: text for role, text in values.items() if (text != "").any()})
    if "sequence" not in found.values and ("image" not in found.values or columns.frame is not None):
        found.values["sequence"] = np.full(len(table), table.path.stem)
    frame = None if columns.frame is None else frame_numbers(table.path, table.exact[columns.frame], table.lines)
    if frame is not None:
        found.values["frame"] = frame
    facts = {what: _one(table, place) for what, place in columns.facts.items()}
    found.fps = facts.get("fps")
    width, height = facts.get("width"), facts.get("height")
    if width and height:
        found.image_size = int(width), int(height)
    if columns.time is not None:
        _add_time(found, table.exact[columns.time], table.header[-1][columns.time])
    return found


def bodies_of(
    path: Path,
    found: Identity,
    keypoints: np.ndarray,
    scores: np.ndarray | None,
    names: Sequence[str],
    notes: Sequence[str] = (),
    lines: np.ndarray | None = None,
) -> PoseData:
    """Return (rows joints 2) keypoints of one body a row; ``lines`` of the file are for errors.

    Frames without numbers are counted, and where one frame has several bodies without names, they
    are told apart by where they are.

    Raises:
        UserError: one body twice in one frame; as `rows_of`.
    """
    confidence = confidence_of(path, keypoints, scores)
    _told_apart(path, found, keypoints, confidence, lines)
    return rows_of(
        path,
        keypoints[:, None],
        None if scores is None else scores[:, None],
        names,
        found.values,
        fps=found.fps,
        image_size=found.image_size,
        notes=(*notes, *found.notes),
    )


def _told_apart(
    path: Path, found: Identity, keypoints: np.ndarray, confidence: np.ndarray, lines: np.ndarray | None
) -> None:
    """Number the frames where they have no numbers, and the bodies where one frame has several without names."""
    values, rows = found.values, len(keypoints)
    if "frame" not in values and "sequence" in values:
        keys = [values[key] for key in _CLIP if key in values]
        values["frame"] = _counted(by_appearance(keys, rows)[0])
        found.notes.append("no frame numbers: rows are taken as neighbours in time")
    if "sequence" not in values:
        return
    if _again(values, rows) is not None and "action" in values:  # frames that count from 0 in each action
        joined = np.char.add(np.char.add(values["sequence"], " "), values["action"])
        if _again({**values, "sequence": joined}, rows) is None:
            values["sequence"] = joined
    nameless = values.get("instance", np.full(rows, "")) == ""
    again = _again(values, rows)
    if again is None:
        return
    if "instance" in values and not nameless[again]:
        where = f"{path}, line {lines[again]}" if lines is not None else f"{path}"
        raise UserError(f"{where}: '{values['instance'][again]}' is in frame {values['frame'][again]} twice.")
    _link(found, keypoints, confidence, nameless)


def _again(values: dict[str, np.ndarray], rows: int) -> int | None:
    """Return a row whose frame another row of its clip has already; None where there is none."""
    both = by_appearance([values[key] for key in (*_CLIP, "frame", "image") if key in values], rows)[0]
    if np.bincount(both).max(initial=0) <= 1:
        return None
    order = np.argsort(both, kind="stable")
    again = order[np.flatnonzero(np.diff(both[order]) == 0) + 1]
    named = again[values["instance"][again] != ""] if "instance" in values else again[:0]
    return int(named.min() if len(named) else again.min())


def _link(found: Identity, keypoints: np.ndarray, confidence: np.ndarray, nameless: np.ndarray) -> None:
    """Name the bodies that have no name by where they are from frame to frame."""
    values = found.values
    some = np.flatnonzero(nameless)
    clip = by_appearance([values[key][some] for key in _CLIP[:3] if key in values], len(some))[0]
    order = np.argsort(clip, kind="stable")
    body = np.zeros(len(nameless), np.int64)
    for part in np.split(order, np.flatnonzero(np.diff(clip[order])) + 1):
        rows = some[part]
        body[rows] = link_bodies(keypoints[rows], confidence[rows], values["frame"][rows])
    named = body.astype(np.str_)
    if not nameless.all():
        named = np.where(nameless, np.char.add("untracked ", named), values["instance"])
    values["instance"] = named
    found.notes.append("frames show several bodies without names: told apart by where they are from frame to frame")


def _counted(code: np.ndarray) -> np.ndarray:
    """Return for each row how many before it have its code."""
    order = np.argsort(code, kind="stable")
    starts = np.flatnonzero(np.diff(code[order], prepend=-1))
    count = np.arange(len(code)) - np.repeat(starts, np.diff(np.append(starts, len(code))))
    numbers = np.empty(len(code), np.int64)
    numbers[order] = count
    return numbers


def _add_time(found: Identity, time: np.ndarray, head: str) -> None:
    """Find the rate, and frame numbers where there are none, in times that go up evenly."""
    values = found.values
    keys = [values[key] for key in _CLIP if key in values]
    clip = by_appearance(keys, len(time))[0]
    order = np.lexsort((time, clip))
    step = np.diff(time[order])
    frames = np.diff(values["frame"][order]).astype(np.float64) if "frame" in values else np.ones(len(step))
    next_ = (np.diff(clip[order]) == 0) & (step > 0) & (frames > 0)
    if not next_.any():
        return
    per_frame = step[next_] / frames[next_]
    usual = float(np.median(per_frame))
    if (np.abs(per_frame - usual) > _UNEVEN * usual).mean() > 0.05:
        found.notes.append(f"the times in '{head}' go up unevenly: frames a second are not known")
        return
    unit, told = _unit(head, usual)
    # Over the whole clip, where rounding of single times no longer counts.
    rate = frames[next_].sum() / step[next_].sum() / unit
    found.fps = found.fps or float(f"{rate:.9g}")
    if not told:
        name = {1.0: "seconds", 1e-3: "milliseconds", 1e-6: "microseconds"}[unit]
        found.notes.append(f"times in '{head}' are taken as {name}: {found.fps:g} frames a second")
    if "frame" not in values and "sequence" in values:
        first = np.full(int(clip.max()) + 1, np.inf)
        np.minimum.at(first, clip, time)
        values["frame"] = np.round((time - first[clip]) / usual).astype(np.int64)


def _unit(head: str, step: float) -> tuple[float, bool]:
    """Return how many seconds a unit of the column is, and whether its name says so."""
    key = head.casefold().replace(" ", "_").replace("(", "_").rstrip(")")
    for word, seconds in _SECONDS.items():
        if key == word or key.endswith("_" + word):
            return seconds, True
    return (1.0 if step < 1 else 1e-3 if step < 1000 else 1e-6), False


def _one(table: Table, column: int) -> float | None:
    """Return the number that all rows have; None where they differ."""
    values = table.exact[column]
    if not (np.isfinite(values) & (values > 0) & (values < 1e6)).all():
        head = table.header[-1][column]
        raise UserError(f"{table.path}: '{head}' goes from {values.min():g} to {values.max():g}, expected one number.")
    return float(values[0]) if (values == values[0]).all() else None
