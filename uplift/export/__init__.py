"""Write predictions: one output format per file, chosen by the ending of its name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from uplift.errors import UserError, did_you_mean
from uplift.export.clips import parts_of, paths_of
from uplift.export.meshes import Frame, check_axes, prediction_surfaces
from uplift.export.scene import in_axes
from uplift.geometry.surface import Surface
from uplift.models.prediction import Prediction, ShapePrediction

__all__ = ["SHAPE_WRITERS", "WRITERS", "shape_writer_for", "write", "write_shapes", "writer_for"]

# Writers of lifted shapes: one output format per file, chosen by the file's extension.

_MOST_FILES = 500
_MOST_TOGETHER = 16
"""Items that one scene shows side by side where nothing is said."""
_UNITS = ("px", "mm", "crop")


@dataclass(frozen=True)
class _ShapeWriter:
    """A format that lifted shapes are written in."""

    where: str
    """module:function of the writer."""
    about: str
    """What it is, in a few words."""
    axes: str = "own"
    """The axes it is written in where none are asked for."""
    holds: str = "all"
    """What one file holds: ``all`` items, one ``item``, or a ``scene`` of a few items or one."""

    def __call__(self, *arguments: Any, **options: Any) -> str:
        """Write what one file holds; returns what there is to say of it, mostly nothing."""
        module, _, name = self.where.partition(":")
        return str(getattr(import_module(module), name)(*arguments, **options) or "")


SHAPE_WRITERS = {
    ".html": _ShapeWriter("uplift.export.shape_page:write_shape_page", "a page to look at"),
    ".glb": _ShapeWriter("uplift.export.meshes:write_glb", "meshes, for 3D viewers", "gltf", "scene"),
    ".obj": _ShapeWriter("uplift.export.meshes:write_obj", "a mesh, for any 3D program", "gltf", "item"),
    ".ply": _ShapeWriter("uplift.export.meshes:write_ply", "a mesh where the camera saw it", "camera", "item"),
    ".stl": _ShapeWriter("uplift.export.meshes:write_stl", "a mesh, for printing", "print", "item"),
    ".npz": _ShapeWriter("uplift.export.meshes:write_npz", "occupancy grids, for Python"),
}
_SHAPE_PAGES = {
    "viewer": SHAPE_WRITERS[".html"],
    "gallery": _ShapeWriter("uplift.export.shape_page:write_shape_gallery", "the same page, all items first"),
}
"""Kinds of ``.html``; the first is written where none is named."""


def shape_writer_for(path: str | Path, page: str | None = None) -> _ShapeWriter:
    """Return the writer of the extension of ``path``, or of the kind of ``page``; raises UserError where there is none."""
    extension = Path(path).suffix.lower()
    if page is not None and page not in _SHAPE_PAGES:
        raise UserError(f"page={page}: no such page.{did_you_mean(page, _SHAPE_PAGES)}")
    if page is not None and extension != ".html":
        raise UserError(f"page={page} is an .html, output={path} is not: leave page= out, or name a file .html.")
    if page is not None:
        return _SHAPE_PAGES[page]
    if extension in SHAPE_WRITERS:
        return SHAPE_WRITERS[extension]
    valid = ", ".join(sorted(SHAPE_WRITERS))
    if not extension:
        raise UserError(f"output '{path}' has no extension: it chooses the format. Valid for shapes: {valid}.")
    raise UserError(f"output '{path}': no writer of shapes for '{extension}'. Valid: {valid}.")


def write_shapes(
    prediction: ShapePrediction,
    path: str | Path,
    page: str | None = None,
    axes: str | None = None,
    unit: str | None = None,
    height_mm: float | int | None = None,
    length_mm: float | int | None = None,
    smooth: int = 4,
    together: bool | None = None,
    **options: Any,
) -> dict[Path, str]:
    """Write lifted shapes in the format of the extension of ``path``; return the files and a word on each.

    ``axes`` are those of `SHAPE_AXES`, the format's usual ones where not given. ``unit`` is ``px`` of the photo,
    ``crop`` (half the side of a mask's crop), or ``mm`` where ``height_mm`` or ``length_mm`` says how large
    every object is. ``smooth`` rounds of smoothing leave the volume as it is. A format that holds one item
    gets a file for each, named behind the stem of ``path``; a ``.glb`` shows up to 16 side by side, or as
    ``together`` says. Options go to the writer of a page. Files appear whole or not at all.

    Raises:
        UserError: an unknown extension, page, axes or unit, a size that is none, no item with a surface, too
            many files, a file that exists.
    """
    writer = shape_writer_for(path, page)
    frame = _frame(writer, path, axes, unit, height_mm, length_mm)
    if writer.holds == "all":
        _refuse_existing([Path(path)])
        return {Path(path): writer(prediction, path, **options)}
    if options:
        raise UserError(f"{next(iter(options))}= is for a page (.html), not for {Path(path).suffix}.")
    cut = prediction_surfaces(prediction, smooth=smooth)
    parts = _parts(cut, writer.holds, together)
    paths = paths_of(path, [prediction.names[part[0]] for part in parts])
    _refuse_existing(paths)
    told = {
        file: writer(prediction, part, [cut[item] for item in part], frame, file)
        for file, part in zip(paths, parts, strict=True)
    }
    return _with_left_out(told, prediction, cut)


def _frame(
    writer: _ShapeWriter,
    path: str | Path,
    axes: str | None,
    unit: str | None,
    height_mm: float | int | None,
    length_mm: float | int | None,
) -> Frame:
    """Return axes and unit as they were asked for, or raise UserError."""
    sizes = {"height_mm": height_mm, "length_mm": length_mm}
    given = {name: float(value) for name, value in sizes.items() if value is not None}
    asked = [name for name, value in {"axes": axes, "unit": unit, **given}.items() if value is not None]
    if writer.holds == "all" and asked:
        raise UserError(f"{asked[0]}= goes with the formats of meshes (.glb .obj .ply .stl), not with {path}.")
    for name, value in given.items():
        if not (np.isfinite(value) and value > 0):
            raise UserError(f"{name}={value:g}: expected how large each object is, more than 0 mm.")
    if len(given) > 1:
        raise UserError("height_mm= and length_mm= both say how large an object is: give one.")
    if unit is not None and unit not in _UNITS:
        raise UserError(f"unit={unit}: no such unit.{did_you_mean(unit, _UNITS)}")
    if unit == "mm" and not given:
        raise UserError("unit=mm: a mask does not tell how large its object is. Add height_mm= or length_mm=.")
    if given and unit not in (None, "mm"):
        raise UserError(f"unit={unit} and {next(iter(given))}= do not go together: a size makes the unit mm.")
    return Frame(check_axes(axes or writer.axes), "mm" if given else unit or "px", **given)


def _parts(cut: Sequence[Surface], holds: str, together: bool | None) -> list[list[int]]:
    """Return which items go into each file; raises UserError for no surface at all, or too many files."""
    there = [item for item, one in enumerate(cut) if one.mesh is not None]
    if not there:
        why = cut[0].reason if cut else "the prediction has no items"
        raise UserError(f"there is no surface to write: {why}. Nothing was lifted, or level= is too high.")
    if together and holds != "scene":
        raise UserError("together=true puts several shapes into one .glb; other formats hold one each.")
    if holds == "scene" and (together or (together is None and len(there) <= _MOST_TOGETHER)):
        return [there]
    if len(there) > _MOST_FILES:
        raise UserError(
            f"{len(there):,} shapes would be as many files; the most is {_MOST_FILES}. Give fewer masks at a time, "
            "write a .glb with together=true, or .npz."
        )
    return [[item] for item in there]


def _refuse_existing(paths: Sequence[Path]) -> None:
    for one in paths:
        if one.exists():
            raise UserError(f"{one} exists already and is not overwritten: remove it or choose another name.")


def _with_left_out(told: dict[Path, str], prediction: ShapePrediction, cut: Sequence[Surface]) -> dict[Path, str]:
    """Return the words with those of items that have no surface behind the first."""
    gone = [f"{name} ({one.reason})" for name, one in zip(prediction.names, cut, strict=True) if one.mesh is None]
    if gone:
        first = next(iter(told))
        more = f" and {len(gone) - 3} more" if len(gone) > 3 else ""
        told[first] = "; ".join(filter(None, [told[first], f"without a surface: {', '.join(gone[:3])}{more}"]))
    return told


# Writers of predictions: one output format per file, chosen by the file's extension.


@dataclass(frozen=True)
class _Writer:
    """A format that predictions are written in."""

    where: str
    """module:function of the writer, which takes a prediction and a path."""
    about: str
    """What it is, in a few words."""
    axes: str = "camera"
    """The axes it is written in where none are asked for."""
    holds: str = "all"
    """What one file holds: ``all`` rows, one ``clip``, or one ``body`` of one clip."""

    def __call__(self, prediction: Prediction, path: str | Path, **options: Any) -> str:
        """Write what one file holds; returns what there is to say of it, mostly nothing."""
        module, _, name = self.where.partition(":")
        return str(getattr(import_module(module), name)(prediction, path, **options) or "")


WRITERS = {
    ".html": _Writer("uplift.export.page:write_html", "a page to look at"),
    ".npz": _Writer("uplift.export.tables:write_npz", "arrays, for Python"),
    ".json": _Writer("uplift.export.tables:write_json", "all of it as text, for any language"),
    ".csv": _Writer("uplift.export.tables:write_csv", "a table, one row a frame and body"),
    ".trc": _Writer("uplift.export.markers:write_trc", "markers, for OpenSim", "opensim", "clip"),
    ".c3d": _Writer("uplift.export.markers:write_c3d", "points, for biomechanics programs", "opensim", "clip"),
    ".bvh": _Writer("uplift.export.bvh:write_bvh", "a skeleton that moves, for animation", "opensim", "body"),
    ".glb": _Writer("uplift.export.glb:write_glb", "an animated scene, for 3D viewers", "opensim", "clip"),
    ".gif": _Writer("uplift.export.film:write_film", "a short film", "camera", "clip"),
    ".mp4": _Writer("uplift.export.film:write_film", "a film", "camera", "clip"),
}
_PAGES = {
    "viewer": WRITERS[".html"],
    "gallery": _Writer("uplift.export.gallery:write_gallery", "poses beside photos"),
}
"""Kinds of ``.html``; the first is written where none is named."""


def writer_for(path: str | Path, page: str | None = None) -> _Writer:
    """Return the writer of the extension of ``path``, or of the kind of ``page``; raises UserError where there is none."""
    extension = Path(path).suffix
    if page is not None and page not in _PAGES:
        raise UserError(f"page={page}: no such page.{did_you_mean(page, _PAGES)}")
    if page is not None and extension.lower() != ".html":
        raise UserError(f"page={page} is an .html, output={path} is not: leave page= out, or name a file .html.")
    if page is not None:
        return _PAGES[page]
    if extension.lower() in WRITERS:
        return WRITERS[extension.lower()]
    valid = ", ".join(sorted(WRITERS))
    if not extension:
        raise UserError(f"output '{path}' has no extension: it chooses the format. Valid: {valid}.")
    near = did_you_mean(extension, WRITERS)
    hint = near if near.startswith(" Did") else ""
    raise UserError(f"output '{path}': no writer for '{extension}'.{hint} Valid: {valid}.")


def write(
    prediction: Prediction, path: str | Path, page: str | None = None, axes: str | None = None, **options: Any
) -> dict[Path, str]:
    """Write ``prediction`` in the format of the extension of ``path``; return the files that were written and a word on each.

    ``axes`` are those of `uplift.export.scene`, the format's usual ones where not given; ``page`` is the kind of an
    ``.html``, one of `_PAGES`; options go to the writer. A format that holds one clip or one body gets a
    file for each, named behind the stem of ``path``. Files appear whole or not at all. Raises UserError for
    an unknown extension, page or axes, a folder that does not exist, or where one of several files exists;
    OSError (a full disk) propagates after the unfinished file is removed.
    """
    writer = writer_for(path, page)
    axes = axes or writer.axes
    if Path(path).suffix.lower() == ".html" and axes not in ("camera", "opencv"):
        raise UserError(f"axes={axes}: a page turns poses itself; axes go with the other formats.")
    turned = in_axes(prediction, axes) if axes != prediction.axes else prediction
    parts = parts_of(turned, writer.holds)
    paths = paths_of(path, [name for name, _ in parts])
    return {
        part: writer(turned if rows is None else turned.select(rows), part, **options)
        for part, (_, rows) in zip(paths, parts, strict=True)
    }
