"""Writers of predictions: one output format per file, chosen by the file's extension."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from uplift.axes import in_axes
from uplift.errors import UserError, did_you_mean
from uplift.prediction import Prediction
from uplift.writers.parts import parts_of, paths_of

__all__ = ["PAGES", "WRITERS", "Writer", "write", "writer_for"]


@dataclass(frozen=True)
class Writer:
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
    ".html": Writer("uplift.writers.html:write_html", "a page to look at"),
    ".npz": Writer("uplift.writers.npz:write_npz", "arrays, for Python"),
    ".json": Writer("uplift.writers.json_file:write_json", "all of it as text, for any language"),
    ".csv": Writer("uplift.writers.csv:write_csv", "a table, one row a frame and body"),
    ".trc": Writer("uplift.writers.trc:write_trc", "markers, for OpenSim", "opensim", "clip"),
    ".c3d": Writer("uplift.writers.c3d:write_c3d", "points, for biomechanics programs", "opensim", "clip"),
    ".bvh": Writer("uplift.writers.bvh:write_bvh", "a skeleton that moves, for animation", "opensim", "body"),
    ".glb": Writer("uplift.writers.glb:write_glb", "an animated scene, for 3D viewers", "opensim", "clip"),
    ".gif": Writer("uplift.writers.film:write_film", "a short film", "camera", "clip"),
    ".mp4": Writer("uplift.writers.film:write_film", "a film", "camera", "clip"),
}
PAGES = {
    "viewer": WRITERS[".html"],
    "gallery": Writer("uplift.writers.gallery:write_gallery", "poses beside photos"),
}
"""Kinds of ``.html``; the first is written where none is named."""


def writer_for(path: str | Path, page: str | None = None) -> Writer:
    """Return the writer of the extension of ``path``, or of the kind of ``page``; raises UserError where there is none."""
    extension = Path(path).suffix
    if page is not None and page not in PAGES:
        raise UserError(f"page={page}: no such page.{did_you_mean(page, PAGES)}")
    if page is not None and extension.lower() != ".html":
        raise UserError(f"page={page} is an .html, output={path} is not: leave page= out, or name a file .html.")
    if page is not None:
        return PAGES[page]
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

    ``axes`` are those of `uplift.axes`, the format's usual ones where not given; ``page`` is the kind of an
    ``.html``, one of `PAGES`; options go to the writer. A format that holds one clip or one body gets a
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
