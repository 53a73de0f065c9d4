"""What a parser checks before it reads a file of unknown origin: that it is there, and that it fits into the memory."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from uplift.errors import UserError

__all__ = ["HDF5_START", "bytes_of", "check_memory", "existing_file", "reason_of"]

HDF5_START = b"\x89HDF\r\n\x1a\n"
"""What every HDF5 file begins with."""


def existing_file(path: str | Path, expected: str) -> Path:
    """Return the path of a file that is there and not empty; raises UserError, which says what is ``expected``, otherwise."""
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path} is a folder, expected {expected}.")
    if not path.is_file():
        raise UserError(f"No file {path} (looked in {path.absolute().parent}).")
    if path.stat().st_size == 0:
        raise UserError(f"{path} is empty (0 bytes), expected {expected}.")
    return path


def reason_of(error: BaseException) -> str:
    """Return what an error of a library says, on one line and short."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def bytes_of(shape: tuple[int, ...], dtype: np.dtype) -> int:
    """Return the bytes that an array takes, however large its shape claims to be."""
    return int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize


def check_memory(path: Path, what: str, size: int) -> None:
    """Raise UserError where something of so many bytes would take more than half of this machine's memory."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if size > memory // 2:
        raise UserError(
            f"{path}: {what} would take {size / 1e9:.1f} GB, more than half of this machine's memory "
            f"({memory / 1e9:.1f} GB). Split it into smaller files."
        )
