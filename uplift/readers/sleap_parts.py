"""What the JSON inside a SLEAP project says: its skeletons, videos and tracks."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uplift.errors import UserError
from uplift.readers.hdf5 import Hdf5, from_json
from uplift.readers.tidy import distinct, pairs_of, video_name

__all__ = ["Body", "Video", "bodies_of", "tracks_of", "videos_of"]

_BONE, _MIRROR = 1, 2
"""Kinds of links between nodes, as SLEAP numbers them."""
_WRONG = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True)
class Body:
    """A skeleton of a project."""

    name: str
    nodes: tuple[str, ...]
    """In the order of the points of an instance."""
    bones: tuple[tuple[str, str], ...]
    mirror: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Video:
    """A video of a project."""

    name: str
    image_size: tuple[int, int] | None
    fps: float | None


def bodies_of(file: Hdf5) -> list[Body]:
    """Return the skeletons, in the order that instances count them in.

    Raises:
        UserError: the metadata are not those of a SLEAP project.
    """
    said = file.attribute("metadata", "json")
    if said is None:
        raise UserError(f"{file.path}: no metadata with the names of the nodes, expected in {file.what}.")
    metadata = from_json(file.path, "the metadata", str(said))
    try:
        names = [_clean(node["name"]) for node in metadata["nodes"]]
        bodies = [_body(skeleton.get("nx_graph", skeleton), names) for skeleton in metadata["skeletons"]]
    except _WRONG as error:
        raise UserError(
            f"{file.path}: the skeletons in the metadata are not as SLEAP writes them ({error!r})."
        ) from error
    for body in bodies:
        if not body.nodes or len(set(body.nodes)) != len(body.nodes):
            raise UserError(f"{file.path}: skeleton '{body.name}' has nodes {body.nodes!r}, expected each name once.")
    return bodies


def _body(graph: dict[str, Any], names: list[str]) -> Body:
    ids = [int(node["id"]) for node in graph["nodes"]]
    if min(ids, default=0) < 0:
        raise ValueError("a node of negative number")
    name_of = {number: names[number] for number in ids}
    ends: dict[int, list[tuple[str, str]]] = {_BONE: [], _MIRROR: []}
    kinds: dict[int, int] = {}  # the first mention of a kind spells it out, later ones point back to it
    for link in graph["links"]:
        said = link["type"]
        if "py/reduce" in said:
            kind = int(said["py/reduce"][1]["py/tuple"][0])
            kinds[len(kinds) + 1] = kind
        else:
            back = int(said["py/id"])
            kind = kinds.get(back, back)
        ends[kind].append((name_of[int(link["source"])], name_of[int(link["target"])]))
    title = _clean(graph.get("graph", {}).get("name") or "")
    return Body(title, tuple(name_of[n] for n in ids), tuple(dict.fromkeys(ends[_BONE])), pairs_of(ends[_MIRROR]))


def tracks_of(file: Hdf5) -> list[str]:
    """Return the names of the tracks, made distinct."""
    said = file.texts("tracks_json") if file.has("tracks_json") else []
    found = [from_json(file.path, f"entry {place} of 'tracks_json'", text) for place, text in enumerate(said)]
    try:
        return distinct(_clean(entry[1]) for entry in found)
    except _WRONG as error:
        raise UserError(f"{file.path}: 'tracks_json' is not as SLEAP writes it ({error!r}).") from error


def videos_of(file: Hdf5) -> dict[int, Video]:
    """Return the videos by the numbers that frames give them, their names made distinct.

    Frames number videos by their place, or, of a project with pictures inside, by those groups.
    """
    said = file.texts("videos_json") if file.has("videos_json") else []
    entries = [from_json(file.path, f"entry {place} of 'videos_json'", text) for place, text in enumerate(said)]
    cropped = file.has("video_crops")  # then the file's size is not that of the picture that was tracked
    used = np.unique(file.table("frames", ("video",))["video"]).tolist()
    by_place = used == list(range(len(entries)))
    found = {}
    try:
        names = _names([_source(file, entry) for entry in entries])
        for place, (entry, name) in enumerate(zip(entries, names, strict=True)):
            inside = re.match(r"video(\d{1,9})/", str(entry["backend"].get("dataset") or ""))
            size, fps = _shown(entry["backend"])
            found[int(inside[1]) if inside and not by_place else place] = Video(name, None if cropped else size, fps)
    except _WRONG as error:
        raise UserError(f"{file.path}: 'videos_json' is not as SLEAP writes it ({error!r}).") from error
    return found


def _names(paths: list[str]) -> list[str]:
    """Return a name for each video, with its folder where several videos have one name."""
    names = [video_name(path) for path in paths]
    count = Counter(names)
    folders = [re.split(r"[\\/]", path)[-2:-1] for path in paths]
    return distinct(
        "/".join([*folder, name]) if count[name] > 1 else name for name, folder in zip(names, folders, strict=True)
    )


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
        said = file.texts(f"{source}/json")[0] if file.has(f"{source}/json") else file.attribute(source, "json")
        above = from_json(file.path, f"the source of {group}", str(said))
        path = str(above["backend"].get("filename") or above.get("filename") or ".")
    return _clean(path if path != "." else f"{Path(file.path).stem}_{group}" if group else Path(file.path).stem)


def _shown(backend: dict[str, Any]) -> tuple[tuple[int, int] | None, float | None]:
    """Return the size of the pictures and the frames a second, where the project says them."""
    shape, fps = backend.get("shape"), backend.get("fps")
    size = (shape[2], shape[1]) if isinstance(shape, list) and len(shape) == 4 else None
    if size is None:
        size = (backend.get("width_"), backend.get("height_"))
    known = all(isinstance(n, int) and 0 < n < 1_000_000 for n in size)
    right = isinstance(fps, (int, float)) and 0 < fps < 100_000
    return (int(size[0]), int(size[1])) if known else None, float(fps) if right else None  # type: ignore[arg-type]


def _clean(text: Any) -> str:
    return str(text).encode(errors="replace").decode()
