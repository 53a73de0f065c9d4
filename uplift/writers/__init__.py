"""Writers of predictions: one output format per file, chosen by the file's extension."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from uplift.errors import UserError, did_you_mean
from uplift.prediction import Prediction
from uplift.writers.gallery import write_gallery
from uplift.writers.html import write_html
from uplift.writers.npz import write_npz

__all__ = ["PAGES", "WRITERS", "write", "writer_for"]

WRITERS: dict[str, Callable[..., None]] = {
    ".html": write_html,
    ".npz": write_npz,
}
PAGES: dict[str, Callable[..., None]] = {
    "viewer": write_html,
    "gallery": write_gallery,
}
"""Kinds of ``.html``; the first is written where none is named."""


def writer_for(path: str | Path, page: str | None = None) -> Callable[..., None]:
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


def write(prediction: Prediction, path: str | Path, page: str | None = None, **options: Any) -> None:
    """Write ``prediction`` to ``path`` in the format of its extension; options go to that writer.

    ``page`` is the kind of an ``.html``, one of `PAGES`. The file appears whole or not at all. Raises UserError
    for an unknown extension or page, or a folder that does not exist; OSError (a full disk) propagates after
    the unfinished file is removed.
    """
    writer_for(path, page)(prediction, path, **options)
