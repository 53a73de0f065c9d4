"""Read arrays, tables and text from an untrusted HDF5 file: nothing outside it, and no more than it holds."""

from __future__ import annotations

import json
import mmap
import struct
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np

from uplift.config.files import refuse_special
from uplift.data.parsers.files import HDF5_START, bytes_of, check_claim, check_memory, damage_as_error
from uplift.errors import UserError, listed

__all__ = ["Hdf5", "from_json", "h5py_missing", "open_hdf5"]

# Look over the heaps of text in an HDF5 file before the library does: a wrong size there makes it walk in circles.

_HEAP_START = b"GCOL\x01\0\0\0"
_HEADER = 16
_MOST_BYTES = 2**33
"""Longer files are not looked over: that would take longer than reading what is asked of them."""


def _heaps_are_sound(path: Path) -> bool:
    """Return whether every object of every heap (global heap collection, version 1) ends inside its heap."""
    size = path.stat().st_size
    if not 0 < size < _MOST_BYTES:
        return True
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(_HEAP_START)
        while start >= 0:
            if not _is_sound(content, start, size):
                return False
            start = content.find(_HEAP_START, start + len(_HEAP_START))
    return True


def _is_sound(content: mmap.mmap, start: int, file_size: int) -> bool:
    if start + _HEADER > file_size:
        return False
    end = start + struct.unpack_from("<Q", content, start + 8)[0]
    if end > file_size:
        return False
    place = start + _HEADER
    while place + _HEADER <= end:
        index, size = struct.unpack_from("<H6xQ", content, place)
        length = _HEADER + -(-size // 8) * 8 if index else size  # free space counts its own header
        if length < _HEADER or place + length > end:
            return False
        place += length
    return True


@contextmanager
def open_hdf5(path: Path, what: str) -> Iterator[Hdf5]:
    """Open an HDF5 file for reading; ``what`` it should be, for the errors.

    Raises:
        UserError: not HDF5, damaged, or h5py is not installed.
    """
    refuse_special(path)
    if path.is_dir():
        raise UserError(f"{path} is a folder, expected {what} (HDF5).")
    try:
        with path.open("rb") as file:
            start = file.read(len(HDF5_START))
    except OSError as error:
        raise UserError(f"{path} cannot be opened: {error.strerror or error}.") from error
    if start != HDF5_START:
        raise UserError(f"{path} is not an HDF5 file (it begins {start!r}), expected {what}.")
    try:
        import h5py
    except ImportError:
        raise h5py_missing(path) from None
    with damage_as_error(path, what):
        if not _heaps_are_sound(path):
            raise ValueError("a text is longer than the space for it")
        file = h5py.File(path, "r", locking=False)
    with file:
        yield Hdf5(path, what, file)


def h5py_missing(path: Path) -> UserError:
    """Return the error of an HDF5 file where h5py is not installed."""
    return UserError(f'{path}: reading it needs h5py: pip install "uplift3d[trackers]".')


def from_json(path: Path, where: str, text: str) -> Any:
    """Return what JSON text inside a file says.

    Raises:
        UserError: not JSON, or nested too deeply.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: {where} is not valid JSON ({error}): damaged file?") from error


class _Elsewhere(UserError):
    """A link to another file."""


def _one_error(method: Callable) -> Callable:
    @wraps(method)
    def wrapped(self: Hdf5, *given: Any) -> Any:
        with damage_as_error(self.path, self.what):
            return method(self, *given)

    return wrapped


_MOST_LINKS = 8
_SMALL = 2**26
"""Arrays of fewer bytes are read without asking how many bytes are stored for them; attributes may have no more."""
_MOST_PACKED = 1100
"""Deflate, the filter of these files, packs 1032 bytes into one at most."""


class Hdf5:
    """An open HDF5 file; every name is a path from its root, such as ``metadata`` or ``poseest/points``.

    Links inside the file are followed, others never.
    """

    def __init__(self, path: Path, what: str, file: Any):
        self.path, self.what = path, what
        self._file = file
        self._groups: dict[str, Any] = {}
        self._taken = 0

    def _find(self, name: str, hops: int = 0) -> Any:
        """Return a group or dataset, None without one; raises `_Elsewhere` where it is a link to another file."""
        import h5py

        place, walked = self._file, ""
        for part in name.strip("/").split("/"):
            if part in ("", "."):
                continue
            walked = f"{walked}/{part}"
            if walked in self._groups:
                place = self._groups[walked]
                continue
            link = place.get(part, getlink=True) if isinstance(place, h5py.Group) else None
            if link is None:
                return None
            if isinstance(link, h5py.SoftLink):
                if hops == _MOST_LINKS:
                    raise UserError(f"{self.path}: '{walked}' is a link that leads back to itself.")
                place = self._find(link.path if link.path.startswith("/") else f"{place.name}/{link.path}", hops + 1)
            elif isinstance(link, h5py.HardLink):
                place = place[part]  # type: ignore[index]
            else:
                raise _Elsewhere(f"{self.path}: '{walked}' is a link to another file, which is never followed.")
            if isinstance(place, h5py.Group):
                self._groups[walked] = place
        return place

    def _dataset(self, name: str) -> Any:
        """Return a dataset; raises UserError where its values are not here, or more than there can be."""
        import h5py

        item = self._find(name)
        if not isinstance(item, h5py.Dataset):
            raise UserError(f"{self.path}: no array '{name}', expected in {self.what}.")
        if item.shape is None or item.external or item.is_virtual:
            raise UserError(f"{self.path}: '{name}' has no values in this file, and no other is opened.")
        claimed = check_claim(f"{self.path}: '{name}'", item.shape, item.dtype)
        stored = item.id.get_storage_size()
        chunk = bytes_of(item.chunks or (), item.dtype)
        if claimed > max(_SMALL, _MOST_PACKED * stored) or chunk > 4 * _SMALL + claimed:
            raise UserError(f"{self.path}: '{name}' claims {claimed:,} bytes but holds {stored:,}: damaged file.")
        self._taken += claimed
        what = f"'{name}'" if self._taken == claimed else f"all up to '{name}'"
        check_memory(self.path, what, self._taken, self.path.stat().st_size)
        return item

    @_one_error
    def has(self, name: str) -> bool:
        """Return whether there is a group or an array of this name."""
        return self._find(name) is not None

    @_one_error
    def is_group(self, name: str) -> bool:
        """Return whether there is a group of this name in this very file."""
        try:
            return hasattr(self._find(name), "keys")
        except _Elsewhere:
            return False

    @_one_error
    def is_elsewhere(self, name: str) -> bool:
        """Return whether a name is a link to another file."""
        try:
            self._find(name)
        except _Elsewhere:
            return True
        return False

    @_one_error
    def names(self, group: str = "") -> list[str]:
        """Return the names in a group, sorted; none where there is no such group."""
        found = self._find(group)
        return sorted(found.keys()) if hasattr(found, "keys") else []

    @_one_error
    def place(self, name: str) -> int:
        """Return a number that is the same for two names of one thing."""
        return hash(self._find(name).id)

    @_one_error
    def own_name(self, name: str) -> str:
        """Return the name of what a link leads to, without its groups."""
        return _clean(str(self._find(name).name).rsplit("/", 1)[-1])

    @_one_error
    def array(self, name: str) -> np.ndarray:
        """Return an array of numbers; raises UserError without any, or one that is larger than it can be."""
        item = self._dataset(name)
        if item.dtype.kind not in "fiub":
            raise UserError(f"{self.path}: '{name}' is not an array of numbers (found {item.dtype}).")
        return np.asarray(item[()])

    @_one_error
    def table(self, name: str, columns: Collection[str]) -> dict[str, np.ndarray]:
        """Return columns of numbers (rows,) of a table; raises UserError where one is missing."""
        item = self._dataset(name)
        named = item.dtype.names
        if named is None and "field_names" in item.attrs:  # as h5wasm writes tables: one array of numbers
            named = from_json(self.path, f"'field_names' of '{name}'", str(self.attribute(name, "field_names")))
            values = self.array(name)
            if values.ndim != 2 or not isinstance(named, list) or values.shape[1] != len(named):
                raise UserError(f"{self.path}: '{name}' has shape {values.shape} for columns {named!r}.")
            found = {str(column): values[:, place] for place, column in enumerate(named)}
        elif named is not None and item.ndim == 1:
            values = item[()]
            found = {column: np.ascontiguousarray(values[column]) for column in columns if column in named}
        else:
            raise UserError(f"{self.path}: '{name}' is not a table (found {item.dtype} of shape {item.shape}).")
        for column in columns:
            if column not in found or found[column].ndim != 1 or found[column].dtype.kind not in "fiub":
                raise UserError(f"{self.path}: table '{name}' has no column '{column}' of numbers ({listed(named)}).")
        return {column: found[column] for column in columns}

    @_one_error
    def texts(self, name: str) -> list[str]:
        """Return the texts of an array, in its order; raises UserError where it holds something else."""
        import h5py

        item = self._dataset(name)
        if not item.size:  # an empty list of text is often stored as one of numbers
            return []
        if h5py.check_string_dtype(item.dtype) is None:
            raise UserError(f"{self.path}: '{name}' holds {item.dtype}, expected text.")
        return [_clean(value) for value in np.ravel(item.asstr(errors="replace")[()]).tolist()]

    def text(self, name: str) -> str:
        """Return the first text of an array; empty without any."""
        found = self.texts(name) if self.has(name) else []
        return found[0] if found else ""

    @_one_error
    def attribute(self, name: str, key: str) -> Any:
        """Return an attribute as text, number or tuple of them; None without one."""
        import h5py

        found = self._find(name)
        if found is None or key not in found.attrs:
            return None
        if found.attrs.get_id(key).get_storage_size() > _SMALL:
            raise UserError(f"{self.path}: attribute '{key}' of '{name or '/'}' is too large: damaged file?")
        value = found.attrs[key]
        if isinstance(value, h5py.Empty):
            return None
        if isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind != "V":
            value = value.ravel()[0]
        if isinstance(value, np.ndarray) and value.dtype == np.uint8:  # text as bytes
            value = value.tobytes()
        if isinstance(value, np.ndarray):  # compared with texts and numbers, and looked up by, as they are
            value = tuple(value.ravel().tolist())
        if isinstance(value, np.generic):
            value = value.item()
        return _clean(value) if isinstance(value, (str, bytes)) else value


def _clean(text: str | bytes) -> str:
    """Return text that can be shown and written: what is not a character is replaced."""
    if isinstance(text, bytes):
        return text.decode(errors="replace")
    return text.encode(errors="replace").decode()
