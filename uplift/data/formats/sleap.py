"""SLEAP: projects and predictions (``.slp``), tables of frames, instances and points; and analysis files (``.h5``)."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.formats.base import FileFormat, Peek, ReadOptions
from uplift.data.formats.rows import as_float32, distinct, link_bodies, pairs_of, same_or_none, video_name, visible_only
from uplift.data.parsers.files import check_memory
from uplift.data.parsers.hdf5 import Hdf5, from_json, open_hdf5
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = ["ANALYSIS", "PROJECT"]

# The JSON inside a project: its skeletons, videos and tracks.

_BONE, _MIRROR = 1, 2
"""Kinds of links between nodes, as SLEAP numbers them."""
_WRONG = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True)
class _Body:
    """A skeleton of a project."""

    name: str
    nodes: tuple[str, ...]
    """In the order of the points of an instance."""
    bones: tuple[tuple[str, str], ...]
    mirror: tuple[tuple[str, str], ...]


_Video = tuple[str, tuple[int, int] | None, float | None]
"""Name, size of the image and frames a second of a video."""


def _bodies_of(file: Hdf5) -> list[_Body]:
    """Return the skeletons, in the order that instances count them in; raises UserError for other metadata."""
    raw = file.attribute("metadata", "json")
    if raw is None:
        raise UserError(f"{file.path}: no metadata with the names of the nodes, expected in {file.what}.")
    metadata = from_json(file.path, "the metadata", str(raw))
    try:
        names = [_clean(node["name"]) for node in metadata["nodes"]]
        bodies = [_body(skeleton.get("nx_graph", skeleton), names) for skeleton in metadata["skeletons"]]
    except _WRONG as error:
        raise UserError(f"{file.path}: skeletons in the metadata are not as SLEAP writes them ({error!r}).") from error
    for body in bodies:
        if not body.nodes or len(set(body.nodes)) != len(body.nodes):
            raise UserError(f"{file.path}: skeleton '{body.name}' has nodes {body.nodes!r}, expected each name once.")
    return bodies


def _body(graph: dict[str, Any], names: list[str]) -> _Body:
    ids = [int(node["id"]) for node in graph["nodes"]]
    if min(ids, default=0) < 0:
        raise ValueError("a node of negative number")
    name_of = {number: names[number] for number in ids}
    ends: dict[int, list[tuple[str, str]]] = {_BONE: [], _MIRROR: []}
    kinds: dict[int, int] = {}  # the first mention of a kind spells it out, later ones point back to it
    for link in graph["links"]:
        raw = link["type"]
        if "py/reduce" in raw:
            kind = kinds[len(kinds) + 1] = int(raw["py/reduce"][1]["py/tuple"][0])
        else:
            kind = kinds.get(int(raw["py/id"]), int(raw["py/id"]))
        ends[kind].append((name_of[int(link["source"])], name_of[int(link["target"])]))
    title = _clean(graph.get("graph", {}).get("name") or "")
    return _Body(title, tuple(name_of[n] for n in ids), tuple(dict.fromkeys(ends[_BONE])), pairs_of(ends[_MIRROR]))


def _tracks_of(file: Hdf5) -> list[str]:
    raw = file.texts("tracks_json") if file.has("tracks_json") else []
    found = [from_json(file.path, f"entry {place} of 'tracks_json'", text) for place, text in enumerate(raw)]
    try:
        return distinct(_clean(entry[1]) for entry in found)
    except _WRONG as error:
        raise UserError(f"{file.path}: 'tracks_json' is not as SLEAP writes it ({error!r}).") from error


def _videos_of(file: Hdf5) -> dict[int, _Video]:
    """Return the videos by the numbers that frames give them: their place, or that of the group with their pictures."""
    raw = file.texts("videos_json") if file.has("videos_json") else []
    entries = [from_json(file.path, f"entry {place} of 'videos_json'", text) for place, text in enumerate(raw)]
    cropped = file.has("video_crops")  # then the file's size is not that of the picture that was tracked
    by_place = np.unique(file.table("frames", ("video",))["video"]).tolist() == list(range(len(entries)))
    found = {}
    try:
        names = _names([_source(file, entry) for entry in entries])
        for place, (entry, name) in enumerate(zip(entries, names, strict=True)):
            inside = re.match(r"video(\d{1,9})/", str(entry["backend"].get("dataset") or ""))
            size, fps = _shown(entry["backend"])
            found[int(inside[1]) if inside and not by_place else place] = (name, None if cropped else size, fps)
    except _WRONG as error:
        raise UserError(f"{file.path}: 'videos_json' is not as SLEAP writes it ({error!r}).") from error
    return found


def _names(paths: list[str]) -> list[str]:
    """Return a name for each video, with its folder where several videos have one name."""
    names = [video_name(path) for path in paths]
    count = Counter(names)
    parts = zip((re.split(r"[\\/]", path)[-2:-1] for path in paths), names, strict=True)
    return distinct("/".join([*folder, name]) if count[name] > 1 else name for folder, name in parts)


def _source(file: Hdf5, entry: dict[str, Any]) -> str:
    """Return the path of a video; of one whose pictures are inside the project, that of the video they come from."""
    backend = entry["backend"]
    pictures = backend.get("filenames") or backend.get("filename")
    if isinstance(pictures, list) and pictures:
        first = str(pictures[0])
        folder = re.split(r"[\\/]", first)[:-1]
        return _clean("/".join(folder) if folder and folder[-1] not in ("", ".", "..") else first)
    path = str(backend.get("filename") or entry.get("filename") or ".")
    if path != ".":
        return _clean(path)
    group = str(backend.get("dataset") or "").split("/")[0]
    source = f"{group}/source_video"
    if group and file.has(source):
        raw = file.text(f"{source}/json") if file.has(f"{source}/json") else file.attribute(source, "json")
        above = from_json(file.path, f"the source of {group}", str(raw))
        path = str(above["backend"].get("filename") or above.get("filename") or ".")
    return _clean(path if path != "." else f"{file.path.stem}_{group}" if group else file.path.stem)


def _shown(backend: dict[str, Any]) -> tuple[tuple[int, int] | None, float | None]:
    """Return the size of the pictures and the frames a second, where they are known."""
    shape, fps = backend.get("shape"), backend.get("fps")
    size: Any = (backend.get("width_"), backend.get("height_"))
    if isinstance(shape, list) and len(shape) == 4:
        size = (shape[2], shape[1])
    known = all(isinstance(n, int) and 0 < n < 1_000_000 for n in size)
    return size if known else None, float(fps) if isinstance(fps, int | float) and 0 < fps < 1e5 else None


def _clean(text: Any) -> str:
    return str(text).encode(errors="replace").decode()


# The instances that count: those of frames, one a track, labels before predictions.

USER, PREDICTED = 0, 1
"""Kinds of instances, as SLEAP numbers them."""


def _rows_of(file: Hdf5, bodies: int, tracks: int) -> dict[str, np.ndarray]:
    """Return columns of integers, a row for each instance that a frame has."""
    frames = _integers(file, "frames", ("video", "frame_idx", "instance_id_start", "instance_id_end"))
    columns = ("instance_id", "instance_type", "skeleton", "track", "from_predicted", "point_id_start", "point_id_end")
    instances = _integers(file, "instances", columns)
    start, count = frames["instance_id_start"], frames["instance_id_end"] - frames["instance_id_start"]
    there = len(instances["track"])
    if ((start < 0) | (count < 0) | (start + count > there)).any() or count.sum() > there:
        raise UserError(f"{file.path}: 'frames' names instances that are not among the {there:,} of 'instances'.")
    which = np.repeat(start - np.append(0, np.cumsum(count)[:-1]), count) + np.arange(count.sum())
    rows = {name: column[which] for name, column in instances.items()}
    rows["video"], rows["frame"] = np.repeat(frames["video"], count), np.repeat(frames["frame_idx"], count)
    ranges = {"instance_type": (USER, PREDICTED), "skeleton": (0, bodies - 1), "track": (-1, tracks - 1)}
    for name, (low, high) in {**ranges, "frame": (0, 2**40 - 1)}.items():
        least, most = (rows[name].min(), rows[name].max()) if len(rows[name]) else (low, high)
        if least < low or most > high:
            raise UserError(f"{file.path}: column '{name}' goes from {least} to {most}, expected {low} to {high}.")
    return rows


def _integers(file: Hdf5, name: str, columns: tuple[str, ...]) -> dict[str, np.ndarray]:
    found = file.table(name, columns)
    for column, values in found.items():
        right = values <= 2**62
        if values.dtype.kind == "f":
            right = (np.abs(values) < 2**53) & (values == np.rint(values))
        if not right.all():
            wrong = values[~right][0]
            raise UserError(f"{file.path}: column '{column}' of '{name}' holds {wrong}, expected whole numbers.")
        found[column] = values.astype(np.int64)
    return found


def _keys_of(rows: dict[str, np.ndarray]) -> np.ndarray:
    """Return (rows,) numbers, the same for rows of one video, frame and track."""
    key = np.zeros(len(rows["track"]), np.int64)
    for name in ("video", "frame", "track"):
        code = np.unique(rows[name], return_inverse=True)[1]
        key = np.unique(key * (code.max(initial=0) + 1) + code, return_inverse=True)[1]
    return key


def _without_replaced(rows: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the rows without predictions that a labelled instance stands for, and a note where there were any."""
    user, tracked = rows["instance_type"] == USER, rows["track"] >= 0
    key = _keys_of(rows)
    replaced = np.isin(rows["instance_id"], rows["from_predicted"][user & (rows["from_predicted"] >= 0)])
    replaced |= tracked & np.isin(key, key[user & tracked])
    replaced &= ~user
    note = f"{int(replaced.sum()):,} predicted instances are left out, as labelled ones take their place"
    return {name: column[~replaced] for name, column in rows.items()}, [note] if replaced.any() else []


def _first_of_each(rows: dict[str, np.ndarray], seen: np.ndarray) -> np.ndarray:
    """Return the indices, in the order of time, of rows that show something, one for each video, frame and track."""
    where = np.flatnonzero(seen)
    kept = rows["track"][where] < 0
    kept[np.unique(_keys_of(rows)[where], return_index=True)[1]] = True
    where = where[kept]
    return where[np.lexsort((rows["frame"][where], rows["video"][where]))]


# Projects and predictions (.slp): tables of frames, instances and points.

_CENTRED_PIXELS, _TOO_NEW = 1.1, 3.0
"""Format numbers: since when (0, 0) is the middle of the first pixel and no longer its corner; what is not known yet."""


def _read_project(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    with open_hdf5(path, "a SLEAP project") as file:
        bodies, tracks, videos = _bodies_of(file), _tracks_of(file), _videos_of(file)
        rows, notes = _without_replaced(_rows_of(file, len(bodies), len(tracks)))
        names, keypoints, confidence, more = _points(file, rows, bodies, _shift_px(file))
    seen = np.any(confidence > 0, axis=-1)
    kept = _first_of_each(rows, seen)
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
        image_size=same_or_none(size for _, size, _ in seen_in),
        fps=same_or_none(fps for _, _, fps in seen_in),
        bones=tuple(dict.fromkeys(bone for body in of_bodies for bone in body.bones)),
        mirror=pairs_of(pair for body in of_bodies for pair in body.mirror),
        notes=(*notes, *more, *linked),
    )


def _shift_px(file: Hdf5) -> float:
    """Return what is to be taken off coordinates; raises UserError for a format that is too new."""
    raw = file.attribute("metadata", "format_id")
    number = float(raw) if isinstance(raw, (int, float)) else 0.0
    if not number < _TOO_NEW:
        raise UserError(f"{file.path} has SLEAP's format {number:g}, expected one before {_TOO_NEW:g}.")
    return 0.5 if number < _CENTRED_PIXELS else 0.0


def _videos(path: Path, number: np.ndarray, videos: dict[int, _Video]) -> tuple[list[_Video], np.ndarray]:
    """Return the videos that rows are of, and (rows,) their names."""
    used, place = np.unique(number, return_inverse=True)
    unknown = sorted(set(used.tolist()) - set(videos))
    if unknown and videos:
        raise UserError(f"{path}: frames are of video {unknown[0]}, expected one of {sorted(videos)}.")
    found = [videos[one] for one in used.tolist()] if videos else []
    return found, np.array([name for name, *_ in found] or [f"{path.stem} {one}" for one in used])[place]


def _points(
    file: Hdf5, rows: dict[str, np.ndarray], bodies: list[_Body], shift_px: float
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return joint names, keypoints, confidence, and what was assumed of scores."""
    used = np.unique(rows["skeleton"]).tolist()
    names = list(dict.fromkeys(node for body in used for node in bodies[body].nodes))
    size = 64 * len(rows["track"]) * len(names)
    check_memory(file.path, f"points of {len(names):,} nodes", size, file.path.stat().st_size)
    keypoints = np.full((len(rows["track"]), len(names), 2), np.nan, np.float32)
    score = np.zeros(keypoints.shape[:2], np.float32)
    notes: tuple[str, ...] = ()
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
                known, notes = _known_scores(as_float32(points["score"])[place], there)
            keypoints[mine[:, None], columns] = as_float32(xy)
            score[mine[:, None], columns] = np.where(there, known, 0)
    return tuple(names), *visible_only(keypoints, score), notes


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
    alone = len(np.unique(_keys_of(rows)[free])) == len(free)
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


_ROOT = {"frames", "instances", "metadata"}
PROJECT = FileFormat("sleap_slp", "a project of SLEAP", lambda peek: set(peek.hdf5_names) >= _ROOT, _read_project)


# Analysis files (.h5): one array of all frames, tracks and nodes.

_AXES = ("frame", "track", "node", "xy")
_OLD_ORDERS = (("track", "xy", "node", "frame"), ("frame", "node", "xy", "track"), _AXES)
"""Of files that do not say theirs: as SLEAP writes, without its transpose, and as one would expect."""


def _read_analysis(peek: Peek, options: ReadOptions) -> PoseData:
    path = peek.path
    with open_hdf5(path, "an analysis file of SLEAP") as file:
        names = file.texts("node_names")
        if not names or len(set(names)) != len(names):
            raise UserError(f"{path}: 'node_names' holds {names!r}, expected the names of the nodes, each once.")
        stored = file.array("tracks")
        if file.has("frames") and stored.shape[2:] == (len(names), 3):
            raise UserError(f"{path} holds 3D points (sleap-anipose), which cannot be lifted; expected 2D keypoints.")
        order = _axes_of(file, stored.shape, len(names))
        points = as_float32(stored).transpose([order.index(axis) for axis in _AXES])
        score, notes = _scores(file, order, points)
        keypoints, confidence = visible_only(points, score)
        frame, track = np.nonzero(np.any(confidence > 0, axis=-1))
        if not len(frame):
            raise UserError(f"{path}: no visible keypoint in {points.shape[0]:,} frames of {points.shape[1]:,} tracks.")
        tracks, of_tracks = _track_names(file, points.shape[1])
        video = video_name(file.text("video_path")) or video_name(path.stem)
        identity = {"frame": frame, "sequence": np.full(len(frame), video)}
        identity |= {"instance": np.array(tracks)[track]} if tracks else {}
        known = {"identity": identity, "notes": notes + of_tracks, "image_size": _image_size(file)}
        known |= {"bones": _bones(file, names), "mirror": _mirror(file, names)}
        return PoseData(keypoints[frame, track], confidence[frame, track], tuple(names), **known)


def _known_scores(score: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return scores with 1 for points that are ``there`` without one, as those set by hand are, and what was assumed."""
    score = np.where(np.isnan(score), np.float32(1), score)
    if (score[there] > 0).any() or not there.any():
        return score, ()
    return np.ones_like(score), ("all scores are 0: every point that is there counts as certain",)


def _scores(file: Hdf5, order: tuple[str, ...], points: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    if not file.has("point_scores"):
        return np.ones(points.shape[:-1], np.float32), ("no point_scores: every point that is there counts as certain",)
    stored = as_float32(file.array("point_scores"))
    own = _stated_axes(file, "point_scores") or tuple(axis for axis in order if axis != "xy")
    if sorted(own) == sorted(_AXES[:3]) and stored.ndim == 3:
        stored = stored.transpose([own.index(axis) for axis in _AXES[:3]])
    if stored.shape != points.shape[:-1]:
        raise UserError(
            f"{file.path}: 'point_scores' has shape {stored.shape} (frame, track, node), "
            f"expected {points.shape[:-1]} as 'tracks'."
        )
    return _known_scores(stored, np.all(np.isfinite(points), axis=-1))


def _axes_of(file: Hdf5, shape: tuple[int, ...], nodes: int) -> tuple[str, ...]:
    stated = _stated_axes(file, "tracks")
    transposed = file.attribute("", "transpose") in (None, True)
    orders = [stated] if stated else _OLD_ORDERS if transposed else _OLD_ORDERS[1:]
    for order in orders:
        sizes = dict(zip(order, shape, strict=False))
        if len(shape) == 4 and sorted(order) == sorted(_AXES) and sizes["xy"] == 2 and sizes["node"] == nodes:
            return order
    raise UserError(
        f"{file.path}: 'tracks' has shape {shape} with axes {' or '.join(str(order) for order in orders)}, "
        f"expected 2 along 'xy' and {nodes} along 'node', as 'node_names' has."
    )


def _stated_axes(file: Hdf5, name: str) -> tuple[str, ...]:
    dims = file.attribute(name, "dims")
    if dims is None:
        return ()
    raw = from_json(file.path, f"'dims' of '{name}'", str(dims))
    if not isinstance(raw, list) or not set(map(str, raw)) <= set(_AXES):
        raise UserError(f"{file.path}: 'dims' of '{name}' is {dims!r}, expected some order of {', '.join(_AXES)}.")
    return tuple(map(str, raw))


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
    ends: list[str] = []
    if file.has("edge_names"):
        ends = file.texts("edge_names")
    elif file.has("edge_inds"):
        numbers = file.array("edge_inds").ravel().tolist()
        ends = [names[int(n)] if n in range(len(names)) else "" for n in numbers]
    return tuple(pair for pair in zip(ends[::2], ends[1::2], strict=False) if set(pair) <= set(names))


def _mirror(file: Hdf5, names: list[str]) -> tuple[tuple[str, str], ...]:
    raw = file.attribute("", "skeleton_symmetries")
    pairs = from_json(file.path, "'skeleton_symmetries'", str(raw)) if raw is not None else []
    pairs = [pair for pair in pairs if isinstance(pair, list) and len(pair) == 2] if isinstance(pairs, list) else []
    return pairs_of((a, b) for a, b in pairs if a in names and b in names)


def _image_size(file: Hdf5) -> tuple[int, int] | None:
    raw = file.attribute("", "video_backend_metadata")
    video = from_json(file.path, "'video_backend_metadata'", str(raw)) if raw is not None else {}
    return _shown(video)[0] if isinstance(video, dict) else None


def _is_analysis(peek: Peek) -> bool:
    names = set(peek.hdf5_names)
    return {"tracks", "node_names"} <= names and bool({"track_occupancy", "track_names"} & names)


ANALYSIS = FileFormat("sleap_h5", "an analysis file of SLEAP", _is_analysis, _read_analysis)
