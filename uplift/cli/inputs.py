"""The keypoints that predict lifts: of files, videos or a split of a data set, all at once or in parts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uplift.cli.detect import keypoints_in
from uplift.cli.lifters import hint_for
from uplift.cli.request import Request
from uplift.config.loading import load_settings
from uplift.config.settings import DataSettings, Settings
from uplift.data.datasets import DATA_SETS
from uplift.data.far import without_far
from uplift.data.formats.base import ReadOptions
from uplift.data.load import format_of_run, in_skeleton, load_file, load_split
from uplift.data.parts import frames_of, iterate_parts
from uplift.data.pieces import pieces_of
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean
from uplift.models.parts import AT_ONCE, PART_FRAMES
from uplift.models.together import CAMERA_NAME
from uplift.skeleton import Skeleton
from uplift.skeleton.match import WrongJoints
from uplift.video.frames import is_frames

__all__ = ["LongInput", "long_input", "read_input"]


def read_input(request: Request, skeleton: Skeleton, *, alone: bool = True) -> PoseData:
    """Return the keypoints of the input; raises UserError that names a lifter that fits, where another body's joints are in it."""
    with _naming_lifters(request, skeleton):
        return _keypoints(request, skeleton, alone=alone)


@contextmanager
def _naming_lifters(request: Request, skeleton: Skeleton) -> Iterator[None]:
    """Name a lifter that fits, where the input has another body's joints."""
    try:
        yield
    except WrongJoints as error:
        hint = hint_for(error.names, request.weights.run)
        known = f"{request.input}: {request.weights.run} knows {skeleton.name} ({skeleton.description})"
        raise UserError(f"{known}; {hint}" if request.weights.ready and hint else f"{error} {hint}".strip()) from None


# More frames than are lifted at once.


class LongInput(NamedTuple):
    """An input that is lifted in parts."""

    frames: int
    at_a_time: int
    parts: Iterable[PoseData]
    """Whole clips, in order."""


def long_input(request: Request, skeleton: Skeleton, data: PoseData | None = None) -> LongInput | None:
    """Return the input in parts where it is longer than what is lifted at once; None where it is not.

    Without ``data``, which is the input as it was read, only what is read part by part is long: an npz of ours, and shards.
    One length of each bone, over all frames, needs them all.
    """
    given = request.part_frames
    if given == 0 or request.constant_bones:
        return None
    most, at_a_time = (AT_ONCE, PART_FRAMES) if given is None else (given, given)
    if data is not None:
        return LongInput(len(data), at_a_time, pieces_of(data, at_a_time)) if len(data) > most else None
    if is_frames(request.input) or not Path(request.input).exists():
        return None
    frames = frames_of(request.input, _reading(request))
    parts = _read_parts(request, skeleton, at_a_time)
    return LongInput(frames, at_a_time, parts) if frames is not None and frames > most else None


def _read_parts(request: Request, skeleton: Skeleton, frames: int) -> Iterator[PoseData]:
    """Yield the parts of a file as `read_input` returns the whole."""
    _refuse_settings(request)
    with _naming_lifters(request, skeleton):
        for part in iterate_parts(request.input, frames, _reading(request), skeleton):
            yield _noted(in_skeleton([part], [], skeleton), request, alone=True)


# All frames.


def _trained(request: Request) -> Settings | None:
    return request.weights.settings()


def _reading(request: Request) -> ReadOptions:
    """Return how a file is read: what the user says, in the format that the run's training was in."""
    reading, trained = request.reading or ReadOptions(), _trained(request)
    if trained is None or reading.format is not None:
        return reading
    return replace(reading, format=format_of_run(trained, request.input))


def _noted(data: PoseData, request: Request, *, alone: bool) -> PoseData:
    """Return what was read of a file with notes: cameras of one scene that are lifted ``alone``, and turns that are missing."""
    trained = _trained(request)
    data = replace(data, notes=(*data.notes, *_cameras_of_one_scene(data))) if alone else data
    return data if trained is None else _with_turns(data, trained.data, request.reading or ReadOptions())


def _refuse_settings(request: Request) -> None:
    if request.overrides:
        raise UserError(
            f"'{request.overrides[0]}' goes with a data set, input=SET:SPLIT; input={request.input} is a file."
        )


def _keypoints(request: Request, skeleton: Skeleton, *, alone: bool = True) -> PoseData:
    """Return the keypoints of files, or of a split of a data set; a note says where cameras that are lifted ``alone`` show one scene."""
    input, overrides, reading = request.input, request.overrides, request.reading
    if is_frames(input):
        return _read_frames(request, skeleton)
    use, colon, split = str(input).rpartition(":")
    if not colon or Path(input).exists():
        _refuse_settings(request)
        return _noted(load_file(input, skeleton, _reading(request)), request, alone=alone)
    if reading is not None and reading.set_names():
        raise UserError(f"{reading.set_names()[0]}= goes with files, not with a published set, input={input}.")
    named = [f"data.name={use}"] if use in DATA_SETS else []
    if use not in DATA_SETS and ":" not in use:
        hint = f"{did_you_mean(use, DATA_SETS)} Your own is file.py:Class:SPLIT; a file has no colon in its name."
        raise UserError(f"input={input}: no data set '{use}'.{hint}")
    settings = load_settings(None, [*named, f"data.use={use}", *overrides])
    if not settings.data.name and settings.data.root is None:
        raise UserError(f"input={input}: where are its files? Give data.root=FOLDER.")
    settings.data.train = split
    return load_split(settings, "train", skeleton)


def _read_frames(request: Request, skeleton: Skeleton) -> PoseData:
    """Return the keypoints of videos or pictures in the joints of a skeleton, and keep them in a file where that is asked for."""
    if request.overrides:
        raise UserError(
            f"'{request.overrides[0]}' goes with a data set, input=SET:SPLIT; input={request.input} does not."
        )
    found = keypoints_in(request.input, request.keypoints, request.detection, skeleton, request.reading)
    return in_skeleton([without_far(found)], [], skeleton)


def _cameras_of_one_scene(data: PoseData) -> list[str]:
    """Return a note where clips seem to be seen by several cameras at once: names that differ in the camera alone, in the same frames."""
    sequence, frame = data.identity.get("sequence"), data.identity.get("frame")
    if sequence is None or frame is None:
        return []
    camera = data.identity.get("camera", np.full(len(data), ""))
    frames: dict[str, dict[str, np.ndarray]] = {}
    names, code = np.unique(np.stack([sequence.astype(str), camera.astype(str)]), axis=1, return_inverse=True)
    for place, (name, named) in enumerate(names.T.tolist()):
        seen_by = " ".join([*(found[0] for found in CAMERA_NAME.finditer(name)), *filter(None, [named])])
        if seen_by:
            frames.setdefault(CAMERA_NAME.sub("", name), {})[seen_by] = np.unique(frame[code == place])
    for scene in frames.values():
        cameras, (first, *others) = list(scene), list(scene.values())
        if any(2 * len(np.intersect1d(first, other)) >= min(len(first), len(other)) for other in others):
            shown = ", ".join(cameras[:4]) + (", ..." if len(cameras) > 4 else "")
            return [
                f"these look like {len(cameras)} cameras of one scene ({shown}): each is lifted by itself, in its own axes; "
                "together=true makes one body of them (docs/several-cameras.md)"
            ]
    return []


def _with_turns(data: PoseData, trained: DataSettings, reading: ReadOptions) -> PoseData:
    """Return ``data`` with a note where the files of the training were flipped or turned, and these are not."""
    turns = [key for key in ("flip_x", "flip_y", "rotate") if getattr(trained, key) and not getattr(reading, key)]
    if not turns:
        return data
    asked = " ".join(f"{key}={str(getattr(trained, key)).lower()}" for key in turns)
    note = f"the run was trained on files that {asked} put upright: add it where this input is like them"
    return replace(data, notes=(*data.notes, note))
