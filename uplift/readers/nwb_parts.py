"""The parts of an NWB file that concern poses: which groups, series, nodes and videos there are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uplift.errors import UserError
from uplift.readers.hdf5 import Hdf5
from uplift.readers.tidy import video_name

__all__ = ["Series", "Video", "groups_of", "linked", "nodes_and_bones", "series_of", "skeleton_of", "video_of"]

_KINDS = ("PoseEstimation", "PoseTraining")
_DEEPEST, _MOST_GROUPS = 8, 100_000
_DIGITS = 6
"""Of time stamps, s: beyond these, equal times of two series differ by rounding."""
_PIXELS = ("pixels", "pixel", "px", "")


@dataclass(frozen=True)
class Series:
    """Where one keypoint of one body is over time."""

    place: str
    name: str
    points: np.ndarray
    """(samples, 2) float32."""
    score: np.ndarray
    """(samples,) float32."""
    stamps: np.ndarray
    """(samples,) seconds."""


@dataclass(frozen=True)
class Video:
    """What is known of the video that poses are from."""

    name: str
    camera: str
    image_size: tuple[int, int] | None


def groups_of(file: Hdf5) -> dict[str, list[str]]:
    """Return the places of the groups of poses, by kind."""
    found: dict[str, list[str]] = {kind: [] for kind in _KINDS}
    been: set[int] = set()
    waiting = [(name, 1) for name in reversed(file.names()) if name != "specifications"]
    while waiting:
        place, depth = waiting.pop()
        if not file.is_group(place) or file.place(place) in been:
            continue
        been.add(file.place(place))
        if len(been) > _MOST_GROUPS:
            raise UserError(f"{file.path}: more than {_MOST_GROUPS:,} groups, expected an NWB file.")
        kind = file.attribute(place, "neurodata_type")
        if kind in _KINDS:
            found[kind].append(place)
        elif depth < _DEEPEST:
            waiting += [(f"{place}/{name}", depth + 1) for name in reversed(file.names(place))]
    return found


def series_of(file: Hdf5, place: str) -> tuple[list[Series], list[str]]:
    """Return the series of a PoseEstimation that have samples, and what was assumed."""
    found, notes = [], []
    for name in file.names(place):
        where = f"{place}/{name}"
        if file.is_elsewhere(where):
            notes.append(f"'{where}' lies in another file and is left out")
        elif file.attribute(where, "neurodata_type") == "PoseEstimationSeries":
            series, told = _series(file, where, name)
            notes += told
            if len(series.points):
                found.append(series)
    return found, notes


def _series(file: Hdf5, where: str, name: str) -> tuple[Series, list[str]]:
    data = file.array(f"{where}/data")
    if data.ndim != 2 or data.shape[1] not in (2, 3):
        raise UserError(f"{file.path}: '{where}/data' has shape {data.shape}, expected (samples, 2) or (samples, 3).")
    notes = ["the third coordinate of points is left out"] if data.shape[1] == 3 else []
    points = data[:, :2]
    factor, offset = (file.attribute(f"{where}/data", key) for key in ("conversion", "offset"))
    if isinstance(factor, (int, float)) and (factor, offset or 0.0) != (1.0, 0.0) and np.isfinite(factor):
        points = points * factor + (offset if isinstance(offset, (int, float)) else 0.0)
    unit = str(file.attribute(f"{where}/data", "unit") or "")
    if unit.lower() not in _PIXELS:
        notes.append(f"the unit of points is said to be '{unit}', not pixels")
    frame = file.text(f"{where}/reference_frame")
    if "bottom" in frame.lower():
        notes.append(f"the reference frame is said to be '{frame}': y is taken to point down all the same")
    score = np.ones(len(points), np.float32)
    if file.has(f"{where}/confidence"):
        score = file.array(f"{where}/confidence")
        if score.shape != (len(points),):
            raise UserError(f"{file.path}: '{where}/confidence' has shape {score.shape}, expected ({len(points)},).")
    return Series(where, name, points, score, _stamps(file, where, len(points))), notes


def _stamps(file: Hdf5, where: str, samples: int) -> np.ndarray:
    """Return (samples,) seconds."""
    if file.has(f"{where}/timestamps"):
        stamps = file.array(f"{where}/timestamps").astype(np.float64).round(_DIGITS)
        if stamps.shape != (samples,):
            raise UserError(f"{file.path}: '{where}/timestamps' has shape {stamps.shape}, expected ({samples},).")
        return stamps
    rate = file.attribute(f"{where}/starting_time", "rate")
    if not isinstance(rate, (int, float)) or not 0 < rate < np.inf:
        raise UserError(f"{file.path}: '{where}' has no time stamps and the rate {rate!r}, expected one of them.")
    start = file.array(f"{where}/starting_time")
    first = float(start) if start.ndim == 0 and np.isfinite(start) else 0.0
    return (first + np.arange(samples) / rate).round(_DIGITS)


def linked(file: Hdf5, place: str, *kinds: str) -> str | None:
    """Return the place of the first group of some kind inside another, as a rule a link; None where there is none."""
    inside = [f"{place}/{name}" for name in file.names(place) if file.is_group(f"{place}/{name}")]
    return next((where for where in inside if file.attribute(where, "neurodata_type") in kinds), None)


def skeleton_of(file: Hdf5, place: str) -> tuple[list[str], list[tuple[str, str]]]:
    """Return nodes and edges of a Skeleton, or of a PoseEstimation that has its own."""
    nodes = file.texts(f"{place}/nodes") if file.has(f"{place}/nodes") else []
    if len(set(nodes)) != len(nodes):
        raise UserError(f"{file.path}: '{place}/nodes' holds {nodes!r}, expected each name once.")
    edges = file.array(f"{place}/edges") if file.has(f"{place}/edges") else np.zeros((0, 2), int)
    if edges.ndim != 2 or edges.shape[1] != 2:
        return nodes, []
    known = range(len(nodes))
    return nodes, [(nodes[int(a)], nodes[int(b)]) for a, b in edges.tolist() if a in known and b in known]


def nodes_and_bones(file: Hdf5, place: str, series: list[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the keypoints of a container, in the order of its skeleton, and the lines between them."""
    nodes, bones = skeleton_of(file, linked(file, place, "Skeleton") or place)
    if not set(nodes) & set(series):  # names of another kind, and no saying which is which
        return series, []
    return [*nodes, *(name for name in series if name not in nodes)], bones


def video_of(file: Hdf5, place: str) -> Video:
    """Return what a container says of its video."""
    links = [f"{place}/{name}" for name in ("source_video", "labeled_video")]
    source = next((link for link in links if file.is_group(link)), None)
    if source is not None:
        named, sizes = [f"{source}/external_file"], f"{source}/dimension"
    else:
        named, sizes = [f"{place}/original_videos", f"{place}/labeled_videos"], f"{place}/dimensions"
    path = next((text for text in map(file.text, named) if text), "")
    camera = linked(file, place, "Device", "CalibratedCamera")
    return Video(video_name(path), file.own_name(camera) if camera else "", _size(file, sizes))


def _size(file: Hdf5, name: str) -> tuple[int, int] | None:
    """Return width and height, where all entries are the same and more than nothing."""
    size = file.array(name).ravel() if file.has(name) else np.zeros(0)
    if len(size) < 2 or len(size) % 2 or not (np.isfinite(size) & (size > 0) & (size < 1_000_000)).all():
        return None
    return (int(size[0]), int(size[1])) if (size.reshape(-1, 2) == size[:2]).all() else None
