"""Writers of predictions: one output format per file, chosen by the file's extension."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from uplift.errors import UserError, did_you_mean
from uplift.prediction import Prediction
from uplift.writers.html import write_html
from uplift.writers.npz import write_npz

__all__ = ["WRITERS", "write", "writer_for"]

WRITERS: dict[str, Callable[..., None]] = {
    ".html": write_html,
    ".npz": write_npz,
}


def writer_for(path: str | Path) -> Callable[..., None]:
    """Return the writer of the extension of ``path``; raises UserError where there is none."""
    extension = Path(path).suffix
    if extension.lower() in WRITERS:
        return WRITERS[extension.lower()]
    valid = ", ".join(sorted(WRITERS))
    if not extension:
        raise UserError(f"output '{path}' has no extension: it chooses the format. Valid: {valid}.")
    near = did_you_mean(extension, WRITERS)
    hint = near if near.startswith(" Did") else ""
    raise UserError(f"output '{path}': no writer for '{extension}'.{hint} Valid: {valid}.")


def write(prediction: Prediction, path: str | Path, **options: Any) -> None:
    """Write ``prediction`` to ``path`` in the format of its extension; options go to that writer.

    The file appears whole or not at all. Raises UserError for an unknown extension or a folder
    that does not exist; OSError (a full disk) propagates after the unfinished file is removed.
    """
    writer_for(path)(prediction, path, **options)
