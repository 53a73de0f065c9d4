"""Files of arrays, HDF5 and npz, as DeepLabCut, SLEAP, NWB, JABS, VideoPose3D and this project write them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reading.bodies import SIZE_PX, Walk
from benchmarks.reading.text_files import DLC_PARTS
from uplift.data.formats.layouts import COCO_JOINTS

__all__ = [
    "deeplabcut_h5", "jabs", "mediapipe_npz", "npz", "nwb", "sleap_h5", "sleap_slp", "sleap_slp_unnamed", "videopose3d",
]  # fmt: skip

_FRAMES = [
    ("frame_id", "u8"), ("video", "u4"), ("frame_idx", "u8"), ("instance_id_start", "u8"), ("instance_id_end", "u8"),
]  # fmt: skip
_INSTANCES = [
    ("instance_id", "i8"), ("instance_type", "u1"), ("frame_id", "u8"), ("skeleton", "u4"), ("track", "i4"),
    ("from_predicted", "i8"), ("score", "f4"), ("point_id_start", "u8"), ("point_id_end", "u8"),
    ("tracking_score", "f4"),
]  # fmt: skip
_POINTS = [("x", "f8"), ("y", "f8"), ("visible", "?"), ("complete", "?")]


def _file(path: Path) -> Any:
    import h5py

    return h5py.File(path, "w")


def _with_nan(walk: Walk) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frames, (frames bodies joints 2) points with NaN where missing, and scores."""
    frames = walk.all_frames()
    frames.xy[frames.missing] = np.nan
    return frames.frame, frames.xy, np.where(frames.missing, 0, frames.score)


def deeplabcut_h5(path: Path, walk: Walk) -> None:
    """DeepLabCut's predictions as a pandas table."""
    import pandas as pd

    frames = walk.all_frames()
    values = np.concatenate([frames.xy, frames.score[..., None]], -1)
    values[frames.missing] = np.nan
    columns = pd.MultiIndex.from_product(
        [["DLC_resnet50"], COCO_JOINTS[: walk.joints], DLC_PARTS], names=["scorer", "bodyparts", "coords"]
    )
    frame = pd.DataFrame(values.reshape(len(values), -1), columns=columns)
    frame.to_hdf(path, key="df_with_missing", mode="w", format="table")


def sleap_slp(path: Path, walk: Walk) -> None:
    """A project's predictions, with tracks."""
    _slp(path, walk, tracks=True)


def sleap_slp_unnamed(path: Path, walk: Walk) -> None:
    """A project's predictions, without tracks."""
    _slp(path, walk, tracks=False)


def _slp(path: Path, walk: Walk, *, tracks: bool) -> None:
    frame, xy, score = _with_nan(walk)
    rows = len(frame) * walk.bodies
    frames, instances = np.zeros(len(frame), _FRAMES), np.zeros(rows, _INSTANCES)
    frames["frame_id"] = frames["frame_idx"] = frame
    frames["instance_id_start"] = frame * walk.bodies
    frames["instance_id_end"] = frames["instance_id_start"] + walk.bodies
    number = np.arange(rows)
    instances["instance_id"], instances["instance_type"] = number, 1
    instances["frame_id"], instances["from_predicted"] = number // walk.bodies, -1
    instances["track"] = number % walk.bodies if tracks else -1
    instances["point_id_start"], instances["point_id_end"] = number * walk.joints, (number + 1) * walk.joints
    points = np.zeros(rows * walk.joints, [*_POINTS, ("score", "f8")])
    points["x"], points["y"] = xy.reshape(-1, 2).T
    points["visible"], points["score"] = np.isfinite(points["x"]), score.ravel()
    nodes = [{"name": name, "weight": 1.0} for name in COCO_JOINTS[: walk.joints]]
    graph = {"graph": {"name": "body"}, "links": [], "nodes": [{"id": at} for at in range(walk.joints)]}
    metadata = {"version": "2.0.0", "skeletons": [graph], "nodes": nodes}
    with _file(path) as file:
        file["frames"], file["instances"], file["pred_points"] = frames, instances, points
        file["points"] = np.zeros(0, _POINTS)
        video = {"backend": {"filename": "walk.mp4", "shape": [len(frame), SIZE_PX[1], SIZE_PX[0], 3]}}
        file["videos_json"] = np.array([json.dumps(video)], "S")
        names = [json.dumps([0, f"track_{body}"]) for body in range(walk.bodies)]
        file["tracks_json"] = np.array(names, "S") if tracks else np.zeros(0)
        file["suggestions_json"] = np.zeros(0)
        group = file.create_group("metadata")
        group.attrs["json"], group.attrs["format_id"] = np.bytes_(json.dumps(metadata).encode()), 1.2


def sleap_h5(path: Path, walk: Walk) -> None:
    """An analysis file: arrays transposed and compressed, as SLEAP writes them."""
    _, xy, score = _with_nan(walk)
    compression = {"compression": "gzip", "compression_opts": 9}
    with _file(path) as file:
        file.create_dataset("tracks", data=xy.transpose(1, 3, 2, 0), **compression)
        file.create_dataset("point_scores", data=score.transpose(1, 2, 0), **compression)
        file["track_occupancy"] = np.isfinite(xy).any((2, 3)).astype("u1")
        file["node_names"] = np.array(COCO_JOINTS[: walk.joints], "S")
        file["track_names"] = np.array([f"track_{body}" for body in range(walk.bodies)], "S")
        file["edge_inds"], file["edge_names"] = np.array([(0, 1)]), np.array([("nose", "left_eye")], "S")
        file["video_path"] = "walk.mp4"


def nwb(path: Path, walk: Walk) -> None:
    """Pose estimates of each body, a series per joint."""
    import h5py

    frame, xy, score = _with_nan(walk)
    with _file(path) as file:
        file["identifier"], file["session_start_time"] = "walk", "2026-01-02T03:04:05+00:00"
        skeleton = file.create_group("processing/behavior/Skeletons/body")
        skeleton.attrs["neurodata_type"] = "Skeleton"
        skeleton["nodes"], skeleton["edges"] = list(COCO_JOINTS[: walk.joints]), np.array([(0, 1)], "u1")
        for body in range(walk.bodies):
            above = file.require_group(f"processing/behavior/track=mouse{body + 1}")
            above.attrs["neurodata_type"] = "PoseEstimation"
            above["skeleton"] = h5py.SoftLink("/processing/behavior/Skeletons/body")
            for joint, name in enumerate(COCO_JOINTS[: walk.joints]):
                group = above.create_group(name)
                group.attrs["neurodata_type"] = "PoseEstimationSeries"
                group["data"], group["confidence"] = xy[:, body, joint], score[:, body, joint]
                group["data"].attrs.update({"unit": "pixels", "conversion": 1.0})
                group["reference_frame"] = "(0,0) is the top left corner"
                group["timestamps"] = frame / 25.0


def jabs(path: Path, walk: Walk) -> None:
    """A pose file of version 5: twelve keypoints, integer pixels, y before x."""
    frames = walk.all_frames()
    score = np.where(frames.missing, 0, frames.score).astype(np.float32)
    with _file(path) as file:
        file["poseest/points"] = np.round(frames.xy[..., ::-1]).astype(np.uint16)
        file["poseest/confidence"] = score
        file["poseest/instance_embed_id"] = np.broadcast_to(np.arange(walk.bodies) + 1, score.shape[:2]).astype("u4")
        file["poseest/instance_count"] = np.full(len(score), walk.bodies, "u1")
        file["poseest"].attrs["version"] = [5, 0]
    for spot in walk.spots:
        spot["keypoints"] = np.round(spot["keypoints"]).tolist()


def npz(path: Path, walk: Walk) -> None:
    """This project's layout, one body."""
    frames = walk.all_frames()
    np.savez_compressed(
        path,
        keypoints=frames.xy[:, 0].astype(np.float32),
        confidence=np.where(frames.missing, 0, frames.score)[:, 0].astype(np.float32),
        joint_names=np.array(COCO_JOINTS[: walk.joints]),
        frame=frames.frame,
        sequence=np.full(len(frames.frame), "walk"),
    )


def mediapipe_npz(path: Path, walk: Walk) -> None:
    """An array of landmarks, one body."""
    frames = walk.all_frames()
    fractions = frames.xy[:, 0] / SIZE_PX
    score = np.where(frames.missing, 0, frames.score)[:, 0]
    np.savez_compressed(path, landmarks=np.stack([*np.moveaxis(fractions, -1, 0), score, score], -1).astype(np.float32))


def videopose3d(path: Path, walk: Walk) -> None:
    """Keypoints of custom videos: pickled dictionaries without scores; missing joints are 0."""
    frames = walk.all_frames()
    keypoints = np.where(frames.missing[..., None], 0, frames.xy)[:, 0].astype(np.float32)
    left, right = [1, 3, 5, 7, 9, 11, 13, 15], [2, 4, 6, 8, 10, 12, 14, 16]
    metadata = {"layout_name": "coco", "num_joints": walk.joints, "keypoints_symmetry": [left, right]}
    metadata["video_metadata"] = {"walk": {"w": SIZE_PX[0], "h": SIZE_PX[1]}}
    arrays: dict[str, Any] = {"positions_2d": {"walk": {"custom": [keypoints]}}, "metadata": metadata}
    np.savez_compressed(path, **arrays)
    for spot in walk.spots:
        spot["confidence"] = (np.array(spot["confidence"]) > 0).astype(float).tolist()
