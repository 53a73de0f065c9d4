"""HDF5 files in the layouts of the trackers."""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from uplift.data.poses import PoseData
from uplift.errors import UserError

NODES = ("nose", "neck", "tail")
ANALYSIS_ORDERS = {
    "old": ("track", "xy", "node", "frame"),
    "plain": ("frame", "track", "node", "xy"),
    "untransposed": ("frame", "node", "xy", "track"),
}
_AXES = ("frame", "track", "node", "xy")
_FRAMES = np.dtype(
    [("frame_id", "u8"), ("video", "u4"), ("frame_idx", "u8"), ("instance_id_start", "u8"), ("instance_id_end", "u8")]
)
_INSTANCES = np.dtype(
    [
        ("instance_id", "i8"), ("instance_type", "u1"), ("frame_id", "u8"), ("skeleton", "u4"), ("track", "i4"),
        ("from_predicted", "i8"), ("score", "f4"), ("point_id_start", "u8"), ("point_id_end", "u8"),
        ("tracking_score", "f4"),
    ]
)  # fmt: skip
_POINTS = [("x", "f8"), ("y", "f8"), ("visible", "?"), ("complete", "?")]


def some_points(*shape: int, seed: int = 0) -> np.ndarray:
    """Return random points (px) that are exact in float32."""
    return np.random.default_rng(seed).integers(1, 5000, (*shape, 2)) / 8


def write_analysis(
    path: Path, points: np.ndarray, score: np.ndarray, order: str = "plain", say: bool = True, **extra: Any
) -> Path:
    """Write a SLEAP analysis file of points (frames, tracks, nodes, 2), with its axes in some order, recorded or not."""
    axes = ANALYSIS_ORDERS[order]
    with h5py.File(path, "w") as file:
        file["tracks"] = points.transpose([_AXES.index(axis) for axis in axes])
        of_scores = [axis for axis in axes if axis != "xy"]
        file["point_scores"] = score.transpose([_AXES.index(axis) for axis in of_scores])
        if say:
            file["tracks"].attrs["dims"] = json.dumps(axes)
            file["point_scores"].attrs["dims"] = json.dumps(of_scores)
        if order == "untransposed":
            file.attrs["transpose"] = False
        file["track_occupancy"] = np.isfinite(points).any((2, 3)).astype("u1")
        file["node_names"] = np.array(NODES[: points.shape[2]], "S")
        file["track_names"] = np.zeros(0)
        file["edge_inds"] = np.array([(0, 1), (1, 2)])
        file["edge_names"] = np.array([("nose", "neck"), ("neck", "tail")], "S")
        file["video_path"] = "D:\\films/day 1\\mouse.one.mp4"
        for name, value in extra.items():
            if name in file:
                del file[name]
            if value is not None:
                file[name] = value
    return path


def skeleton_json(*nodes: int, links: tuple[tuple[int, int, int], ...] = (), name: str = "body") -> dict[str, Any]:
    """Return a skeleton in the form of SLEAP's metadata; links are (kind, from, to)."""
    seen: list[int] = []
    said = []
    for kind, source, target in links:
        if kind not in seen:
            seen.append(kind)
            how: dict[str, Any] = {"py/reduce": [{"py/type": "sleap.skeleton.EdgeType"}, {"py/tuple": [kind]}]}
        else:
            how = {"py/id": seen.index(kind) + 1}
        said.append({"key": 0, "source": source, "target": target, "type": how})
    return {"graph": {"name": name}, "links": said, "nodes": [{"id": node} for node in nodes]}


def instance(points: np.ndarray, **more: Any) -> dict[str, Any]:
    """Return an instance for `write_slp`: kind 0 is labelled, 1 predicted."""
    return {"points": points, "kind": 0, "track": -1, "skeleton": 0, "from": -1, "score": 0.5, "visible": True} | more


def write_slp(
    path: Path,
    frames: list[tuple[int, int, list[dict[str, Any]]]],
    skeletons: list[dict[str, Any]] | None = None,
    names: tuple[str, ...] = NODES,
    videos: list[dict[str, Any]] | None = None,
    tracks: tuple[str, ...] = (),
    format_id: float | None = 1.2,
    columns: bool = False,
) -> Path:
    """Write a SLEAP project of (video, frame, instances); with ``columns``, its tables as plain number arrays."""
    rows: dict[str, list[tuple]] = {"frames": [], "instances": [], "points": [], "pred_points": []}
    for place, (video, number, inside) in enumerate(frames):
        start = len(rows["instances"])
        for one in inside:
            table = rows["pred_points" if one["kind"] else "points"]
            there = np.broadcast_to(one["visible"], len(one["points"]))
            scores = np.broadcast_to(one["score"], len(one["points"]))
            first = len(table)
            table += [
                (x, y, seen, True, *((score,) if one["kind"] else ()))
                for (x, y), seen, score in zip(one["points"].tolist(), there, scores, strict=True)
            ]
            told = (one["kind"], place, one["skeleton"], one["track"], one["from"], 1.0, first, len(table), 0.0)
            rows["instances"].append((len(rows["instances"]), *told))
        rows["frames"].append((place, video, number, start, len(rows["instances"])))
    kinds = {"frames": _FRAMES, "instances": _INSTANCES, "points": np.dtype(_POINTS)}
    metadata = {
        "version": "2.0.0",
        "skeletons": skeletons or [skeleton_json(*range(len(names)))],
        "nodes": [{"name": name, "weight": 1.0} for name in names],
    }
    with h5py.File(path, "w") as file:
        for name, values in rows.items():
            table = np.array(values, kinds.get(name, np.dtype([*_POINTS, ("score", "f8")])))
            if columns:
                titles = list(table.dtype.names or ())
                file[name] = np.array([row.tolist() for row in table], float).reshape(len(table), len(titles))
                file[name].attrs["field_names"] = json.dumps(titles)
            else:
                file[name] = table
        said = videos if videos is not None else [{"backend": {"filename": "films/a.mp4"}}]
        file["videos_json"] = np.array([json.dumps(video) for video in said], "S")
        file["tracks_json"] = np.array([json.dumps([0, name]) for name in tracks], "S") if tracks else np.zeros(0)
        file["suggestions_json"] = np.zeros(0)
        group = file.create_group("metadata")
        group.attrs["json"] = np.bytes_(json.dumps(metadata).encode())
        if format_id is not None:
            group.attrs["format_id"] = format_id
    return path


def write_nwb(path: Path, bodies: dict[str, dict[str, Any]], skeleton: tuple[str, ...] | None = NODES) -> Path:
    """Write an NWB file of pose estimates by place, such as ``behavior/mouse``.

    Each body has ``series`` (name -> points) and maybe ``stamps`` (all, or by name), ``rate``,
    ``score``, ``unit`` and more texts and arrays, such as ``original_videos`` or ``dimensions``.
    """
    with h5py.File(path, "w") as file:
        file["identifier"], file["session_start_time"] = "x", "2026-01-02T03:04:05+00:00"
        if skeleton is not None:
            _typed(file, "processing/behavior/Skeletons/body", "Skeleton")["nodes"] = list(skeleton)
            file["processing/behavior/Skeletons/body/edges"] = np.array([(0, 1), (1, 2)], "u1")[: len(skeleton) - 1]
        for place, body in bodies.items():
            group = _typed(file, f"processing/{place}", "PoseEstimation")
            if skeleton is not None:
                group["skeleton"] = h5py.SoftLink("/processing/behavior/Skeletons/body")
            for name, points in body["series"].items():
                _series(group, name, points, body)
            for key, value in body.items():
                if key not in ("series", "stamps", "rate", "score", "unit", "reference_frame", "conversion"):
                    group[key] = value
    return path


def _typed(file: h5py.File, place: str, kind: str) -> h5py.Group:
    group = file.require_group(place)
    group.attrs["neurodata_type"] = kind
    return group


def _series(above: h5py.Group, name: str, points: np.ndarray, body: dict[str, Any]) -> None:
    group = _typed(above, name, "PoseEstimationSeries")
    group["data"] = points
    group["data"].attrs.update({"unit": body.get("unit", "pixels"), "conversion": body.get("conversion", 1.0)})
    group["reference_frame"] = body.get("reference_frame", "(0,0) is the top left corner")
    if body.get("score") is not None:
        group["confidence"] = np.broadcast_to(body["score"], len(points))
    if "rate" in body:
        group["starting_time"] = 0.0
        group["starting_time"].attrs["rate"] = body["rate"]
    else:
        stamps = body.get("stamps", np.arange(len(points)) / 25)
        group["timestamps"] = np.asarray(stamps[name] if isinstance(stamps, dict) else stamps, float)


def write_jabs(path: Path, points_yx: np.ndarray, confidence: np.ndarray, **more: Any) -> Path:
    """Write a JABS pose file of points with y before x."""
    with h5py.File(path, "w") as file:
        file["poseest/points"], file["poseest/confidence"] = points_yx, confidence
        for name, value in more.items():
            if name == "version":
                file["poseest"].attrs[name] = value
            else:
                file[f"poseest/{name}"] = value
    return path


def damage(content: bytes, seed: int) -> bytes:
    """Return a file with a few bytes changed, or cut short."""
    random = np.random.default_rng(seed)
    if seed % 4 == 0:
        return content[: random.integers(8, len(content))]
    changed = bytearray(content)
    for place in random.integers(8, len(content), random.choice([1, 4, 64])):
        changed[place] = random.integers(256)
    return bytes(changed)


def outcomes(whole: Path, read: Callable[[Path], PoseData], seeds: int) -> Counter[str]:
    """Count the results of reading damaged copies of a file: read, rejected, wrong (a bug), or lost.

    Each is read in a process of its own: text of variable length with a wrong place or length sends
    the HDF5 library itself round in circles, or out of its memory; such a copy is lost.
    """
    found: Counter[str] = Counter()
    hurt = whole.with_name(f"hurt{whole.suffix}")
    for seed in range(seeds):
        hurt.write_bytes(damage(whole.read_bytes(), seed))
        child = os.fork()
        if not child:
            os._exit(_outcome(hurt, read))
        status = os.waitpid(child, 0)[1]
        found["lost" if os.WIFSIGNALED(status) else ("read", "refused", "wrong")[os.WEXITSTATUS(status)]] += 1
    return found


def _outcome(path: Path, read: Callable[[Path], PoseData]) -> int:
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(5)
    faulthandler.disable()
    try:
        data = read(path)
    except UserError as error:
        return 1 if str(path) in str(error) else 2
    except BaseException:
        traceback.print_exc()
        return 2
    seen = data.confidence > 0
    sound = np.isfinite(data.keypoints[seen]).all() and seen.any(-1).all() and data.confidence.max() <= 1
    return 0 if sound else 2
