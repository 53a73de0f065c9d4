"""Which file the weights of a run are in, and what they lift."""

from __future__ import annotations

from pathlib import Path

from uplift.errors import UserError
from uplift.run import RunFolder
from uplift.torch_file import read_torch

__all__ = ["lifts_masks", "weights_of"]


def weights_of(run: str | Path) -> Path:
    """Return the ``lifter.pt`` of a run (its folder, or runs/<task>/last), or the file itself.

    Raises:
        UserError: no such run, or one that has no weights yet.
    """
    path = Path(run)
    if path.is_file():
        return path
    folder = RunFolder.open(path)
    if not folder.weights.is_file():
        raise UserError(
            f"{folder.path} has no lifter.pt yet: its fit was ended early. `uplift fit resume={folder.path}` finishes it."
        )
    return folder.weights


def lifts_masks(run: str | Path) -> bool:
    """Return whether a run or a ``lifter.pt`` lifts masks; False where there is none: whoever opens it says so."""
    path = Path(run)
    try:
        if path.is_file():
            return read_torch(path, "lifter").get("lifts") == "masks"
        return RunFolder.open(path).settings().lifts == "masks"
    except UserError:
        return False
