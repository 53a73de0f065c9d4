"""Files of tensors and plain data: written whole or not at all, read without running anything."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from uplift.errors import UserError
from uplift.saving import replacing

__all__ = ["read_torch", "save_torch"]


def save_torch(state: dict[str, Any], path: Path) -> None:
    """Write tensors and plain data to ``path``, whole or not at all."""
    import torch

    try:
        with replacing(path) as file:
            torch.save(state, file)
    except RuntimeError as error:
        # torch's own writer turns a full disk into a RuntimeError.
        if isinstance(error.__context__, OSError):
            raise error.__context__ from error
        raise OSError(f"cannot write {path}: {error}") from error


def read_torch(path: Path, kind: str) -> dict[str, Any]:
    """Read tensors and plain data; nothing in the file can run.

    Raises:
        UserError: not there, not such a file, damaged, or holding anything but plain data.
    """
    import torch

    if not path.is_file():
        raise UserError(f"No {kind} {path}.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a file that is no checkpoint makes torch think aloud
            state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a dozen kinds for a file that is not one of its own
        reason = str(error).strip().splitlines()[0][:200] if str(error) else type(error).__name__
        raise UserError(
            f"{path} is no {kind} that can be read: damaged, or holding more than tensors and plain data, "
            f"which is never opened ({reason})."
        ) from error
    if not isinstance(state, dict):
        raise UserError(f"{path} is no {kind}: found {type(state).__name__}, expected what `uplift fit` writes.")
    return state
