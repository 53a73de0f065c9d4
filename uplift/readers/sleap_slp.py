"""Read a project or predictions of SLEAP (.slp): tables of frames, instances and points.

The tables are read here and not by sleap-io, which makes an object of every instance and so takes
ten times as long, 80 s for a million; it is what the tests hold this reader against.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.base import Format, Peek, ReadOptions
from uplift.readers.hdf5 import Hdf5, open_hdf5
from uplift.readers.hdf5_own import check_room
from uplift.readers.sleap_h5 import known_scores
from uplift.readers.sleap_parts import Body, Video, bodies_of, tracks_of, videos_of
from uplift.readers.sleap_rows import PREDICTED, USER, first_of_each, keys_of, rows_of, without_replaced
from uplift.readers.tidy import as_float32, pairs_of, same_or_none, visible_only
from uplift.readers.tracks import link_bodies

__all__ = ["FORMAT"]

_CENTRED_PIXELS, _TOO_NEW = 1.1, 3.0
"""Format numbers: since when (0, 0) is the middle of the first pixel and no longer its corner; what is not known yet."""


def _read(path: Path, options: ReadOptions) -> PoseData:
    with open_hdf5(path, "a SLEAP project") as file:
        shift_px = _shift_px(file)
        bodies, tracks, videos = bodies_of(file), tracks_of(file), videos_of(file)
        rows, notes = without_replaced(rows_of(file, len(bodies), len(tracks)))
        names, keypoints, confidence, told = _points(file, rows, bodies, shift_px)
    seen = np.any(confidence > 0, axis=-1)
    kept = first_of_each(rows, seen)
    if not len(kept):
        raise UserError(f"{path}: no visible keypoint in {len(seen):,} instances.")
    if len(kept) < seen.sum():
        notes.append("of instances of one track in one frame only the first is taken")
    rows = {name: column[kept] for name, column in rows.items()}
    keypoints, confidence = keypoints[kept], confidence[kept]
    seen_in, sequence = _videos(path, rows["video"], videos)
    instance, linked = _instances(keypoints, confidence, rows, tracks)
    of_bodies = [bodies[number] for number in np.unique(rows["skeleton"])]
    category = np.array([body.name for body in bodies])[rows["skeleton"]] if len(of_bodies) > 1 else None
    identity = {"frame": rows["frame"], "sequence": sequence, "instance": instance, "category": category}
    return PoseData(
        keypoints=keypoints,
        confidence=confidence,
        joint_names=names,
        identity={key: values for key, values in identity.items() if values is not None},
        image_size=same_or_none(video.image_size for video in seen_in),
        fps=same_or_none(video.fps for video in seen_in),
        bones=tuple(dict.fromkeys(bone for body in of_bodies for bone in body.bones)),
        mirror=pairs_of(pair for body in of_bodies for pair in body.mirror),
        notes=(*notes, *told, *linked),
    )


def _shift_px(file: Hdf5) -> float:
    """Return what is to be taken off coordinates; raises UserError for a format that is too new."""
    said = file.attribute("metadata", "format_id")
    number = float(said) if isinstance(said, (int, float)) else 0.0
    if not number < _TOO_NEW:
        raise UserError(f"{file.path} has SLEAP's format {number:g}, expected one before {_TOO_NEW:g}.")
    return 0.5 if number < _CENTRED_PIXELS else 0.0


def _videos(path: Path, number: np.ndarray, videos: dict[int, Video]) -> tuple[list[Video], np.ndarray]:
    """Return the videos that rows are of, and (rows,) their names."""
    used, place = np.unique(number, return_inverse=True)
    unknown = sorted(set(used.tolist()) - set(videos))
    if unknown and videos:
        raise UserError(f"{path}: frames are of video {unknown[0]}, expected one of {sorted(videos)}.")
    found = [videos[one] for one in used.tolist()] if videos else []
    return found, np.array([video.name for video in found] or [f"{path.stem} {one}" for one in used])[place]


def _points(
    file: Hdf5, rows: dict[str, np.ndarray], bodies: list[Body], shift_px: float
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return joint names, keypoints, confidence, and what was assumed of scores."""
    used = np.unique(rows["skeleton"]).tolist()
    names = list(dict.fromkeys(node for body in used for node in bodies[body].nodes))
    check_room(file.path, f"points of {len(names):,} nodes", 64 * len(rows["track"]) * len(names))
    keypoints = np.full((len(rows["track"]), len(names), 2), np.nan, np.float32)
    score = np.zeros(keypoints.shape[:2], np.float32)
    told: tuple[str, ...] = ()
    for kind, table in ((USER, "points"), (PREDICTED, "pred_points")):
        of_kind = rows["instance_type"] == kind
        if not of_kind.any():
            continue
        points = file.table(table, ("x", "y", "visible", *(("score",) if kind == PREDICTED else ())))
        for number in np.unique(rows["skeleton"][of_kind]).tolist():
            mine = np.flatnonzero(of_kind & (rows["skeleton"] == number))
            place = _places(file, table, rows, mine, len(bodies[number].nodes), len(points["x"]))
            columns = np.array([names.index(node) for node in bodies[number].nodes])
            xy = np.stack([points["x"][place], points["y"][place]], -1) - shift_px
            there = points["visible"][place].astype(bool) & np.isfinite(xy).all(-1)
            known = np.ones(there.shape, np.float32)
            if kind == PREDICTED:
                known, told = known_scores(as_float32(points["score"])[place], there)
            keypoints[mine[:, None], columns] = as_float32(xy)
            score[mine[:, None], columns] = np.where(there, known, 0)
    return tuple(names), *visible_only(keypoints, score), told


def _places(file: Hdf5, table: str, rows: dict, mine: np.ndarray, nodes: int, there: int) -> np.ndarray:
    """Return (rows, nodes) places of the points of instances in their table."""
    start, end = rows["point_id_start"][mine], rows["point_id_end"][mine]
    if (end - start != nodes).any():
        wrong = int((end - start)[end - start != nodes][0])
        raise UserError(f"{file.path}: an instance has {wrong} points, its skeleton {nodes} nodes.")
    if ((start < 0) | (end > there)).any() or len(mine) * nodes > there:
        raise UserError(f"{file.path}: 'instances' names points that are not among the {there:,} of '{table}'.")
    return start[:, None] + np.arange(nodes)


def _instances(
    keypoints: np.ndarray, confidence: np.ndarray, rows: dict[str, np.ndarray], tracks: list[str]
) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """Return (rows,) names of individuals: of their tracks, or linked by place where they have none."""
    free = np.flatnonzero(rows["track"] < 0)
    if not len(free):
        return np.array(tracks)[rows["track"]], ()
    alone = len(np.unique(keys_of(rows)[free])) == len(free)
    if alone and len(free) == len(rows["track"]):
        return None, ()
    body = np.zeros(len(free), np.int64)
    if not alone:
        for video in np.unique(rows["video"][free]):
            mine = rows["video"][free] == video
            body[mine] = link_bodies(keypoints[free[mine]], confidence[free[mine]], rows["frame"][free[mine]])
    names = np.array([*tracks, ""])[rows["track"]].astype(object)
    prefix = "untracked " if len(free) < len(names) else ""
    names[free] = [f"{prefix}{number}" for number in body.tolist()]
    return names.astype(str), () if alone else ("individuals without a track are linked by place",)


def _fits(peek: Peek) -> bool:
    return {"frames", "instances", "metadata"} <= set(peek.hdf5_names)


FORMAT = Format("sleap_slp", "a project of SLEAP", _fits, _read)
