"""Checks of files of unknown origin: that they are there, fit into memory, and fail with one clear error."""

from __future__ import annotations

import codecs
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from uplift.errors import UserError

__all__ = [
    "DAMAGE", "HDF5_START", "bytes_of", "check_memory", "damage_as_error", "encoding_of", "existing_file", "read_bytes",
    "reason_of",
]  # fmt: skip

HDF5_START = b"\x89HDF\r\n\x1a\n"
"""What every HDF5 file begins with."""
DAMAGE = (
    ArithmeticError, AssertionError, AttributeError, EOFError, ImportError, LookupError, MemoryError, OSError,
    RuntimeError, SystemError, TypeError, ValueError, pickle.UnpicklingError, struct.error, zipfile.BadZipFile,
    zlib.error,
)  # fmt: skip
"""Whatever a library raises on a damaged or hostile file."""


def existing_file(path: str | Path, expected: str) -> Path:
    """Return the path of a file that exists and is not empty; otherwise raises UserError, which names the ``expected``."""
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path} is a folder, expected {expected}.")
    if not path.is_file():
        raise UserError(f"No file {path} (looked in {path.absolute().parent}).")
    if path.stat().st_size == 0:
        raise UserError(f"{path} is empty (0 bytes), expected {expected}.")
    return path


def read_bytes(path: Path) -> bytes:
    """Return what is in a file; raises UserError where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error}).") from error


def encoding_of(start: bytes) -> str:
    """Return the encoding of text that begins with these bytes: UTF-16 where its mark says so, else UTF-8 with or without one."""
    is_utf16 = start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) and not start.startswith(
        codecs.BOM_UTF32_LE
    )
    return "utf-16" if is_utf16 else "utf-8-sig"


def reason_of(error: BaseException) -> str:
    """Return the message of a library's error, on one line and short."""
    return " ".join(str(error).split())[:200] or type(error).__name__


@contextmanager
def damage_as_error(path: Path, what: str, *others: type[Exception]) -> Iterator[None]:
    """Turn `DAMAGE`, or an exception of the library's own, into one UserError; ``what`` the file should be."""
    try:
        yield
    except (*DAMAGE, *others) as error:
        raise UserError(
            f"{path} cannot be read as {what} ({reason_of(error)}): truncated, or another format?"
        ) from error


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
