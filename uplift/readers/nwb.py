"""Read pose estimates (ndx-pose) from a file of Neurodata Without Borders (.nwb).

The arrays are read here and not by pynwb, which takes seconds to import and follows links to other
files; it writes and reads the files of the tests.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.base import Format, Peek, ReadOptions
from uplift.readers.hdf5 import open_hdf5
from uplift.readers.hdf5_own import check_room
from uplift.readers.nwb_parts import Series, Video, groups_of, nodes_and_bones, series_of, video_of
from uplift.readers.nwb_times import frame_numbers
from uplift.readers.nwb_training import read_training
from uplift.readers.tidy import as_float32, distinct, same_or_none, visible_only

__all__ = ["FORMAT"]


@dataclass
class _Container:
    """One PoseEstimation: one body in one video."""

    place: str
    series: list[Series]
    nodes: list[str]
    bones: list[tuple[str, str]]
    video: Video

    @property
    def module(self) -> str:
        return self.place.rsplit("/", 1)[0]

    @property
    def name(self) -> str:
        return self.place.rsplit("/", 1)[1]


def _read(path: Path, options: ReadOptions) -> PoseData:
    with open_hdf5(path, "an NWB file") as file:
        places = groups_of(file)
        if not places["PoseEstimation"]:
            if places["PoseTraining"]:
                return read_training(file, places["PoseTraining"])
            raise UserError(
                f"{path}: an NWB file without pose estimates, expected a PoseEstimation (ndx-pose) with its series."
            )
        containers, notes = [], []
        for place in places["PoseEstimation"]:
            series, told = series_of(file, place)
            notes += told
            if series:
                nodes, bones = nodes_and_bones(file, place, [one.name for one in series])
                containers.append(_Container(place, series, nodes, bones, video_of(file, place)))
        if places["PoseTraining"]:
            notes.append("hand labels for training (PoseTraining) are left out beside the pose estimates")
    if not containers:
        raise UserError(f"{path}: the pose estimates are empty: no series with samples.")
    return _data(path, containers, notes)


def _data(path: Path, containers: list[_Container], notes: list[str]) -> PoseData:
    names = list(dict.fromkeys(node for one in containers for node in one.nodes))
    sequences = _sequences(path, containers)
    by_video: dict[tuple[str, str], list[_Container]] = {}
    for one, sequence in zip(containers, sequences, strict=True):
        by_video.setdefault((sequence, one.video.camera), []).append(one)
    parts, steps = [], []
    for (sequence, camera), mine in by_video.items():
        numbers, step, told = _numbers(path, mine)
        steps.append(step)
        notes += told
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
        image_size=same_or_none(one.video.image_size for one in containers),
        bones=tuple(dict.fromkeys(bone for one in containers for bone in one.bones)),
        notes=tuple(dict.fromkeys(notes)),
        **_joined(parts),
    )


def _joined(parts: list[dict]) -> dict:
    """Return the rows of all bodies, of one video in the order of time."""
    count = [len(part["frame"]) for part in parts]
    videos = list(dict.fromkeys((part["sequence"], part["camera"]) for part in parts))
    video = np.repeat([videos.index((part["sequence"], part["camera"])) for part in parts], count)
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
    pairs = [(one.module, one.video.name) for one in containers]
    several = len({one.module for one in containers}) > 1
    short = [video or (module.rsplit("/", 1)[-1] if several else path.stem) for module, video in dict.fromkeys(pairs)]
    names = dict(zip(dict.fromkeys(pairs), distinct(short), strict=True))
    return [names[pair] for pair in pairs]


def _numbers(path: Path, containers: list[_Container]) -> tuple[list[list[np.ndarray]], float | None, list[str]]:
    """Return the frame numbers of each series of each body in one video, the step between frames (s), and notes."""
    every = [series for one in containers for series in one.series]
    stamps, place = _different([series.stamps for series in every])
    step, notes = None, []
    if all(map(_rises, stamps)):
        union = stamps[0] if len(stamps) == 1 else np.unique(np.concatenate(stamps))
        numbers, step, even = frame_numbers(union)
        frames = [numbers if one is union else numbers[np.searchsorted(union, one)] for one in stamps]
        if not even:
            notes.append("time stamps are uneven: frames are counted one after another")
    else:
        lengths = sorted({len(one) for one in stamps})
        if len(lengths) > 1:
            raise UserError(
                f"{path}: '{containers[0].place}' has time stamps that do not rise, and series of "
                f"{' and '.join(map(str, lengths))} samples: which of them are of one frame cannot be told."
            )
        frames = [np.arange(lengths[0])] * len(stamps)
        notes.append("time stamps do not rise: frames are the places of samples")
    of_series = iter(frames[number] for number in place)
    return [[next(of_series) for _ in one.series] for one in containers], step, notes


def _different(arrays: list[np.ndarray]) -> tuple[list[np.ndarray], list[int]]:
    """Return the arrays without those that equal another, and which of them each is: series often share their stamps."""
    found: list[np.ndarray] = []
    known: dict[tuple[int, int], int] = {}
    place = []
    for array in arrays:
        key = (len(array), hash(array.tobytes()))
        same = known.setdefault(key, len(found))
        if same < len(found) and not np.array_equal(found[same], array):  # alike, but not equal
            same = len(found)
        if same == len(found):
            found.append(array)
        place.append(same)
    return found, place


def _rises(stamps: np.ndarray) -> bool:
    return bool(np.isfinite(stamps).all() and (np.diff(stamps) > 0).all())


def _part(path: Path, one: _Container, frames: list[np.ndarray], names: list[str]) -> dict:
    """Return the rows of one body in which a keypoint is visible."""
    different, place = _different(frames)
    own = different[0] if len(different) == 1 else np.unique(np.concatenate(different))
    rows = [slice(None) if frame is own else np.searchsorted(own, frame) for frame in different]
    check_room(path, f"'{one.place}'", 32 * len(names) * len(own))
    keypoints = np.full((len(own), len(names), 2), np.nan, np.float32)
    score = np.zeros((len(own), len(names)), np.float32)
    for series, number in zip(one.series, place, strict=True):
        column = names.index(series.name)
        keypoints[rows[number], column] = as_float32(series.points)
        score[rows[number], column] = as_float32(series.score)
    points, confidence = visible_only(keypoints, score)
    seen = np.any(confidence > 0, axis=-1)
    return {"keypoints": points[seen], "confidence": confidence[seen], "frame": own[seen]}


def _fits(peek: Peek) -> bool:
    return {"session_start_time", "identifier"} <= set(peek.hdf5_names)


FORMAT = Format("nwb", "an NWB file with poses (ndx-pose)", _fits, _read)
