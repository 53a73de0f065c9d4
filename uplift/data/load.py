"""From settings to cleaned `PoseData` in the skeleton's joints: find, read, match, clean, split."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from uplift.config import DataSettings, Settings
from uplift.data.clean import clean
from uplift.data.container import PoseData
from uplift.data.split import chosen_rows
from uplift.datasets import DataSet, data_set, read_cached
from uplift.errors import UserError
from uplift.paths import data_root
from uplift.readers import read
from uplift.skeleton import Skeleton
from uplift.skeleton.matching import build_joints, build_pose

__all__ = ["Loaded", "find_data", "in_joints_of", "load_data", "load_file", "load_split", "set_of"]


@dataclass(frozen=True)
class Loaded:
    """What a fit trains on and is evaluated on, and what was noticed on the way."""

    train: PoseData
    test: PoseData | None
    notes: list[str]


def load_data(settings: Settings, skeleton: Skeleton) -> Loaded:
    """Return the training and test frames that ``settings.data`` names.

    Raises:
        UserError: a file that is missing or wrong, other joints, no frames left.
    """
    chosen = settings.data
    if chosen.simulate:
        train, test = _simulated(settings, skeleton)
    else:
        train = load_split(settings, "train", skeleton)
        test = load_split(settings, "test", skeleton) if chosen.test else None
    held_out = _wanted(chosen.hold_out)
    if held_out:
        if test is not None:
            raise UserError("data.test and data.hold_out are both set: the test frames come from one of them.")
        mask = chosen_rows(train, held_out, settings.seed)
        if mask.all():
            raise UserError(f"data.hold_out={held_out} leaves no frame to train on.")
        test, train = train.select(mask), train.select(~mask)
    wanted = _wanted(chosen.select)
    if wanted:
        train = train.select(chosen_rows(train, wanted, settings.seed))
    notes = [f"train: {len(train):,} frames from {train.source}"]
    train, report = clean(train, skeleton)
    notes += report.lines()
    if test is not None:
        test, report = clean(test, skeleton)
        notes += [f"test: {len(test):,} frames from {test.source}", *report.lines()]
    return Loaded(train, test, notes)


def _wanted(choice) -> dict:
    return {key: value for key, value in vars(choice).items() if value not in (None, [])}


def _simulated(settings: Settings, skeleton: Skeleton) -> tuple[PoseData, PoseData]:
    from uplift.simulator import simulate

    frames = settings.data.simulate
    train = replace(simulate(skeleton, frames, seed=settings.seed), source=f"simulated {skeleton.name}")
    # Other bodies, motions and cameras than any training seed's.
    test = simulate(skeleton, max(200, frames // 10), seed=settings.seed + 2**31)
    return train, replace(test, source=f"simulated {skeleton.name}, other bodies")


def load_split(settings: Settings, which: str, skeleton: Skeleton) -> PoseData:
    """Return the ``train`` or ``test`` frames of ``settings`` in the skeleton's joints, not cleaned."""
    source = set_of(settings, which)
    if source is None:
        data = load_file(find_data(settings, which), skeleton)
    else:
        data = in_joints_of(read_cached(source, Path(getattr(settings.data, which)).name), skeleton)
    return replace(data, unit=settings.data.unit) if settings.data.unit else data


def set_of(settings: Settings, which: str) -> DataSet | None:
    """Return the published data set that the ``train`` or ``test`` frames are a split of; None where they are a file.

    Raises:
        UserError: no such set, or files of it that are missing, with where they come from.
    """
    chosen = settings.data
    split = getattr(chosen, which)
    if not chosen.use or not split:
        return None
    folder = data_root(chosen.name, chosen.root).absolute()
    source = data_set(chosen.use, folder, chosen.options)
    if Path(split).is_absolute():  # a file in place of the split; a split named on the command line was made a path
        if Path(split).exists() or Path(split).name not in source.splits:
            return None
        split = Path(split).name
    source.check_split(split)
    missing = source.missing(split)
    if missing:
        lines = [f"{source.title}: {len(missing)} file(s) missing in {folder}" + _needed_by(settings.task)]
        lines += [f"  {file.path.name}: {file.what}" for file in missing]
        lines += [source.about.strip(), *_places(chosen), _NO_DATA_NEEDED]
        raise UserError("\n".join(lines))
    return source


def find_data(settings: Settings, which: str) -> Path:
    """Return the path of the ``train`` or ``test`` file; a UserError that says how to get it where it is not."""
    data = settings.data
    name = getattr(data, which)
    if not name:
        raise UserError(
            "No training data: set data.train=FILE (with skeleton=...), or a task that names its own (`uplift tasks`). "
            "`uplift fit task=demo` needs no data."
        )
    path = (data_root(data.name, data.root) / name).absolute()
    if path.exists():
        return path
    raise UserError(missing_data(settings.task, data, path))


def missing_data(task: str, data: DataSettings, path: Path) -> str:
    """Return the message for a file that is not there."""
    lines = [f"No file {path}" + (_needed_by(task) or ".")]
    if data.get:
        lines.append(f"Get it: {data.get.strip()}")
    return "\n".join([*lines, *_places(data), _NO_DATA_NEEDED])


_NO_DATA_NEEDED = (
    "`uplift fit task=semi_cmu` runs on data that is free for all, `uplift fit task=demo` without any data."
)


def _needed_by(task: str) -> str:
    return f", which task '{task}' needs." if task else ""


def _places(data: DataSettings) -> list[str]:
    if not data.name or Path(data.name).is_absolute():
        return []
    return [f"Put it there, or say where it is: data.root=FOLDER, or UPLIFT_DATA=FOLDER with a subfolder {data.name}/."]


def load_file(path: str | Path, skeleton: Skeleton) -> PoseData:
    """Read a keypoint file and bring it into the joints of ``skeleton``, matched by name."""
    return in_joints_of(read(path), skeleton)


def in_joints_of(data: PoseData, skeleton: Skeleton) -> PoseData:
    """Return ``data`` with the skeleton's joints in its order, poses relative to its root.

    Raises:
        UserError: the joints do not fit the skeleton.
    """
    keypoints, confidence, pose = data.keypoints, data.confidence, data.pose
    if data.joint_names != skeleton.joints or not _whole(data):  # a full-size data set is not copied for nothing
        try:
            keypoints, confidence, _ = build_joints(keypoints, confidence, data.joint_names, skeleton)
            pose = None if pose is None else build_pose(pose, data.joint_names, skeleton)
        except UserError as error:
            raise UserError(f"{data.source}: {error}" if data.source else str(error)) from None
    root = data.root
    if pose is not None and pose[:, skeleton.root_index].any():
        shift = pose[:, skeleton.root_index]
        root = None if root is None else (root + np.nan_to_num(shift)).astype(np.float32)
        pose = pose - shift[:, None]
    return replace(
        data,
        keypoints=keypoints.astype(np.float32, copy=False),
        confidence=confidence.astype(np.float32, copy=False),
        joint_names=skeleton.joints,
        pose=None if pose is None else pose.astype(np.float32, copy=False),
        root=root,
    )


def _whole(data: PoseData) -> bool:
    """Return whether every keypoint is there."""
    return bool((data.confidence > 0).all() and np.isfinite(data.keypoints).all())
