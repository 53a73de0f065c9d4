"""The annotation files of MPI-INF-3DHP: annot.mat of a training sequence, annot_data.mat of a test sequence."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uplift.errors import UserError
from uplift.readers.mat import load_mat

__all__ = ["ACTIVITIES", "TEST_JOINTS", "TRAIN_JOINTS", "Sequence", "read_test", "read_train"]

TRAIN_JOINTS = (
    "spine3", "spine4", "spine2", "spine", "pelvis", "neck", "head", "head_top", "left_clavicle", "left_shoulder",
    "left_elbow", "left_wrist", "left_hand", "right_clavicle", "right_shoulder", "right_elbow", "right_wrist",
    "right_hand", "left_hip", "left_knee", "left_ankle", "left_foot", "left_toe", "right_hip", "right_knee",
    "right_ankle", "right_foot", "right_toe",
)  # fmt: skip
TEST_JOINTS = (
    "head_top", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "pelvis", "spine", "head",
)  # fmt: skip
ACTIVITIES = (
    "Standing/Walking", "Exercising", "Sitting", "Reaching/Crouching", "On The Floor", "Sports", "Miscellaneous",
)  # fmt: skip
"""Of the test set, in the order of their numbers from 1."""


@dataclass(frozen=True)
class Sequence:
    """What one camera saw in one sequence."""

    seen: np.ndarray
    """(frames joints 2) px."""
    points: np.ndarray
    """(frames joints 3) mm in the camera frame: what was seen."""
    universal: np.ndarray | None
    """(frames joints 3) mm: the same scaled to a universal height; None where it was not asked for."""

    def rows(self, rows: slice | np.ndarray) -> Sequence:
        """Return some of its frames."""
        return Sequence(self.seen[rows], self.points[rows], None if self.universal is None else self.universal[rows])


def read_train(path: Path, cameras: Collection[int], universal: bool) -> dict[int, Sequence]:
    """Return what each of ``cameras`` saw, from an annot.mat of 28 joints.

    Raises:
        UserError: a file that is damaged or another one, a camera that it does not have.
    """
    names = _names(universal)
    found = load_mat(path, [*names, "cameras"], cells=cameras)
    _check_names(path, names, found, "annot.mat of a training sequence")
    numbers = np.asarray(found.get("cameras", np.arange(14))).ravel()
    sequences = {}
    for camera in sorted(cameras):
        place = np.flatnonzero(numbers == camera)
        if not len(place):
            shown = ", ".join(f"{number:g}" for number in numbers)
            raise UserError(f"{path} has no camera {camera} (found: {shown}).")
        arrays = {name: _cell(path, name, found[name], int(place[0])) for name in names}
        sequences[camera] = _sequence(path, arrays, f"camera {camera}")
    return sequences


def read_test(path: Path, universal: bool) -> tuple[Sequence, np.ndarray, np.ndarray]:
    """Return the valid frames of an annot_data.mat of 17 joints, their numbers, and their activities' numbers.

    Raises:
        UserError: a file that is damaged or another one.
    """
    names = [*_names(universal), "valid_frame", "activity_annotation"]
    found = load_mat(path, names)
    _check_names(path, names, found, "annot_data.mat of a test sequence")
    arrays = {name: _of_frames(path, name, found[name]) for name in _names(universal)}
    sequence = _sequence(path, arrays, "the test sequence")
    flags, activity = (np.asarray(found[name]).ravel() for name in names[-2:])
    frames = len(sequence.seen)
    for name, values in (("valid_frame", flags), ("activity_annotation", activity)):
        if len(values) != frames:
            raise UserError(f"{path}: '{name}' has {len(values):,} values for {frames:,} frames of 'annot2'.")
    valid = np.flatnonzero(flags == 1)
    if not len(valid):
        raise UserError(f"{path}: no frame of it is marked valid.")
    activity = activity[valid]
    if not np.isin(activity, np.arange(1, len(ACTIVITIES) + 1)).all():
        raise UserError(
            f"{path}: 'activity_annotation' goes from {activity.min():g} to {activity.max():g}, expected 1 to 7."
        )
    return sequence.rows(valid), valid, activity.astype(np.int64)


def _names(universal: bool) -> list[str]:
    return ["annot2", "annot3", *(["univ_annot3"] if universal else [])]


def _check_names(path: Path, names: list[str], found: dict, expected: str) -> None:
    absent = [name for name in names if name not in found]
    if absent:
        have = ", ".join(found) or "none of what was looked for"
        raise UserError(f"{path}: no '{absent[0]}' in it (found: {have}). Expected the {expected}.")


def _cell(path: Path, name: str, cells: np.ndarray | list[np.ndarray], place: int) -> np.ndarray:
    """Return one camera's (frames joints axes) of a cell array of (frames, joints * axes)."""
    axes = 2 if name == "annot2" else 3
    columns = len(TRAIN_JOINTS) * axes
    if not isinstance(cells, list):
        raise UserError(f"{path}: '{name}' is an array of shape {cells.shape}, expected a cell for each camera.")
    if place >= len(cells):
        raise UserError(f"{path}: '{name}' has {len(cells)} cells, expected one for each camera.")
    array = cells[place]
    if array.ndim != 2 or array.shape[1] != columns:
        raise UserError(
            f"{path}: '{name}' of camera cell {place} has shape {array.shape}, expected (frames, {columns}): "
            f"{len(TRAIN_JOINTS)} joints of {axes} numbers."
        )
    return array.reshape(len(array), len(TRAIN_JOINTS), axes)


def _of_frames(path: Path, name: str, array: np.ndarray | list[np.ndarray]) -> np.ndarray:
    """Return (frames joints axes) of an array that MATLAB has as (axes, joints, 1, frames)."""
    axes = 2 if name == "annot2" else 3
    shape = () if isinstance(array, list) else array.shape
    if len(shape) not in (3, 4) or shape[:2] != (axes, len(TEST_JOINTS)) or (len(shape) == 4 and shape[2] != 1):
        found = "a cell array" if isinstance(array, list) else f"of shape {shape}"
        raise UserError(f"{path}: '{name}' is {found}, expected ({axes}, {len(TEST_JOINTS)}, 1, frames).")
    assert isinstance(array, np.ndarray)
    return np.ascontiguousarray(array.reshape(axes, len(TEST_JOINTS), -1).transpose(2, 1, 0))


def _sequence(path: Path, arrays: dict[str, np.ndarray], where: str) -> Sequence:
    counts = {name: len(array) for name, array in arrays.items()}
    if len(set(counts.values())) != 1:
        shown = ", ".join(f"{name} {count:,}" for name, count in counts.items())
        raise UserError(f"{path}: {where} has arrays of different lengths: {shown}. Damaged, or of different files?")
    if not next(iter(counts.values())):
        raise UserError(f"{path}: {where} has no frames.")
    return Sequence(arrays["annot2"], arrays["annot3"], arrays.get("univ_annot3"))
