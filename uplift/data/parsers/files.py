"""Checks of files of unknown origin: that they are there, fit into memory, and fail with one clear error."""

from __future__ import annotations

import codecs
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from uplift.config.files import refuse_special
from uplift.errors import UserError

__all__ = [
    "HDF5_START", "bytes_of", "check_claim", "check_memory", "damage_as_error", "encoding_of", "existing_file",
    "read_bytes", "reason_of", "refuse_more_than_memory",
]  # fmt: skip

HDF5_START = b"\x89HDF\r\n\x1a\n"
"""What every HDF5 file begins with."""


def existing_file(path: str | Path, expected: str) -> Path:
    """Return the path of a file that exists and is not empty; otherwise raises UserError, which names the ``expected``."""
    path = Path(path)
    refuse_special(path)
    if path.is_dir():
        raise UserError(f"{path} is a folder, expected {expected}.")
    if not path.is_file():
        raise UserError(f"No file {path} (looked in {path.absolute().parent}).")
    if path.stat().st_size == 0:
        raise UserError(f"{path} is empty (0 bytes), expected {expected}.")
    return path


def read_bytes(path: Path) -> bytes:
    """Return what is in a file; raises UserError where it cannot be read, or is larger than the memory allows."""
    refuse_special(path)
    try:
        check_memory(path, "it", path.stat().st_size)
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
def damage_as_error(path: Path, what: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged or hostile file into one UserError; ``what`` the file should be.

    Libraries raise far more than they say: NumPy's headers alone end in TokenError, SyntaxError or TypeError.
    """
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        raise UserError(
            f"{path} cannot be read as {what} ({reason_of(error)}): truncated, or another format?"
        ) from error


def bytes_of(shape: tuple[int, ...], dtype: np.dtype) -> int:
    """Return the bytes that an array takes, however large its shape claims to be."""
    return int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize


_MOST_EMPTY = 1_000_000
"""Rows of an array that has no bytes: such a shape costs a file nothing, and who walks along it hours."""


def check_claim(where: str, shape: tuple[int, ...], dtype: np.dtype) -> int:
    """Return the bytes of an array, as `bytes_of`; raises UserError for one without any that claims endless rows."""
    size = bytes_of(shape, dtype)
    if not size and max(shape, default=0) > _MOST_EMPTY:
        raise UserError(f"{where} has shape {shape} and not a byte of data: damaged file.")
    return size


_MOST_UNPACKED = 2**28
"""Bytes that any file may unpack to."""
_MOST_PACKED = 100
"""Real arrays shrink less than that: masks tenfold, tracks that are mostly missing fiftyfold."""
_UNPACKED = "UPLIFT_MAX_UNPACKED_GB"


def check_memory(path: Path, what: str, size: int, stored: int | None = None) -> None:
    """Raise UserError where something of so many bytes would take more than half of this machine's memory.

    ``stored`` is how many bytes of a packed file it comes from: what unpacks to very much more than any real data
    (a "bomb") is refused as well, unless the variable UPLIFT_MAX_UNPACKED_GB allows as much.
    """
    refuse_more_than_memory(f"{path}: {what}", size, "Split it into smaller files")
    if stored is not None and size > max(_MOST_UNPACKED, _MOST_PACKED * stored, _allowed_bytes()):
        raise UserError(
            f"{path}: {what} would grow from {stored / 1e6:.1f} MB to {size / 1e9:.1f} GB, as in files that are made to "
            f"fill the memory. If you trust it, put {_UNPACKED}={-(-size // 10**9)} before the command."
        )


def refuse_more_than_memory(what: str, size: int, instead: str) -> None:
    """Raise UserError where so many bytes are more than half of this machine's memory; ``instead`` says what to do."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if size > memory // 2:
        raise UserError(
            f"{what} would take {size / 1e9:,.1f} GB, more than half of this machine's memory "
            f"({memory / 1e9:,.1f} GB). {instead}."
        )


def _allowed_bytes() -> float:
    """Return the bytes that the user's variable allows a file to unpack to, 0 without one."""
    try:
        return float(os.environ.get(_UNPACKED, 0)) * 1e9
    except ValueError:
        raise UserError(f"{_UNPACKED}={os.environ[_UNPACKED]}: expected a number of gigabytes, such as 8.") from None
