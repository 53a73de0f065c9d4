"""Write poses and shapes: one output format per file, chosen by the ending of its name."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uplift.config.files import refuse_existing
from uplift.errors import UserError, did_you_mean, nearest
from uplift.export.clips import MOST_FILES, arrange
from uplift.export.scene import AXES, in_axes
from uplift.export.stream import Stream
from uplift.export.tables import unique
from uplift.models.prediction import Prediction, ShapePrediction
from uplift.skeleton import Skeleton

__all__ = [
    "MEASURES", "PAGES", "WRITERS", "Job", "Part", "Writer", "check_axes", "check_library", "check_measure", "ending_of", "open_stream", "parts_of", "paths_of",
    "write", "writer_for",
]  # fmt: skip


@dataclass(frozen=True)
class Writer:
    """A format that poses or shapes are written in."""

    where: str
    """module:function of the writer."""
    about: str
    """What the format is, in a few words."""
    axes: str = "camera"
    """The axes it is written in by default."""
    holds: str = "all"
    """What one file holds: ``all``; of poses one ``clip``, or one ``body`` of one; of shapes an ``item`` or a ``scene`` of a few."""
    extra: str = ""
    """What brings the libraries that it needs beside the package's own: ``pip install "uplift3d[EXTRA]"``."""
    needs: tuple[str, ...] = ()
    """The modules of those."""
    stream: str = ""
    """module:class of the `uplift.export.stream.Stream` that writes it part by part, where it can grow."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Write one file and return a remark on it, if any; the formats of meshes return the file's bytes."""
        return _named(self.where)(*arguments, **options)


def _named(where: str) -> Any:
    """Return the function or class called module:name."""
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)


WRITERS = {
    "poses": {
        ".html": Writer("uplift.export.page:write_html", "a page to look at"),
        ".npz": Writer("uplift.export.tables:write_npz", "arrays, for Python", stream="uplift.export.tables:NpzStream"),
        ".json": Writer(
            "uplift.export.tables:write_json",
            "all of it as text, for any language",
            stream="uplift.export.tables:JsonStream",
        ),
        ".csv": Writer(
            "uplift.export.tables:write_csv",
            "a table, one row a frame and body",
            stream="uplift.export.tables:CsvStream",
        ),
        ".trc": Writer("uplift.export.markers:write_trc", "markers, for OpenSim", "opensim", "body"),
        ".osim": Writer(
            "uplift.export.osim:write_opensim",
            "a scaled model with inverse kinematics, OpenSim",
            "opensim",
            "body",
            "opensim",
            ("opensim",),
        ),
        ".c3d": Writer(
            "uplift.export.markers:write_c3d", "points, for biomechanics programs", "opensim", "body", "c3d", ("ezc3d",)
        ),
        ".bvh": Writer("uplift.export.bvh:write_bvh", "a skeleton that moves, for animation", "opensim", "body"),
        ".glb": Writer("uplift.export.glb:write_glb", "an animated scene, for 3D viewers", "opensim", "clip"),
        ".gif": Writer("uplift.export.film:write_film", "a short film", "camera", "clip"),
        ".mp4": Writer("uplift.export.film:write_film", "a film", "camera", "clip", "video", ("av",)),
        ".nwb": Writer(
            "uplift.export.nwb:write_nwb",
            "Neurodata Without Borders, with ndx-pose",
            "camera",
            "clip",
            "nwb",
            ("pynwb", "ndx_pose"),
        ),
        ".nc": Writer(
            "uplift.export.netcdf:write_netcdf",
            "netCDF, for xarray and movement",
            "camera",
            "clip",
            "xarray",
            ("xarray", "h5netcdf", "h5py"),
        ),
        ".dlc.csv": Writer("uplift.export.trackers:write_dlc_csv", "3D of DeepLabCut", "camera", "clip"),
        ".dlc.h5": Writer(
            "uplift.export.trackers:write_dlc_h5", "3D of DeepLabCut", "camera", "clip", "dlc", ("tables",)
        ),
        ".sleap.h5": Writer(
            "uplift.export.trackers:write_sleap", "3D of sleap-anipose", "camera", "clip", "trackers", ("h5py",)
        ),
        ".anipose.csv": Writer("uplift.export.trackers:write_anipose", "3D of Anipose", "camera", "body"),
        ".blend.py": Writer("uplift.export.blender:write_blender", "a script that Blender runs", "blender", "clip"),
        ".usda": Writer(
            "uplift.export.usd:write_usd", "USD as text, for film and simulation", "opensim", "clip", "usd", ("pxr",)
        ),
        ".usdc": Writer("uplift.export.usd:write_usd", "USD", "opensim", "clip", "usd", ("pxr",)),
    },
    "shapes": {
        ".html": Writer("uplift.export.shape_page:write_shape_page", "a page to look at", "own"),
        ".glb": Writer("uplift.export.meshes:encode_glb", "meshes, for 3D viewers", "gltf", "scene"),
        ".obj": Writer("uplift.export.meshes:encode_obj", "a mesh, for any 3D program", "gltf", "item"),
        ".ply": Writer("uplift.export.meshes:encode_ply", "a mesh where the camera saw it", "camera", "item"),
        ".stl": Writer("uplift.export.meshes:encode_stl", "a mesh, for printing", "print", "item"),
        ".npz": Writer("uplift.export.meshes:write_npz", "occupancy grids, for Python", "own"),
        ".csv": Writer("uplift.export.shape_views:write_views_csv", "a table of views, one row a mask", "own"),
        ".json": Writer("uplift.export.shape_views:write_views_json", "views as text, for any language", "own"),
    },
}
MEASURES = {
    "angles.csv": Writer(
        "uplift.export.measures:write_angles_csv",
        "joint angles, a row a frame and body",
        stream="uplift.export.measures:AnglesStream",
    ),
    "gait.csv": Writer(
        "uplift.export.measures:write_gait_csv",
        "gait, a row a stride, with mean and sd",
        stream="uplift.export.measures:GaitStream",
    ),
    ".mot": Writer("uplift.export.measures:write_mot", "joint angles, for OpenSim", holds="body"),
}
"""What is measured of poses: by the ending, or by the last word of the name before it, as in ``walk_angles.csv``."""
PAGES = {
    "poses": {
        "viewer": WRITERS["poses"][".html"],
        "gallery": Writer("uplift.export.gallery:write_gallery", "poses beside photos"),
    },
    "shapes": {
        "viewer": WRITERS["shapes"][".html"],
        "gallery": Writer("uplift.export.shape_page:write_shape_gallery", "the same page, all items first", "own"),
    },
}
"""Kinds of ``.html``; the first is the default."""


def ending_of(path: str | Path, of: str = "poses") -> str:
    """Return the ending of ``path`` that chooses the format, in small letters: the longest that there is a writer for, else the last part."""
    name = Path(path).name.lower()
    found = [ending for ending in WRITERS[of] if name.endswith(ending) and name != ending]
    return max(found, key=len, default=Path(name).suffix)


def writer_for(path: str | Path, page: str | None = None, of: str = "poses") -> Writer:
    """Return the writer for the extension of ``path`` or the kind of ``page``; raises UserError for an unknown one."""
    extension, writers = ending_of(path, of), WRITERS[of]
    if page is not None:
        if page not in PAGES[of]:
            raise UserError(f"page={page}: no such page.{did_you_mean(page, PAGES[of])}")
        if extension != ".html":
            raise UserError(f"page={page} is an .html, output={path} is not: leave page= out, or name a file .html.")
        return PAGES[of][page]
    if of == "poses" and (measured := MEASURES.get(_last_word(path) + extension) or MEASURES.get(extension)):
        return measured
    if extension in writers:
        return writers[extension]
    valid = ", ".join([*sorted(writers), *(MEASURES if of == "poses" else ())])
    if not extension:
        raise UserError(f"output '{path}' has no extension: it chooses the format. Valid for {of}: {valid}.")
    longer = [ending for ending in writers if ending.endswith(extension)]
    if longer:
        several = " or ".join(f"{Path(path).stem}{ending}" for ending in longer)
        raise UserError(f"output '{path}': there is more than one kind of '{extension}'. Name it {several}.")
    hint = nearest(extension, writers)
    raise UserError(f"output '{path}': no writer of {of} for '{Path(path).suffix}'.{hint} Valid: {valid}.")


def _last_word(path: str | Path) -> str:
    """Return the last word of a file's name before its ending."""
    return re.split(r"[^a-z]+", Path(path).stem.lower())[-1]


def write(
    prediction: Prediction | ShapePrediction,
    path: str | Path,
    page: str | None = None,
    axes: str | None = None,
    **options: Any,
) -> dict[Path, str]:
    """Write poses or shapes in the format of the extension of ``path``; return the files and a remark on each.

    ``page`` is the kind of an ``.html``, one of `PAGES`. ``axes`` are those of `uplift.export.scene`, of shapes those
    of `uplift.export.meshes.SHAPE_AXES`; the format's usual ones by default. Options go to the writer. A format that
    holds one clip, body or item gets a file for each, named behind the stem of ``path``. A file is
    complete or absent, and of several there are all or none.

    Of poses, ``angles.csv`` and ``gait.csv`` (also behind other words: ``walk_angles.csv``) are tables of `MEASURES`.

    Of shapes, ``unit`` is ``px`` of the photo, ``crop`` (half the side of a mask's crop), or ``mm`` where ``height_mm``
    or ``length_mm`` gives the size of every object. ``smooth`` rounds of smoothing leave the volume as it is. A
    ``.glb`` shows up to 16 side by side, or as ``together`` says.

    Raises:
        UserError: an unknown extension, page, axes or unit, a library of the format that is not installed, an invalid size, no surface to write, too many files, a
            folder that does not exist, or a file that exists, of shapes or one of several.
        OSError: a full disk, for example; the unfinished file is removed.
    """
    if isinstance(prediction, Prediction):
        check_library(path, page)
        jobs = _pose_jobs(prediction, writer_for(path, page), path, axes, **options)
    else:
        from uplift.export.meshes import shape_jobs  # what it imports is slow, and poses do not need it

        jobs = shape_jobs(prediction, writer_for(path, page, "shapes"), path, axes, **options)
    paths = paths_of(path, [name for name, _ in jobs])
    files: dict[Path, str] = {}
    try:
        for file, (_, job) in zip(paths, jobs, strict=True):
            files[file] = job(file)
    except BaseException:  # all of them or none
        for file in files:
            file.unlink(missing_ok=True)
        raise
    return files


def open_stream(path: str | Path, page: str | None = None, axes: str | None = None, **options: Any) -> Stream:
    """Return a file of poses that grows part by part: ``append`` a `Prediction` of whole clips to it, and ``close`` it.

    It is a context manager, and the file appears at its end, the one that `write` makes of all parts at once; an error
    inside leaves no file (`uplift.export.stream.Stream`). ``page``, ``axes`` and the options are those of `write`.

    Raises:
        UserError: a format that is written as a whole, and as `write`.
    """
    check_library(path, page)
    writer = writer_for(path, page)
    if not writer.stream:
        growing = [name for name, one in (WRITERS["poses"] | MEASURES).items() if one.stream]
        raise UserError(
            f"output={path}: a {ending_of(path)} is written as a whole, and cannot grow part by part. Formats that can: "
            f"{', '.join(growing)}."
        )
    axes = axes or writer.axes
    check_axes(path, axes)
    return _named(writer.stream)(path, axes, **options)


Job = tuple[str, Callable[[Path], str]]
"""A name for a file of its own, and what writes it and returns a remark."""


def paths_of(path: str | Path, names: Sequence[str]) -> list[Path]:
    """Return ``path`` for one name, else ``path`` with each name appended to its stem; raises UserError if one exists."""
    path = Path(path)
    if len(names) == 1:
        return [path]
    slugs = [
        re.sub(r"[^\w.-]+", "-", name).encode()[:80].decode(errors="ignore").strip("-.") or "part" for name in names
    ]
    stem = path.name[: len(path.name) - len(ending_of(path))]
    # Some file systems do not tell capitals apart.
    paths = [path.with_name(f"{stem}_{slug}{path.name[len(stem) :]}") for slug in unique(slugs, str.lower)]
    for one in paths:
        refuse_existing(one)
    return paths


# Poses: a file for all rows, for each clip, or for each body of a clip.


def _pose_jobs(prediction: Prediction, writer: Writer, path: str | Path, axes: str | None, **options: Any) -> list[Job]:
    axes = axes or writer.axes
    check_axes(path, axes)
    if writer.holds != "all" and not len(prediction):
        raise UserError(f"cannot write {path}: the prediction is empty. Check the input file.")
    turned = in_axes(prediction, axes) if axes != prediction.axes else prediction

    parts, ghosts = parts_of(turned, writer.holds)
    if "video" in options and len(parts) > 1:
        options["alone"] = False
    gone = f"{', '.join(ghosts[:3])}{', ...' if len(ghosts) > 3 else ''}"
    left_out = f"no file for {len(ghosts)} bodies that are in one frame of a clip alone ({gone})" if ghosts else ""

    def job(part: Part, file: Path) -> str:
        which = {} if part.individual is None else {"individual": part.individual}
        remark = writer(turned if part.rows is None else turned.select(part.rows), file, **which, **options)
        return "; ".join(filter(None, [str(remark or ""), left_out if part is parts[0] else ""]))

    return [(part.name, partial(job, part)) for part in parts]


def check_axes(path: str | Path, axes: str | None) -> None:
    """Raise UserError for axes that a format of poses cannot be written in."""
    ending = ending_of(path)
    if axes is None:
        return
    if path and axes != "camera" and writer_for(path) in MEASURES.values():
        raise UserError(f"axes={axes}: angles and gait are the same in all axes: leave axes= out, or write poses.")
    if axes not in AXES:
        raise UserError(f"axes={axes}: no such axes.{did_you_mean(axes, AXES)}")
    if ending == ".html" and axes not in ("camera", "opencv"):
        raise UserError(f"axes={axes}: a page turns poses itself; axes go with the other formats.")
    if ending == ".osim" and axes != "opensim":
        raise UserError(f"axes={axes}: a model of OpenSim stands with y up, axes=opensim; leave axes= out.")
    if axes == "unity" and ending in (".glb", ".bvh", ".usda", ".usdc", ".blend.py"):
        raise UserError(
            f"axes=unity is left-handed, and a {ending} is right-handed wherever it is read: Unity's importers turn it "
            "themselves. Leave axes= out."
        )


def check_library(path: str | Path, page: str | None = None) -> None:
    """Raise UserError where a library that writes ``path`` is not installed; nothing is imported."""
    writer = writer_for(path, page)
    absent = [module for module in writer.needs if not _is_there(module)]
    if absent:
        instead = " A .gif needs nothing more." if ending_of(path) == ".mp4" else ""
        raise UserError(
            f'{path}: writing {ending_of(path)} needs {" and ".join(absent)}: pip install "uplift3d[{writer.extra}]".{instead}'
        )


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ValueError:  # a module that was put in place by hand
        return sys.modules.get(module) is not None


def check_measure(path: str | Path, skeleton: Skeleton) -> None:
    """Raise UserError for an output that measures what this skeleton does not name; nothing where it holds poses."""
    writer = writer_for(path) if Path(path).suffix.lower() != ".html" else None
    if writer in MEASURES.values():
        from uplift.export.measures import check_skeleton  # its imports take time

        check_skeleton(skeleton, path)


class Part(NamedTuple):
    """What goes into one file."""

    name: str
    rows: np.ndarray | None = None
    """None for all."""
    individual: str | None = None
    """Which of several that the rows show."""


def parts_of(prediction: Prediction, holds: str) -> tuple[list[Part], list[str]]:
    """Return what each file has: all rows, a clip, or a body of a clip; and the bodies that get none.

    These are lifted in one frame of a clip, or none, in which others are lifted in more: one frame is no motion, but
    mostly a ghost of the tracker's. Raises UserError for too many files.
    """
    if holds == "all":
        return [Part("")], []
    parts: list[Part] = []
    ghosts: list[str] = []
    for clip in arrange(prediction.identity, len(prediction)):
        rows, names = np.sort(clip.rows) if len(clip.rows) < len(prediction) else None, clip.individual_names
        if holds == "clip" or len(names) == 1:
            parts.append(Part(clip.name if holds == "clip" else f"{clip.name} {names[0]}".strip(), rows))
            continue
        lifted = np.any(np.isfinite(prediction.pose[clip.rows]).all(-1), axis=1)
        frames = np.bincount(clip.individual[lifted], minlength=len(names))
        least = min(2, int(frames.max()))
        for name, count in zip(names, frames.tolist(), strict=True):
            if count >= least:
                parts.append(Part(f"{clip.name} {name}".strip(), rows, name))
            else:
                ghosts.append(name)
    if len(parts) > MOST_FILES:
        raise UserError(
            f"the prediction has {len(parts):,} {'clips' if holds == 'clip' else 'bodies'}, and this format needs a file "
            f"for each; the most is {MOST_FILES}. Give fewer files at a time, or write .npz, .json or .csv."
        )
    return parts, ghosts
