"""Plain csv files: a row per frame (NAME_x, NAME_y, NAME_confidence), or a row per joint (frame, joint, x, y)."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from uplift.config.files import replacing
from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import is_nameless, names_for
from uplift.data.formats.rows import by_appearance, confidence_of, frame_numbers, named_tracks, rows_of, seen_by_flag
from uplift.data.parsers.files import check_memory
from uplift.data.parsers.table import Table, header_of, safe_cell
from uplift.data.poses import IDENTITY_KEYS, PoseData
from uplift.errors import UserError

__all__ = [
    "FORMAT",
    "Columns",
    "Identity",
    "bodies_of",
    "columns_in",
    "columns_of",
    "read_columns",
    "write_keypoints_csv",
    "write_table",
]

# What the header of a plain csv says: joints side by side (wide), or one row a joint (long).

_IDENTITY = {
    "subject": ("subject", "subject_id", "participant"),
    "action": ("action", "activity"),
    "sequence": ("sequence", "sequence_id", "seq", "video", "video_name", "video_id", "clip", "clip_id", "trial"),
    "camera": ("camera", "camera_id", "cam", "cam_id", "view"),
    "instance": (
        "instance", "instance_id", "individual", "individual_id", "individuals", "id", "index", "track", "track_id", "track_name",
        "person", "person_id", "person_idx", "animal", "animal_id", "body", "body_id", "pose_id", "pose_index",
    ),
    "image": ("image", "image_name", "image_path", "image_file", "img", "img_name", "file", "file_name", "filename"),
    "category": ("category", "category_name", "class", "class_name", "species"),
}  # fmt: skip
_FRAME = (
    "frame", "frames", "frame_number", "frame_no", "frame_nr", "frame_num", "frame_id", "frame_idx", "frame_index",
    "framenumber", "frameindex", "frameid", "fnum",
)  # fmt: skip
_TIME = re.compile(
    r"(time|times|timestamp|timestamps|t|seconds|sec|milliseconds)(_?(s|sec|seconds|ms|milliseconds|us))?"
)
_JOINT = (
    "joint", "joint_name", "keypoint", "keypoint_name", "bodypart", "bodyparts", "body_part", "landmark",
    "landmark_name", "node", "node_name", "marker", "marker_name", "part", "part_name", "point", "name",
    "joint_id", "joint_index", "joint_idx", "keypoint_id", "keypoint_index", "keypoint_idx",
    "landmark_id", "landmark_index", "landmark_idx", "landmark_number", "node_id",
)  # fmt: skip
_FACTS = {
    "image_width": "width", "image_height": "height", "frame_width": "width", "frame_height": "height",
    "fps": "fps", "frame_rate": "fps",
}  # fmt: skip
_SCORE = "confidence|conf|c|likelihood|score|prob|probability|p|visibility|vis|v"
_WORD = rf"(?P<what>x|y|z|{_SCORE})(?:_?(?:px|pixels?|coord|coordinate|pos))?"
_SUFFIX = re.compile(rf"(?P<name>.*\S)\s*[-_./:(\[ ]\s*{_WORD}\s*[)\]]?", re.IGNORECASE)
_PREFIX = re.compile(rf"{_WORD}\s*(?:[-_./:(\[ ]\s*(?P<name>\S.*?)|(?P<number>\d+))\s*[)\]]?", re.IGNORECASE)
_ALONE = re.compile(rf"(?P<name>)(?P<number>)(?:(?:pos|coord|px|pixel)_?)?{_WORD}", re.IGNORECASE)
_SEEN = {"_u_px": "_x", "_v_px": "_y"}
_PREDICTED = re.compile(r"_u_px$|_v_px$|(?<!_)_[xyz]$")
_BOX = ("bbox", "box", "bounding_box", "bb")


@dataclass
class _Joint:
    """The columns of one joint, or, in a long table, of whichever joint the row is of."""

    x: int
    y: int
    z: int | None = None
    score: int | None = None
    visibility: bool = False
    """The score is called visibility: COCO's numbers have that name, too."""


@dataclass
class Columns:
    """Where a csv has what."""

    joints: dict[str, _Joint]
    """Of a wide table, by name; of a long one under no name."""
    name: int | None = None
    """The column of a long table that says which joint a row is of; None: a wide table."""
    identity: dict[str, int] = field(default_factory=dict)
    frame: int | None = None
    time: int | None = None
    facts: dict[str, int] = field(default_factory=dict)
    """``width`` and ``height`` of the image, and ``fps``."""
    twice: list[str] = field(default_factory=list)
    """Names of columns that another one of the same joint has already."""
    others: tuple[str, ...] = ()
    """Names of the columns that are left out."""


def columns_of(header: Sequence[str]) -> Columns | None:
    """Return what the columns hold; None where they hold no keypoints."""
    found = Columns({})
    if any(head.endswith("_u_px") for head in header):  # predictions of uplift: beside the poses, what was seen
        header = [_PREDICTED.sub(lambda end: _SEEN.get(end[0], ""), head) for head in header]
    free: list[int] = []
    joint: dict[str, int] = {}
    for place, head in enumerate(header):
        key = re.sub(r"[\s-]+", "_", head.strip().casefold())
        role = next((role for role, words in _IDENTITY.items() if key in words), None)
        if role and role not in found.identity:
            found.identity[role] = place
        elif key in _FRAME and found.frame is None:
            found.frame = place
        elif _TIME.fullmatch(key) and found.time is None:
            found.time = place
        elif key in _FACTS:
            found.facts[_FACTS[key]] = place
        elif key in _JOINT:
            joint[key] = place
        else:
            free.append(place)
    _, alone = _joints_in(header, free, _ALONE)
    if alone and not joint and "instance" in found.identity:
        place = found.identity["instance"]  # with x and y and no name, a bare number is that of a landmark
        if header[place].strip().casefold() in ("id", "index"):
            joint = {_JOINT[0]: found.identity.pop("instance")}
    if joint and alone:
        found.name = joint[min(joint, key=_JOINT.index)]
        found.joints = alone
    else:
        free = sorted([*free, *joint.values()])
        wide = [_joints_in(header, free, pattern) for pattern in (_SUFFIX, _PREFIX)]
        found.twice, found.joints = max(wide, key=lambda one: len(one[1]))
    if not found.joints:
        return None
    if found.frame is None and header[0].strip() in ("", "Unnamed: 0"):
        found.frame = 0
    used = {place for one in found.joints.values() for place in (one.x, one.y, one.z, one.score)}
    used |= {found.name, found.frame, found.time, *found.identity.values(), *found.facts.values()}
    found.others = tuple(head for place, head in enumerate(header) if place not in used and head)
    return found


def _joints_in(
    header: Sequence[str], free: Sequence[int], pattern: re.Pattern[str]
) -> tuple[list[str], dict[str, _Joint]]:
    """Return the columns that are there twice, and the joints that have x and y, in the order of the file."""
    twice: list[str] = []
    places: dict[str, dict[str, int]] = {}
    visible = set()
    for place in free:
        match = pattern.fullmatch(header[place])
        name = (match["name"] or match["number"]) if match else None
        if match is None or name is None or name.casefold() in _BOX:
            continue
        what = match["what"].casefold()
        kind = what if what in "xyz" else "score"
        if places.setdefault(name, {}).setdefault(kind, place) != place:
            twice += [header[place]] if kind in "xyz" else []
        elif kind == "score" and what.startswith("v"):
            visible.add(name)
    return twice, {
        name: _Joint(at["x"], at["y"], at.get("z"), at.get("score"), name in visible)
        for name, at in places.items()
        if "x" in at and "y" in at
    }


# Which frame of what each row of a table shows, and how many there are a second.

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


def _identity_of(table: Table, columns: Columns) -> Identity:
    """Return what the columns beside the keypoints say of the rows.

    Raises:
        UserError: invalid frame numbers, image size or rate.
    """
    values = {role: table.words[place].values() for role, place in columns.identity.items()}
    found = Identity({role: text for role, text in values.items() if (text != "").any()}, notes=list(table.notes))
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
    are distinguished by where they are.

    Raises:
        UserError: one body twice in one frame; as `rows_of`.
    """
    confidence = confidence_of(keypoints, scores)
    _identify(path, found, keypoints, confidence, lines)
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


def _identify(
    path: Path, found: Identity, keypoints: np.ndarray, confidence: np.ndarray, lines: np.ndarray | None
) -> None:
    """Number the frames where they have no numbers, and the bodies where one frame has several without names."""
    values, rows = found.values, len(keypoints)
    if "frame" not in values and "sequence" in values:
        import pandas as pd

        keys = [values[key] for key in _CLIP if key in values]
        clip = by_appearance(keys, rows)[0]
        values["frame"] = pd.Series(clip).groupby(clip).cumcount().to_numpy()
        found.notes.append("no frame numbers: rows are taken as neighbours in time")
    if "sequence" not in values:
        return
    if _again(values, rows) is not None and "action" in values:  # frames that count from 0 in each action
        joined = np.char.add(np.char.add(values["sequence"], " "), values["action"])
        if _again({**values, "sequence": joined}, rows) is None:
            values["sequence"] = joined
    again = _again(values, rows)
    if again is None:
        return
    if "instance" in values and values["instance"][again] != "":
        where = f"{path}, line {lines[again]}" if lines is not None else f"{path}"
        raise UserError(f"{where}: '{values['instance'][again]}' is in frame {values['frame'][again]} twice.")
    video = by_appearance([values[key] for key in _CLIP[:3] if key in values], rows)[0]
    track = values.get("instance", np.full(rows, ""))
    values["instance"] = named_tracks(keypoints, confidence, video, values["frame"], track)
    found.notes.append("frames show several bodies without names: told apart by where they are from frame to frame")


def _again(values: dict[str, np.ndarray], rows: int) -> int | None:
    """Return a row whose frame another row of its clip has already; None without one."""
    _, first = by_appearance([values[key] for key in (*_CLIP, "frame", "image") if key in values], rows)
    again = np.delete(np.arange(rows), first)
    named = again[values["instance"][again] != ""] if "instance" in values else again[:0]
    return next(iter((named if len(named) else again).tolist()), None)


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
    unit, named = _unit(head, usual)
    # Over the complete clip, where rounding of single times no longer counts.
    rate = frames[next_].sum() / step[next_].sum() / unit
    found.fps = found.fps or float(f"{rate:.9g}")
    if not named:
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


# Read the keypoints: joints side by side, or one row for each joint of each frame.

_Named = Callable[[Sequence[str], np.ndarray], tuple[Sequence[str], Sequence[str]]]
"""Makes joint names of those that a file has and of its keypoints (rows joints 2), and notes that say how."""
_Rated = Callable[[np.ndarray | None, np.ndarray], np.ndarray | None]
"""Changes the scores (rows joints) of keypoints (rows joints 2) before they are taken as confidence."""


def read_columns(path: Path, columns: Columns, named: _Named, rated: _Rated | None = None) -> PoseData:
    """Read a csv of the ``columns``, wide or long; ``named`` makes joint names, and notes, of what the file has, ``rated`` scores.

    Raises:
        UserError: a column twice, or a joint twice in one frame; as `Table.read`, `_identity_of` and `bodies_of`.
    """
    if columns.twice:
        raise UserError(f"{path}: the column '{columns.twice[0]}' is there twice; joint names must differ.")
    if is_nameless(list(columns.joints)):
        joints = sorted(columns.joints.items(), key=lambda one: int(re.sub(r"\D", "", one[0])))
        columns = replace(columns, joints=dict(joints))
    names, joints = list(columns.joints), list(columns.joints.values())
    table, keypoints, scores = _numbers_of(path, columns)
    found, first = _identity_of(table, columns), np.arange(len(table))
    if columns.name is not None:
        names, place, first = _placed(table, columns.name, found)
        keypoints, scores = _filled(keypoints, place, names, first), _filled(scores, place, names, first)
    if scores is not None and all(joint.visibility for joint in joints):
        scores = seen_by_flag(scores, found.notes)
    if rated is not None:
        scores = rated(scores, keypoints)
    shown = keypoints if scores is None else np.where((scores > 0)[..., None], keypoints, np.float32(np.nan))
    names, notes = named(names, shown)
    if columns.others:
        shown = ", ".join(columns.others[:8]) + (", ..." if len(columns.others) > 8 else "")
        notes = (f"columns left out: {shown}", *notes)
    return bodies_of(path, found, keypoints, scores, names, notes, table.lines[first])


def _numbers_of(path: Path, columns: Columns) -> tuple[Table, np.ndarray, np.ndarray | None]:
    """Return the table, (rows, joints, 2) keypoints and (rows, joints) scores; a long table has one joint a row."""
    joints = list(columns.joints.values())
    scored = {at: joint.score for at, joint in enumerate(joints) if joint.score is not None}
    places = [place for joint in joints for place in (joint.x, joint.y)]
    exact = [place for place in (columns.frame, columns.time, *columns.facts.values()) if place is not None]
    words = [*columns.identity.values(), *([] if columns.name is None else [columns.name])]
    table = Table.read(path, 1, [*places, *scored.values()], exact, words)
    keypoints = np.ascontiguousarray(table.numbers[:, : len(places)]).reshape(len(table), -1, 2)
    if not scored:
        return table, keypoints, None
    scores = np.ones(keypoints.shape[:2], np.float32)  # joints without a score have confidence 1 where they are there
    scores[:, list(scored)] = table.numbers[:, len(places) :]
    return table, keypoints, scores


def _placed(table: Table, column: int, found: Identity) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return the joints that a column names, (rows,) places among all joints of all bodies, and (bodies,) first rows.

    Raises:
        UserError: a joint without a name, or twice in one frame.
    """
    keys = [found.values[key] for key in found.values if key not in ("action", "category")]
    group, first = by_appearance(keys, len(table))
    names, joint = _joints(table, column)
    what = f"a table of {len(names):,} joints in {len(first):,} frames"
    check_memory(table.path, what, 12 * len(names) * len(first), table.path.stat().st_size)
    place = group * len(names) + joint
    code, one = by_appearance([place], len(table))
    again = np.delete(np.arange(len(table)), one)
    if len(again):
        two, frame = again[0], found.values.get("frame")
        where = "" if frame is None else f" of frame {frame[two]}"
        raise UserError(
            f"{table.path}, line {table.lines[two]}: '{names[joint[two]]}'{where} is there twice (first on line "
            f"{table.lines[one[code[two]]]}). Several bodies need a column 'individual' that tells them apart, "
            "frames one 'frame'."
        )
    found.values = {key: value[first] for key, value in found.values.items()}
    return names, place, first


def _filled(values: np.ndarray | None, place: np.ndarray, names: list[str], first: np.ndarray) -> Any:
    """Return (rows, 1, ...) values of one joint each as (bodies, joints, ...), NaN where a joint is not there."""
    if values is None:
        return None
    found = np.full((len(first) * len(names), *values.shape[2:]), np.nan, np.float32)
    found[place] = values[:, 0]
    return found.reshape(len(first), len(names), *values.shape[2:])


def _joints(table: Table, column: int) -> tuple[list[str], np.ndarray]:
    """Return joint names in the file's order, numbers in their own, and (rows,) which is whose."""
    words = table.words[column]
    names = words.names
    if "" in names:
        line = table.lines[int(np.argmax(words.codes == names.index("")))]
        raise UserError(f"{table.path}, line {line}: no name of a joint.")
    if all(re.fullmatch(r"\d{1,9}", name) for name in names):
        order = np.argsort([int(name) for name in names], kind="stable")
        return [names[at] for at in order], np.argsort(order)[words.codes]
    return names, words.codes.astype(np.int64)


# Read the file as a format.


def columns_in(peek: Peek) -> Columns | None:
    """Return the columns of a file of text that begins like a csv of keypoints; None for any other."""
    if peek.is_folder or peek.json_sign or not peek.text:
        return None
    try:
        header, separator = header_of(peek.path, 1)
    except (UserError, OSError):
        return None
    return columns_of(header[0]) if separator in peek.text else None


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path, columns = peek.path, columns_in(peek)
    if peek.is_folder:
        raise UserError(f"{path} is a folder, expected a csv file.")
    if columns is None:
        shown = ", ".join(header_of(path, 1)[0][0])[:120]
        raise UserError(f"{path} has the columns {shown}; expected NAME_x and NAME_y of each joint, or joint, x and y.")
    deep = next((name for name, joint in columns.joints.items() if joint.z is not None), None)
    if deep is not None:
        what = f"'{deep}' has" if deep else "it has"
        raise UserError(
            f"{path}: {what} x, y and z: 3D points, no 2D keypoints. Give the tracker's 2D output; for landmarks of "
            "MediaPipe, whose z is left out, say format=mediapipe."
        )

    def named(names: Sequence[str], points: np.ndarray) -> tuple[Sequence[str], Sequence[str]]:
        return names_for(path, len(names), {}, options, points) if is_nameless(names) else (names, ())

    return read_columns(path, columns, named)


FORMAT = FileFormat("csv", "plain csv", lambda peek: columns_in(peek) is not None, _read)


# Write the 2D of a `PoseData` as a plain csv: one row a frame and individual, NAME_x, NAME_y, NAME_confidence.

_BLOCK = 4096
"""Rows whose text is made at once."""


def write_keypoints_csv(data: PoseData, path: str | Path, *, csv_safe: bool = False) -> None:
    """Write keypoints, confidence, identity, times and image size; format=csv reads them back the same.

    NaN is an empty cell. What came from 3D is not written. ``csv_safe`` is as in `write_table`.

    Raises:
        UserError: joint names that a header of a csv cannot hold.
    """
    header = [f"{joint}_{what}" for joint in data.joint_names for what in ("x", "y", "confidence")]
    found = columns_of(header)
    if found is None or tuple(found.joints) != data.joint_names or found.twice or is_nameless(data.joint_names):
        read = () if found is None else found.joints
        wrong = next((name for name in data.joint_names if name not in read), data.joint_names[0])
        raise UserError(
            f"cannot write {path}: the joint name '{wrong}' cannot be distinguished from a column's. Write .npz."
        )
    beside = _beside(data)
    numbers = np.concatenate([data.keypoints, data.confidence[..., None]], -1).reshape(len(data), len(header))
    write_table(path, [[*beside, *header]], [column.tolist() for column in beside.values()], numbers, csv_safe)


def write_table(
    path: str | Path,
    header: Sequence[Sequence[str]],
    columns: Sequence[Sequence[object]],
    numbers: np.ndarray,
    csv_safe: bool = False,
) -> None:
    """Write rows of ``columns`` and (rows, cells) ``numbers``: float32 in the shortest text that is read back the same.

    NaN is an empty cell. With ``csv_safe`` names that a spreadsheet would run as a formula begin with an apostrophe.
    """
    if csv_safe:
        header = [[safe_cell(cell) for cell in cells] for cells in header]
        columns = [[safe_cell(cell) if isinstance(cell, str) else cell for cell in cells] for cells in columns]
    numbers = numbers.astype(np.float32, copy=False)
    with replacing(path) as handle:
        text = io.TextIOWrapper(handle, encoding="utf-8", newline="")
        lines = csv.writer(text, lineterminator="\n")
        lines.writerows(header)
        for at in range(0, len(numbers), _BLOCK):
            rows = slice(at, at + _BLOCK)
            cells = np.where(np.isnan(numbers[rows]), "", numbers[rows].astype(np.str_)).tolist()
            beside = zip(*(column[rows] for column in columns), strict=True) if columns else [()] * len(cells)
            lines.writerows([*first, *row] for first, row in zip(beside, cells, strict=True))
        text.flush()
        text.detach()


def _beside(data: PoseData) -> dict[str, np.ndarray]:
    """Return the columns that are not keypoints."""
    keys = [key for key in ("frame", *IDENTITY_KEYS) if key in data.identity]
    columns = {key: data.identity[key] for key in dict.fromkeys(keys)}
    if data.fps is not None and "frame" in columns:
        columns["time_s"] = columns["frame"] / data.fps
    if data.image_size is not None:
        width, height = data.image_size
        columns["image_width"] = np.full(len(data), width)
        columns["image_height"] = np.full(len(data), height)
    return columns
