"""The 2D files of VideoPose3D: keypoints of videos (data_2d_custom_*.npz) or of a data set (data_2d_h36m_*), and its detector's."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.csv import Identity, bodies_of
from uplift.data.formats.layouts import COCO_JOINTS, H36M_JOINTS, HOURGLASS_JOINTS, Layouts, names_for
from uplift.data.formats.rows import confidence_of
from uplift.data.parsers.pickles import load_object_npz
from uplift.data.poses import PoseData
from uplift.errors import UserError, listed

__all__ = ["FORMAT"]

_LEFT = {
    (1, 3, 5, 7, 9, 11, 13, 15): ("COCO", COCO_JOINTS),
    (4, 5, 6, 11, 12, 13): ("Human3.6M", H36M_JOINTS),
    (3, 4, 5, 13, 14, 15): ("the stacked hourglass", HOURGLASS_JOINTS),
}
"""The joints that metadata calls the left ones -> layout."""
_LAYOUTS: Layouts = {17: _LEFT[1, 3, 5, 7, 9, 11, 13, 15], 16: _LEFT[3, 4, 5, 13, 14, 15]}


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    arrays = load_object_npz(path, ["positions_2d", "metadata", "boxes", "keypoints"])
    metadata = arrays["metadata"] if isinstance(arrays.get("metadata"), dict) else {}
    if "positions_2d" in arrays:
        clips = _custom(path, arrays["positions_2d"])
        sizes = metadata.get("video_metadata", {})
    elif "keypoints" in arrays:
        clips = _detected(path, arrays["keypoints"])
        sizes = {path.stem: metadata}
    else:
        raise UserError(
            f"{path}: no 'positions_2d' in it, as VideoPose3D's data_2d_custom_*.npz have, and no 'keypoints', as its "
            f"detector's files have (found: {listed(sorted(arrays)) or 'nothing'})."
        )
    counts = {view.shape[1] for *_, view in clips}
    if len(counts) > 1:
        raise UserError(f"{path}: videos with {listed(sorted(counts))} keypoints, expected equal numbers.")
    names, notes = _names(path, clips, metadata, options)
    return _all(path, clips, names, notes, _size(sizes, {clip[0] for clip in clips}))


Clip = tuple[str, str, str, np.ndarray, np.ndarray]
"""Video, action, camera, (rows,) frames, (rows joints 2 or 3) keypoints."""


def _custom(path: Path, table: Any) -> list[Clip]:
    """Return the clips of {video: {action: [(frames joints 2), one for each camera]}}."""
    clips = []
    for video, actions in _mapping(path, table, "positions_2d").items():
        for action, views in _mapping(path, actions, f"positions_2d, '{video}'").items():
            where = f"{path}, '{video}', '{action}'"
            if isinstance(views, np.ndarray) and views.dtype != object:
                views = [views] if views.ndim == 3 else list(views)
            if not isinstance(views, list | tuple | np.ndarray):
                raise UserError(f"{where}: {type(views).__name__}, expected a list of arrays, one for each camera.")
            for camera, view in enumerate(views):
                if view is None:  # no video of this camera
                    continue
                keypoints = _keypoints(view, where)
                several = str(camera) if len(views) > 1 else ""
                clips.append((str(video), str(action), several, np.arange(len(keypoints)), keypoints))
    if not clips:
        raise UserError(f"{path}: no video in 'positions_2d'.")
    return clips


def _detected(path: Path, frames: Any) -> list[Clip]:
    """Return the clip of a detector's frames (infer_video_d2.py): [nothing, (bodies 4 joints)] of x, y, logit, share.

    Rows that follow, such as places by soft argmax, are not read.
    """
    if not isinstance(frames, np.ndarray | list) or (isinstance(frames, np.ndarray) and frames.ndim == 0):
        raise UserError(f"{path}: 'keypoints' is {type(frames).__name__}, expected a list of frames.")
    rows, numbers = [], []
    for number, frame in enumerate(frames):
        bodies = frame[1] if isinstance(frame, np.ndarray | list | tuple) and len(frame) == 2 else None
        if bodies is None or not isinstance(bodies, np.ndarray | list):
            raise UserError(f"{path}: frame {number} of 'keypoints' is not a pair of lists, as the detector writes.")
        for body in bodies:
            body = body if isinstance(body, np.ndarray) else np.empty(0)
            if body.ndim != 2 or body.shape[0] < 4 or body.dtype.kind not in "fiu":
                raise UserError(f"{path}: frame {number}: a body of shape {body.shape}, expected (4, joints) numbers.")
            rows.append(body[[0, 1, 3]].T)
            numbers.append(number)
    if not rows:
        raise UserError(f"{path}: no body in any of {len(frames)} frames.")
    if len({row.shape for row in rows}) > 1:
        raise UserError(f"{path}: bodies of different numbers of keypoints.")
    return [(path.stem, "", "", np.array(numbers), _keypoints(np.stack(rows), str(path)))]


def _keypoints(view: Any, where: str) -> np.ndarray:
    is_array = isinstance(view, np.ndarray)
    if not is_array or view.dtype.kind not in "fiu" or view.ndim != 3 or view.shape[2] not in (2, 3):
        shown = f"{view.dtype} {view.shape}" if is_array else type(view).__name__
        raise UserError(f"{where}: {shown}, expected numbers (frames, joints, 2).")
    if not view.shape[1]:
        raise UserError(f"{where}: no joints.")
    with np.errstate(over="ignore", invalid="ignore"):
        return view.astype(np.float32)


def _all(
    path: Path, clips: list[Clip], names: tuple[str, ...], notes: tuple[str, ...], size: tuple[int, int] | None
) -> PoseData:
    lengths = [len(clip[3]) for clip in clips]
    identity: dict[str, Any] = {"frame": np.concatenate([clip[3] for clip in clips]).astype(np.int64)}
    for at, key in enumerate(("sequence", "action", "camera")):
        values = [clip[at] for clip in clips]
        if any(values) and not (key == "action" and set(values) == {"custom"}):
            identity[key] = np.repeat(np.array(values), lengths)
    if "action" in identity:  # what has several is a subject, each action with frames from 0
        identity["subject"] = identity["sequence"]
        identity["sequence"] = np.char.add(np.char.add(identity["sequence"], " "), identity["action"])
    scored = {clip[4].shape[2] for clip in clips} == {3}
    keypoints = np.concatenate([clip[4][..., :2] for clip in clips])
    scores = np.concatenate([clip[4][..., 2] for clip in clips]) if scored else None
    seen = (confidence_of(keypoints, scores) > 0).any(1)
    identity = {key: values[seen] for key, values in identity.items()}
    found = Identity(identity, image_size=size)
    return bodies_of(path, found, keypoints[seen], None if scores is None else scores[seen], names, notes)


def _names(
    path: Path, clips: list[Clip], metadata: Mapping[Any, Any], options: ReadOptions
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the layout that the metadata give by its name or its left joints, else those that fit."""
    count = clips[0][4].shape[1]
    name, sides = metadata.get("layout_name"), metadata.get("keypoints_symmetry")
    try:
        left = tuple(int(place) for place in sides[0]) if sides is not None else ()
    except (TypeError, ValueError, IndexError, KeyError, OverflowError):
        left = ()
    known = _LEFT.get(left) or {"coco": _LAYOUTS[17], "h36m": _LEFT[4, 5, 6, 11, 12, 13]}.get(str(name))
    if options.layout is None and known is not None and len(known[1]) == count:
        return known[1], (f"keypoints are taken as {known[0]}'s, as the metadata say",)
    some = np.concatenate([points[:: 1 + len(points) // 100] for *_, points in clips])
    return names_for(path, count, _LAYOUTS, options, some)


def _size(sizes: Any, videos: set[str]) -> tuple[int, int] | None:
    """Return width and height where all videos have the same."""
    found = set()
    for video in videos:
        one = sizes.get(video) if isinstance(sizes, dict) else None
        sides: list[Any] = [one.get("w"), one.get("h")] if isinstance(one, dict) else []
        if len(sides) != 2 or not all(isinstance(n, int | float | np.number) and 1 <= n < 1e6 for n in sides):
            return None
        found.add((int(sides[0]), int(sides[1])))
    return found.pop() if len(found) == 1 else None


def _mapping(path: Path, value: Any, what: str) -> dict[Any, Any]:
    if not isinstance(value, dict):
        raise UserError(f"{path}: {what} is {type(value).__name__}, expected a dictionary of videos.")
    return value


def _fits(peek: Peek) -> bool:
    names = set(peek.npz_names)
    return "positions_2d" in names or ({"boxes", "keypoints", "metadata"} <= names and "joint_names" not in names)


FORMAT = FileFormat("videopose3d", "2D keypoints of VideoPose3D (npz)", _fits, _read)
