"""Read an analysis file of SLEAP (.h5): one array of all frames, tracks and nodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.formats.base import Format, Peek, ReadOptions
from uplift.data.formats.rows import as_float32, distinct, pairs_of, video_name, visible_only
from uplift.data.parsers.hdf5 import Hdf5, from_json, open_hdf5
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["FORMAT", "known_scores"]

_AXES = ("frame", "track", "node", "xy")
_OLD_ORDERS = (("track", "xy", "node", "frame"), ("frame", "node", "xy", "track"), _AXES)
"""Of files that do not say theirs: as SLEAP writes, without its transpose, and as one would expect."""


def _read(path: Path, options: ReadOptions) -> PoseData:
    with open_hdf5(path, "an analysis file of SLEAP") as file:
        names = file.texts("node_names")
        if not names or len(set(names)) != len(names):
            raise UserError(f"{path}: 'node_names' holds {names!r}, expected the names of the nodes, each once.")
        stored = file.array("tracks")
        order = _order(file, stored.shape, len(names))
        points = as_float32(stored).transpose([order.index(axis) for axis in _AXES])
        score, told = _scores(file, order, points)
        keypoints, confidence = visible_only(points, score)
        frame, track = np.nonzero(np.any(confidence > 0, axis=-1))
        if not len(frame):
            raise UserError(f"{path}: no visible keypoint in {points.shape[0]:,} frames of {points.shape[1]:,} tracks.")
        tracks, of_tracks = _track_names(file, points.shape[1])
        video = video_name(file.text("video_path")) or video_name(path.stem)
        identity = {"frame": frame, "sequence": np.full(len(frame), video)}
        if tracks:
            identity["instance"] = np.array(tracks)[track]
        return PoseData(
            keypoints=keypoints[frame, track],
            confidence=confidence[frame, track],
            joint_names=tuple(names),
            identity=identity,
            image_size=_image_size(file),
            bones=_bones(file, names),
            mirror=_mirror(file, names),
            notes=(*told, *of_tracks),
        )


def known_scores(score: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return scores with 1 for points that are ``there`` without one, and what was assumed.

    A point without a score was set by hand.
    """
    score = np.where(np.isnan(score), np.float32(1), score)
    if there.any() and not (score[there] > 0).any():
        return np.ones_like(score), ("all scores are 0: every point that is there counts as sure",)
    return score, ()


def _scores(file: Hdf5, order: tuple[str, ...], points: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return (frames, tracks, nodes) scores."""
    if not file.has("point_scores"):
        return np.ones(points.shape[:-1], np.float32), ("no point_scores: every point that is there counts as sure",)
    stored = as_float32(file.array("point_scores"))
    own = _said_order(file, "point_scores") or tuple(axis for axis in order if axis != "xy")
    if sorted(own) == sorted(_AXES[:3]) and stored.ndim == 3:
        stored = stored.transpose([own.index(axis) for axis in _AXES[:3]])
    if stored.shape != points.shape[:-1]:
        raise UserError(
            f"{file.path}: 'point_scores' has shape {stored.shape} (frame, track, node), "
            f"expected {points.shape[:-1]} as 'tracks'."
        )
    return known_scores(stored, np.all(np.isfinite(points), axis=-1))


def _order(file: Hdf5, shape: tuple[int, ...], nodes: int) -> tuple[str, ...]:
    """Return the axes of 'tracks' in the order of the file."""
    said = _said_order(file, "tracks")
    if said:
        orders = [said]
    elif file.attribute("", "transpose") in (None, True, np.True_):
        orders = list(_OLD_ORDERS)
    else:
        orders = list(_OLD_ORDERS[1:])
    for order in orders:
        sizes = dict(zip(order, shape, strict=False))
        if len(shape) == 4 and sorted(order) == sorted(_AXES) and sizes["xy"] == 2 and sizes["node"] == nodes:
            return order
    raise UserError(
        f"{file.path}: 'tracks' has shape {shape} with axes {' or '.join(str(order) for order in orders)}, "
        f"expected 2 along 'xy' and {nodes} along 'node', as 'node_names' has."
    )


def _said_order(file: Hdf5, name: str) -> tuple[str, ...]:
    dims = file.attribute(name, "dims")
    if dims is None:
        return ()
    said = from_json(file.path, f"'dims' of '{name}'", str(dims))
    if not isinstance(said, list) or not set(map(str, said)) <= set(_AXES):
        raise UserError(f"{file.path}: 'dims' of '{name}' is {dims!r}, expected some order of {', '.join(_AXES)}.")
    return tuple(map(str, said))


def _track_names(file: Hdf5, tracks: int) -> tuple[list[str], tuple[str, ...]]:
    names = file.texts("track_names") if file.has("track_names") else []
    if names and len(names) != tracks:
        raise UserError(f"{file.path}: {len(names)} names in 'track_names' for {tracks} tracks.")
    if not names and tracks > 1:
        return [str(track) for track in range(tracks)], ("tracks have no names: they are numbered",)
    new = distinct(names)
    return new, () if new == names else ("tracks of the same name are told apart by #2, #3 ...",)


def _bones(file: Hdf5, names: list[str]) -> tuple[tuple[str, str], ...]:
    """Return the edges whose ends are nodes; some files name them, some number them."""
    if file.has("edge_names"):
        ends = file.texts("edge_names")
        pairs = list(zip(ends[::2], ends[1::2], strict=False))
    elif file.has("edge_inds"):
        numbers = file.array("edge_inds").ravel().tolist()
        ends = [names[int(n)] if n in range(len(names)) else "" for n in numbers]
        pairs = list(zip(ends[::2], ends[1::2], strict=False))
    else:
        pairs = []
    known = set(names)
    return tuple((a, b) for a, b in pairs if a in known and b in known)


def _mirror(file: Hdf5, names: list[str]) -> tuple[tuple[str, str], ...]:
    said = file.attribute("", "skeleton_symmetries")
    pairs = from_json(file.path, "'skeleton_symmetries'", str(said)) if said is not None else []
    ends = [tuple(map(str, pair)) for pair in pairs if isinstance(pair, list)] if isinstance(pairs, list) else []
    return pairs_of((pair[0], pair[1]) for pair in ends if len(pair) == 2 and set(pair) <= set(names))


def _image_size(file: Hdf5) -> tuple[int, int] | None:
    said = file.attribute("", "video_backend_metadata")
    video = from_json(file.path, "'video_backend_metadata'", str(said)) if said is not None else {}
    shape = video.get("shape") if isinstance(video, dict) else None
    if isinstance(shape, list) and len(shape) == 4 and all(isinstance(n, int) and n > 0 for n in shape[1:3]):
        return shape[2], shape[1]
    return None


def _fits(peek: Peek) -> bool:
    return {"tracks", "node_names"} <= set(peek.hdf5_names) and bool(
        {"track_occupancy", "track_names"} & set(peek.hdf5_names)
    )


FORMAT = Format("sleap_h5", "an analysis file of SLEAP", _fits, _read)
