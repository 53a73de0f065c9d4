"""Neurodata Without Borders (``.nwb``): pose estimates and hand-labelled frames of ndx-pose."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, Shaped

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.rows import as_float32, distinct, link_bodies, same_or_none, video_name, visible_only
from uplift.data.parsers.files import check_memory
from uplift.data.parsers.hdf5 import Hdf5, open_hdf5
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT", "frame_numbers"]

# The parts of a file that concern poses: groups, series, nodes and videos.

_KINDS = ("PoseEstimation", "PoseTraining")
_DEEPEST, _MOST_GROUPS = 8, 100_000
_MOST_LOOKED_AT = 2_000
"""Groups that a file without NWB's root is searched for poses in."""
_DIGITS = 6
"""Of time stamps, s: beyond these, equal times of two series differ by rounding."""
_PIXELS = ("pixels", "pixel", "px", "")


@dataclass(frozen=True)
class _Series:
    """Where one keypoint of one body is over time."""

    name: str
    points: Shaped[np.ndarray, "samples 2"]
    score: Shaped[np.ndarray, "samples"]
    stamps_s: Float[np.ndarray, "samples"]


@dataclass
class _Container:
    """One PoseEstimation: one body in one video."""

    module: str
    name: str
    series: list[_Series]
    nodes: list[str]
    bones: list[tuple[str, str]]
    video: str
    camera: str
    image_size: tuple[int, int] | None


def _groups_of(file: Hdf5, most: int = _MOST_GROUPS) -> dict[str, list[str]]:
    """Return the places of each of `_KINDS`; raises UserError for more groups than ``most``."""
    found: dict[str, list[str]] = {kind: [] for kind in _KINDS}
    been: set[int] = set()
    waiting = [("", 0)]
    while waiting:
        place, depth = waiting.pop()
        if not file.is_group(place) or file.place(place) in been:
            continue
        been.add(file.place(place))
        if len(been) > most:
            raise UserError(f"{file.path}: more than {most:,} groups, expected an NWB file.")
        kind = file.attribute(place, "neurodata_type")
        if kind in _KINDS:
            found[kind].append(place)
        elif depth < _DEEPEST:
            below = [name for name in reversed(file.names(place)) if place or name != "specifications"]
            waiting += [(f"{place}/{name}", depth + 1) for name in below]
    return {kind: [place.strip("/") for place in places] for kind, places in found.items()}


def _series_of(file: Hdf5, place: str) -> tuple[list[_Series], list[str]]:
    """Return the series of a PoseEstimation that have samples, and what was assumed."""
    found, notes = [], []
    for name in file.names(place):
        where = f"{place}/{name}"
        if file.is_elsewhere(where):
            notes.append(f"'{where}' lies in another file and is left out")
        elif file.attribute(where, "neurodata_type") == "PoseEstimationSeries":
            series, more = _series(file, where, name)
            notes += more
            if len(series.points):
                found.append(series)
    return found, notes


def _series(file: Hdf5, where: str, name: str) -> tuple[_Series, list[str]]:
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
        notes.append(f"the unit of points is given as '{unit}', not pixels")
    frame = file.text(f"{where}/reference_frame")
    if "bottom" in frame.lower():
        notes.append(f"the reference frame is given as '{frame}': y is taken to point down all the same")
    scored = file.has(f"{where}/confidence")
    score = _values(file, f"{where}/confidence", len(points)) if scored else np.ones(len(points), np.float32)
    return _Series(name, points, score, _stamps(file, where, len(points))), notes


def _values(file: Hdf5, name: str, count: int) -> np.ndarray:
    found = file.array(name)
    if found.shape != (count,):
        raise UserError(f"{file.path}: '{name}' has shape {found.shape}, expected ({count},).")
    return found


def _stamps(file: Hdf5, where: str, samples: int) -> np.ndarray:
    if file.has(f"{where}/timestamps"):
        return _values(file, f"{where}/timestamps", samples).astype(np.float64).round(_DIGITS)
    rate = file.attribute(f"{where}/starting_time", "rate")
    if not isinstance(rate, (int, float)) or not 0 < rate < np.inf:
        raise UserError(f"{file.path}: '{where}' has no time stamps and the rate {rate!r}, expected one of them.")
    start = file.array(f"{where}/starting_time")
    first = float(start) if start.ndim == 0 and np.isfinite(start) else 0.0
    return (first + np.arange(samples) / rate).round(_DIGITS)


def _linked(file: Hdf5, place: str, *kinds: str) -> str | None:
    """Return the place of the first group of some kind inside another, as a rule a link; None without one."""
    inside = [f"{place}/{name}" for name in file.names(place) if file.is_group(f"{place}/{name}")]
    return next((where for where in inside if file.attribute(where, "neurodata_type") in kinds), None)


def _skeleton_of(file: Hdf5, place: str) -> tuple[list[str], list[tuple[str, str]]]:
    """Return nodes and edges of a Skeleton, or of a PoseEstimation that has its own."""
    nodes = file.texts(f"{place}/nodes") if file.has(f"{place}/nodes") else []
    if len(set(nodes)) != len(nodes):
        raise UserError(f"{file.path}: '{place}/nodes' holds {nodes!r}, expected each name once.")
    edges = file.array(f"{place}/edges") if file.has(f"{place}/edges") else np.zeros((0, 2), int)
    if edges.ndim != 2 or edges.shape[1] != 2:
        return nodes, []
    known = range(len(nodes))
    return nodes, [(nodes[int(a)], nodes[int(b)]) for a, b in edges.tolist() if a in known and b in known]


def _nodes_and_bones(file: Hdf5, place: str, series: list[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the keypoints of a container, in the order of its skeleton, and the lines between them."""
    nodes, bones = _skeleton_of(file, _linked(file, place, "Skeleton") or place)
    if not set(nodes) & set(series):  # names of another kind, and no saying which is which
        return series, []
    return [*nodes, *(name for name in series if name not in nodes)], bones


def _video_of(file: Hdf5, place: str) -> tuple[str, str, tuple[int, int] | None]:
    """Return the names of a container's video and camera, and the size of the video."""
    links = [f"{place}/{name}" for name in ("source_video", "labeled_video")]
    source = next((link for link in links if file.is_group(link)), None)
    if source is not None:
        named, sizes = [f"{source}/external_file"], f"{source}/dimension"
    else:
        named, sizes = [f"{place}/original_videos", f"{place}/labeled_videos"], f"{place}/dimensions"
    path = next((text for text in map(file.text, named) if text), "")
    camera = _linked(file, place, "Device", "CalibratedCamera")
    return video_name(path), file.own_name(camera) if camera else "", _size(file, sizes)


def _size(file: Hdf5, name: str) -> tuple[int, int] | None:
    """Return width and height, where all entries are the same and more than nothing."""
    size = file.array(name).ravel() if file.has(name) else np.zeros(0)
    if len(size) < 2 or len(size) % 2 or not (np.isfinite(size) & (size > 0) & (size < 1_000_000)).all():
        return None
    return (int(size[0]), int(size[1])) if (size.reshape(-1, 2) == size[:2]).all() else None


# From time stamps to frame numbers.

_NEAR = 0.2
"""Share of the step between frames that time stamps may be off a whole number of steps."""
_DRIFT = 0.02
"""The same of a long gap, a share of its length."""
_EXACT = 1e-3


def frame_numbers(stamps: Float[np.ndarray, "stamps"]) -> tuple[Int[np.ndarray, "stamps"], float | None, bool]:
    """Return (stamps,) frame numbers of rising time stamps, their step in seconds, and whether they are even.

    A wait of several steps is a gap of as many frames. Where the first stamp is a whole number of
    steps after 0, frames are counted from time 0, otherwise from the first stamp. Uneven stamps are
    numbered one after another, and have no step.
    """
    if len(stamps) < 2:
        return np.zeros(len(stamps), np.int64), None, True
    waits = np.diff(stamps)
    step = float(np.sort(waits)[(len(waits) - 1) // 2])
    for _ in range(2):  # the second time by the mean step, which jitter moves less
        with np.errstate(over="ignore"):
            counts = np.rint(np.minimum(waits / step, 2**40))
        if (counts < 1).any() or counts.sum() >= 2**40:
            return np.arange(len(stamps), dtype=np.int64), None, False
        step = float((stamps[-1] - stamps[0]) / counts.sum())
    off = np.abs(waits / step - counts)
    if (off > np.maximum(_NEAR, _DRIFT * counts)).any():
        return np.arange(len(stamps), dtype=np.int64), None, False
    first = stamps[0] / step
    known = 0 <= first < 2**40 and abs(first - np.rint(first)) < _EXACT and (off < _EXACT).all()
    return np.append(0, np.cumsum(counts)).astype(np.int64) + int(np.rint(first) if known else 0), step, True


# Hand-labelled frames (PoseTraining).


class _Labels:
    """The instances of all training frames."""

    def __init__(self, file: Hdf5, places: list[str]):
        self.file = file
        self.names: list[str] = []
        self.bones: dict[tuple[str, str], None] = {}
        self.found: list[tuple[list[str], np.ndarray, np.ndarray]] = []
        self.of: list[tuple[str, int, str]] = []
        """Video, frame in it (-1: not known) and name of the training frame of each instance."""
        self.skeletons: dict[int, list[str]] = {}
        self.videos: dict[int, str] = {}
        for place in places:
            frames = f"{place}/training_frames"
            for name in file.names(frames):
                if file.attribute(f"{frames}/{name}", "neurodata_type") == "TrainingFrame":
                    self._frame(f"{frames}/{name}", name)

    def _frame(self, place: str, name: str) -> None:
        file = self.file
        number = file.attribute(place, "source_video_frame_index")
        known = isinstance(number, (int, np.integer)) and 0 <= number < 2**40
        video = self._video(f"{place}/source_video") if file.is_group(f"{place}/source_video") else ""
        for instance in file.names(f"{place}/skeleton_instances"):
            where = f"{place}/skeleton_instances/{instance}"
            nodes = self._skeleton(where)
            points = file.array(f"{where}/node_locations")
            if points.ndim != 2 or points.shape[0] != len(nodes) or points.shape[1] not in (2, 3):
                shape = f"shape {points.shape}, expected ({len(nodes)}, 2)"
                raise UserError(f"{file.path}: '{where}/node_locations' has {shape}.")
            flagged = file.has(f"{where}/node_visibility")
            seen = _values(file, f"{where}/node_visibility", len(nodes)) if flagged else np.ones(len(nodes))
            self.found.append((nodes, points[:, :2].astype(float), np.where(seen > 0, 1.0, 0.5)))
            self.of.append((video, int(number) if known else -1, name))

    def _video(self, place: str) -> str:
        key = self.file.place(place)
        if key not in self.videos:
            self.videos[key] = video_name(self.file.text(f"{place}/external_file")) or str(len(self.videos))
        return self.videos[key]

    def _skeleton(self, place: str) -> list[str]:
        where = _linked(self.file, place, "Skeleton")
        if where is None:
            raise UserError(f"{self.file.path}: '{place}' has no Skeleton, expected one with the names of its nodes.")
        key = self.file.place(where)
        if key not in self.skeletons:
            nodes, bones = _skeleton_of(self.file, where)
            self.skeletons[key] = nodes
            self.names = list(dict.fromkeys([*self.names, *nodes]))
            self.bones.update(dict.fromkeys(bones))
        return self.skeletons[key]

    def data(self) -> PoseData:
        """Return the instances as rows; raises UserError where nothing is visible."""
        size = 64 * len(self.found) * len(self.names)
        check_memory(self.file.path, "the labels", size, self.file.path.stat().st_size)
        keypoints = np.full((len(self.found), len(self.names), 2), np.nan)
        score = np.zeros(keypoints.shape[:2])
        for row, (nodes, points, seen) in enumerate(self.found):
            columns = [self.names.index(node) for node in nodes]
            keypoints[row, columns], score[row, columns] = points, seen
        points, confidence = visible_only(keypoints, score)
        rows = np.flatnonzero(np.any(confidence > 0, axis=-1))
        if not len(rows):
            raise UserError(f"{self.file.path}: no visible keypoint in the training frames.")
        points, confidence = points[rows], confidence[rows]
        identity, notes = self._identity(rows, points, confidence)
        known = {"identity": identity, "bones": tuple(self.bones), "notes": notes}
        return PoseData(points, confidence, tuple(self.names), **known)

    def _identity(
        self, rows: np.ndarray, points: np.ndarray, confidence: np.ndarray
    ) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
        videos, frames, names = (np.array([self.of[row][item] for row in rows.tolist()]) for item in range(3))
        if (frames < 0).any() or (videos == "").any():
            return {"image": names}, ()
        identity = {"frame": frames, "sequence": videos}
        if len(set(zip(videos.tolist(), frames.tolist(), strict=True))) == len(rows):
            return identity, ()
        body = np.zeros(len(rows), np.int64)
        for video in np.unique(videos):
            mine = videos == video
            body[mine] = link_bodies(points[mine], confidence[mine], frames[mine])
        return identity | {"instance": body.astype(str)}, ("individuals have no names: they are linked by place",)


# Pose estimates.


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    with open_hdf5(path, "an NWB file") as file:
        places = _groups_of(file)
        if not places["PoseEstimation"]:
            if places["PoseTraining"]:
                return _Labels(file, places["PoseTraining"]).data()
            raise UserError(f"{path}: an NWB file without pose estimates, expected a PoseEstimation (ndx-pose).")
        containers, notes = [], []
        for place in places["PoseEstimation"]:
            if file.text(f"{place}/source_software") == "uplift":
                notes.append(f"'{place}' holds 3D poses, which cannot be lifted: it is left out")
                continue
            series, more = _series_of(file, place)
            notes += more
            if series:
                nodes, bones = _nodes_and_bones(file, place, [one.name for one in series])
                module, _, name = place.rpartition("/")
                containers.append(_Container(module, name, series, nodes, bones, *_video_of(file, place)))
        if places["PoseTraining"]:
            notes.append("hand labels for training (PoseTraining) are left out beside the pose estimates")
    if not containers and notes and "3D poses" in notes[0]:
        raise UserError(f"{path} holds 3D poses that uplift wrote, which cannot be lifted; expected 2D keypoints.")
    if not containers:
        raise UserError(f"{path}: the pose estimates are empty: no series with samples.")
    return _data(path, containers, notes)


def _data(path: Path, containers: list[_Container], notes: list[str]) -> PoseData:
    names = list(dict.fromkeys(node for one in containers for node in one.nodes))
    sequences = _sequences(path, containers)
    by_video: dict[tuple[str, str], list[_Container]] = {}
    for one, sequence in zip(containers, sequences, strict=True):
        by_video.setdefault((sequence, one.camera), []).append(one)
    parts, steps = [], []
    for (sequence, camera), mine in by_video.items():
        numbers, step, more = _numbers(path, mine)
        steps.append(step)
        notes += more
        for one, frames in zip(mine, numbers, strict=True):
            label = one.name.removeprefix("track=") if len(mine) > 1 or one.name.startswith("track=") else ""
            parts.append(_part(path, one, frames, names) | {"sequence": sequence, "camera": camera, "instance": label})
    if not any(len(part["frame"]) for part in parts):
        raise UserError(f"{path}: no visible keypoint in {len(containers)} pose estimates.")
    step = same_or_none(steps)
    if step == 1.0:
        notes.append("time stamps count frames, not seconds: frames a second are not known")
    return PoseData(
        joint_names=tuple(names),
        fps=None if step in (None, 1.0) else round(1 / step, 4),
        image_size=same_or_none(one.image_size for one in containers),
        bones=tuple(dict.fromkeys(bone for one in containers for bone in one.bones)),
        notes=tuple(dict.fromkeys(notes)),
        **_joined(parts),
    )


def _joined(parts: list[dict]) -> dict:
    """Return the rows of all bodies, of one video in the order of time."""
    count = [len(part["frame"]) for part in parts]
    of = [(part["sequence"], part["camera"]) for part in parts]
    video = np.repeat([of.index(one) for one in of], count)
    frame = np.concatenate([part["frame"] for part in parts])
    order = np.lexsort((frame, video))
    identity = {"frame": frame[order]}
    for key in ("sequence", "camera", "instance"):
        values = [part[key] for part in parts]
        if any(values) and (key != "camera" or len(set(values)) > 1):
            identity[key] = np.repeat(np.array(values), count)[order]
    arrays = {key: np.concatenate([part[key] for part in parts])[order] for key in ("keypoints", "confidence")}
    return arrays | {"identity": identity}


def _sequences(path: Path, containers: list[_Container]) -> list[str]:
    """Return the video of each container: as it is named there, or the module or file where it is not."""
    pairs = [(one.module, one.video) for one in containers]
    several = len({one.module for one in containers}) > 1
    short = [video or (module.rsplit("/", 1)[-1] if several else path.stem) for module, video in dict.fromkeys(pairs)]
    names = dict(zip(dict.fromkeys(pairs), distinct(short), strict=True))
    return [names[pair] for pair in pairs]


def _numbers(path: Path, containers: list[_Container]) -> tuple[list[list[np.ndarray]], float | None, list[str]]:
    """Return the frame numbers of each series of each body in one video, the step between frames (s), and notes."""
    every = [series for one in containers for series in one.series]
    stamps, place = _different([series.stamps_s for series in every])
    step, notes = None, []
    if all(np.isfinite(one).all() and (np.diff(one) > 0).all() for one in stamps):
        union = stamps[0] if len(stamps) == 1 else np.unique(np.concatenate(stamps))
        numbers, step, even = frame_numbers(union)
        frames = [numbers if one is union else numbers[np.searchsorted(union, one)] for one in stamps]
        if not even:
            notes.append("time stamps are uneven: frames are counted one after another")
    else:
        lengths = sorted({len(one) for one in stamps})
        if len(lengths) > 1:
            raise UserError(
                f"{path}: '{containers[0].module}/{containers[0].name}' has time stamps that do not rise, and series of "
                f"{' and '.join(map(str, lengths))} samples: which of them are of one frame is unknown."
            )
        frames = [np.arange(lengths[0])] * len(stamps)
        notes.append("time stamps do not rise: frames are the places of samples")
    of_series = iter(frames[number] for number in place)
    return [[next(of_series) for _ in one.series] for one in containers], step, notes


def _different(arrays: list[np.ndarray]) -> tuple[list[np.ndarray], list[int]]:
    """Return the arrays without those that equal another, and which of them each is: series often share their stamps."""
    number: dict[bytes, int] = {}
    place = [number.setdefault(array.tobytes(), len(number)) for array in arrays]
    return [arrays[place.index(n)] for n in range(len(number))], place


def _part(path: Path, one: _Container, frames: list[np.ndarray], names: list[str]) -> dict:
    """Return the rows of one body in which a keypoint is visible."""
    different, place = _different(frames)
    union = different[0] if len(different) == 1 else np.unique(np.concatenate(different))
    rows = [slice(None) if frame is union else np.searchsorted(union, frame) for frame in different]
    size = 32 * len(names) * len(union)
    check_memory(path, f"'{one.module}/{one.name}'", size, path.stat().st_size)
    keypoints = np.full((len(union), len(names), 2), np.nan, np.float32)
    score = np.zeros((len(union), len(names)), np.float32)
    for series, number in zip(one.series, place, strict=True):
        column = names.index(series.name)
        keypoints[rows[number], column] = as_float32(series.points)
        score[rows[number], column] = as_float32(series.score)
    points, confidence = visible_only(keypoints, score)
    seen = np.any(confidence > 0, axis=-1)
    return {"keypoints": points[seen], "confidence": confidence[seen], "frame": union[seen]}


_ROOT = {"session_start_time", "identifier"}


def _fits(peek: Peek) -> bool:
    """Return whether an HDF5 file has the root of NWB, or, where it was made without, groups of poses."""
    if not peek.is_hdf5 or set(peek.hdf5_names) >= _ROOT:
        return peek.is_hdf5
    with suppress(UserError), open_hdf5(peek.path, "an NWB file") as file:
        return any(_groups_of(file, _MOST_LOOKED_AT).values())
    return False


FORMAT = FileFormat("nwb", "an NWB file with poses (ndx-pose)", _fits, _read)
