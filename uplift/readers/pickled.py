"""Open pickles that nobody vouches for: arrays, containers, numbers and text, and nothing that runs."""

from __future__ import annotations

import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from uplift.errors import UserError
from uplift.readers.unpickler import Dtype, Source, Unpickler, array_of

__all__ = ["load_object_npz", "load_pickle"]

_MAX_HEADER_BYTES = 10_000
# Whatever a damaged or hostile stream makes the unpickler stumble over.
_DAMAGE = (
    pickle.UnpicklingError, EOFError, ValueError, IndexError, KeyError, AttributeError, TypeError, AssertionError,
    ArithmeticError, MemoryError, NotImplementedError, RuntimeError, ImportError, OSError, struct.error, zlib.error,
    zipfile.BadZipFile,
)  # fmt: skip


def load_pickle(path: str | Path) -> Any:
    """Return what a pickle file holds: NumPy arrays, builtin containers, numbers and text, of Python 2 or 3.

    Nothing of the file's choice is ever imported or called, and no memory is taken on its word.

    Raises:
        UserError: no such file, damaged, too large for the memory, or one that wants to import something else.
    """
    path = _existing(path)
    _check_size(path, path.stat().st_size)
    try:
        with path.open("rb") as file:
            return Unpickler(Source(file, path.stat().st_size), str(path)).load()
    except _DAMAGE as error:
        raise UserError(f"{path} is not a whole pickle file ({_said(error)}): truncated, or another format?") from error


def load_object_npz(path: str | Path, names: Collection[str] | None = None) -> dict[str, Any]:
    """Return the arrays of an npz file that may hold pickled objects, opened as `load_pickle` does.

    An object array without dimensions comes as the object itself. With ``names`` only these are read.

    Raises:
        UserError: no such file, damaged, too large for the memory, or one that wants to import something else.
    """
    path = _existing(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = [m for m in archive.infolist() if names is None or m.filename.removesuffix(".npy") in names]
            _check_size(path, sum(member.file_size for member in members))
            return {m.filename.removesuffix(".npy"): _read_member(path, archive, m) for m in members}
    except _DAMAGE as error:
        raise UserError(f"{path} is not a whole .npz file ({_said(error)}): truncated, or another format?") from error


def _existing(path: str | Path) -> Path:
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path} is a folder, expected a file.")
    if not path.is_file():
        raise UserError(f"No file {path} (looked in {path.absolute().parent}).")
    if path.stat().st_size == 0:
        raise UserError(f"{path} is empty (0 bytes).")
    return path


def _check_size(path: Path, size: int) -> None:
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if size > memory // 2:
        raise UserError(
            f"{path}: would take {size / 1e9:.1f} GB, more than half of this machine's memory ({memory / 1e9:.1f} GB)."
        )


def _said(error: Exception) -> str:
    return str(error) or type(error).__name__


def _read_member(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Any:
    if not member.filename.endswith(".npy"):
        raise UserError(f"{path}: holds '{member.filename}', expected only arrays (.npy) in an .npz file.")
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, by_column, dtype = read(file, max_header_size=_MAX_HEADER_BYTES)
        left = member.file_size - file.tell()
        if dtype.hasobject:
            array = Unpickler(Source(file, left), f"{path}, array '{member.filename.removesuffix('.npy')}'").load()
            if not isinstance(array, np.ndarray) or array.shape != shape:
                raise ValueError(f"'{member.filename}' is not the array that its header announces")
            return array.item() if array.dtype == object and array.ndim == 0 else array
        return array_of(file.read(left), Dtype(dtype), shape, "F" if by_column else "C")
