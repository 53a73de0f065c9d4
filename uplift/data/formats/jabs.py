"""Mouse poses of JABS (_pose_est_v2.h5 to v8): twelve keypoints, stored y before x."""

from __future__ import annotations

import re

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.layouts import names_for
from uplift.data.formats.rows import visible_only
from uplift.data.parsers.hdf5 import Hdf5, open_hdf5
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT", "JOINTS"]

JOINTS = (
    "nose", "left_ear", "right_ear", "base_neck", "left_front_paw", "right_front_paw", "center_spine",
    "left_rear_paw", "right_rear_paw", "base_tail", "mid_tail", "tip_tail",
)  # fmt: skip
"""The keypoints of JABS, in the order of its files."""
_BONES = (
    ("base_neck", "nose"), ("base_neck", "center_spine"), ("center_spine", "base_tail"), ("base_tail", "mid_tail"),
    ("mid_tail", "tip_tail"), ("nose", "left_ear"), ("nose", "right_ear"), ("center_spine", "left_front_paw"),
    ("center_spine", "right_front_paw"), ("base_tail", "left_rear_paw"), ("base_tail", "right_rear_paw"),
)  # fmt: skip
_NOTE = "the file does not name its keypoints: they are taken to be the twelve of JABS; layout=SKELETON names others"
_MIRROR = (("left_ear", "right_ear"), ("left_front_paw", "right_front_paw"), ("left_rear_paw", "right_rear_paw"))


def _read(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    with open_hdf5(path, "a pose file of JABS") as file:
        stored, score = file.array("poseest/points"), file.array("poseest/confidence")
        if stored.ndim not in (3, 4) or stored.shape[-2:] != (len(JOINTS), 2) or score.shape != stored.shape[:-1]:
            raise UserError(
                f"{path}: 'poseest/points' has shape {stored.shape} and 'poseest/confidence' {score.shape}, expected "
                f"(frames, {len(JOINTS)}, 2) or (frames, mice, {len(JOINTS)}, 2), and the same without the last."
            )
        if stored.ndim == 3:
            stored, score, number = stored[:, None], score[:, None], None
        else:
            there, number = _mice(file, stored.shape[:2])
            score = np.where(there[..., None], score, 0)
    points, confidence = visible_only(stored[..., ::-1], score)
    frame, mouse = np.nonzero(np.any(confidence > 0, axis=-1))
    if not len(frame):
        raise UserError(f"{path}: no visible keypoint in {len(stored):,} frames.")
    video = re.sub(r"_pose_est(_v\d+)?$", "", path.stem)
    identity = {"frame": frame, "sequence": np.full(len(frame), video)}
    if number is not None:
        identity["instance"] = number[frame, mouse].astype(str)
    names, known = JOINTS, {"bones": _BONES, "mirror": _MIRROR, "notes": (_NOTE,)}
    if options.layout is not None:
        names, known = names_for(path, len(JOINTS), {}, options)[0], {}
    return PoseData(points[frame, mouse], confidence[frame, mouse], names, identity=identity, **known)


def _mice(file: Hdf5, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return (frames, mice) which entries are filled, and the numbers of their mice.

    From version 4 on mice are numbered by how they look, 0 for an entry without a mouse; version 3
    counts the entries of a frame, and numbers tracks.
    """
    later = file.has("poseest/instance_embed_id")
    name = "poseest/instance_embed_id" if later else "poseest/instance_track_id"
    number = file.array(name)
    if number.shape != shape or number.dtype.kind not in "iu":
        raise UserError(
            f"{file.path}: '{name}' is {number.dtype} of shape {number.shape}, expected whole numbers of shape {shape}."
        )
    if later:
        return number > 0, number
    count = file.array("poseest/instance_count")
    if count.shape != shape[:1]:
        raise UserError(f"{file.path}: 'poseest/instance_count' has shape {count.shape}, expected {shape[:1]}.")
    return np.arange(shape[1]) < count[:, None], number


FORMAT = FileFormat("jabs", "a pose file of JABS", lambda peek: "poseest" in peek.hdf5_names, _read)
