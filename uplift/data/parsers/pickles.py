"""Read untrusted pickles: arrays, containers, numbers and text, and nothing that runs."""

from __future__ import annotations

import collections
import pickle
import struct
import zipfile
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from uplift.data.parsers.files import check_memory, damage_as_error, existing_file
from uplift.data.parsers.npz import read_header
from uplift.errors import UserError

__all__ = ["Source", "Unpickler", "load_object_npz", "load_pickle"]

_KINDS = "biufcSUO"
_DEEPEST = 200


class Source:
    """A stream that raises at once when more is asked of it than it has."""

    def __init__(self, file: Any, size: int):
        self._file, self._left = file, size

    def read(self, size: int) -> bytes:
        """Return exactly so many bytes; raises EOFError."""
        if size < 0 or size > self._left:
            raise EOFError(f"{size:,} bytes announced, {self._left:,} there")
        self._left -= size
        return self._file.read(size)

    def readline(self) -> bytes:
        """Return the rest of the line."""
        line = self._file.readline(self._left)
        self._left -= len(line)
        return line

    def readinto(self, buffer: Any) -> int:
        """Fill ``buffer``."""
        buffer[:] = self.read(len(buffer))
        return len(buffer)


class _Dtype:
    """Stands for a dtype, of which a pickle gives first the kind and later the byte order."""

    def __init__(self, dtype: np.dtype):
        if dtype.kind not in _KINDS or dtype.names is not None or dtype.subdtype is not None:
            raise ValueError(f"an array of {dtype}, expected numbers, text or objects")
        self.dtype = dtype

    def order(self, state: Any) -> None:
        """Take the byte order out of a dtype's state; raises ValueError for anything more."""
        if not isinstance(state, tuple) or len(state) < 5 or state[1] not in ("<", ">", "=", "|"):
            raise ValueError("a dtype without a byte order")
        if any(part is not None for part in state[2:5]):
            raise ValueError("an array of records, expected numbers, text or objects")
        self.dtype = self.dtype.newbyteorder(state[1]) if state[1] in "<>" else self.dtype


_NDARRAY = object()
"""Stands for the class ndarray, which a pickle names and never calls."""


def _reconstruct(kind: Any, _shape: Any = (0,), _dtype: Any = b"b") -> np.ndarray:
    if kind is not _NDARRAY:
        raise ValueError("a subclass of ndarray, expected ndarray")
    return np.empty(0, np.int8)


def _dtype(name: Any, _align: Any = False, _copy: Any = True) -> _Dtype:
    if not isinstance(name, str) or len(name) > 12 or "," in name:
        raise ValueError(f"a dtype named {str(name)[:40]!r}")
    return _Dtype(np.dtype(name))


def _scalar(kind: Any, raw: Any) -> Any:
    return _array_of(raw, kind, (1,), "C")[0]


def _array_of(raw: Any, kind: Any, shape: Any, order: Any, axes: Any = None) -> np.ndarray:
    """Return numbers or text that ``raw`` holds; raises ValueError where that is not as much as ``shape`` says."""
    if not isinstance(kind, _Dtype) or kind.dtype.hasobject or order not in ("C", "F", "K"):
        raise ValueError("a buffer that is not an array of numbers or text")
    raw = raw.encode("latin1") if isinstance(raw, str) else raw
    _check_array(kind, shape, raw)
    array = np.frombuffer(raw, kind.dtype).reshape(shape, order="F" if order == "F" else "C")
    return array if axes is None else array.transpose(axes)


def _check_array(kind: Any, shape: Any, raw: Any) -> None:
    """Refuse a shape that is not the length of ``raw``: a list of objects, or bytes."""
    if not isinstance(shape, tuple) or len(shape) > 32 or any(type(n) is not int or n < 0 for n in shape):
        raise ValueError(f"an array of shape {str(shape)[:60]}")
    if not isinstance(kind, _Dtype) or not kind.dtype.itemsize:
        raise ValueError("an array without a dtype")
    what, size, kinds = "bytes", kind.dtype.itemsize, (bytes, bytearray, str)
    if kind.dtype.hasobject:
        what, size, kinds = "objects", 1, (list,)
    claimed = int(np.prod(shape, dtype=object)) * size
    if not isinstance(raw, kinds) or len(raw) != claimed:
        raise ValueError(f"an array that claims {claimed:,} {what} does not hold as many")


def _encode(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise ValueError("bytes in an unknown encoding")
    return text.encode("latin1")


_BUILTINS = (dict, list, set, frozenset, complex)
_NUMPY: dict[str, Any] = {
    "multiarray._reconstruct": _reconstruct,
    "multiarray.scalar": _scalar,
    "numeric._frombuffer": _array_of,
}
_ADMITTED: dict[str, Any] = {
    "numpy.ndarray": _NDARRAY,
    "numpy.dtype": _dtype,
    **{f"numpy.{core}.{name}": found for core in ("core", "_core") for name, found in _NUMPY.items()},
    "_codecs.encode": _encode,
    "collections.OrderedDict": collections.OrderedDict,
    "collections.defaultdict": lambda *_factory: {},
    **{f"builtins.{kind.__name__}": kind for kind in _BUILTINS},
    **{f"__builtin__.{kind.__name__}": kind for kind in _BUILTINS},
    **dict.fromkeys(("builtins.bytes", "__builtin__.bytes"), lambda: b""),
}


_Python: Any = pickle._Unpickler


class Unpickler(_Python):
    """The unpickler in Python: what it takes on a file's word can be seen and overridden."""

    dispatch: ClassVar[dict[int, Callable[..., None]]] = dict(_Python.dispatch)

    def __init__(self, source: Source, where: str):
        super().__init__(source, encoding="latin1")
        self._where = where
        self._depth: dict[int, int] = {}

    def find_class(self, module: str, name: str) -> Any:
        """Return the stand-in for what an array is made with; refuse everything else."""
        wanted = f"{module}.{name}"
        if wanted not in _ADMITTED:
            raise UserError(
                f"{self._where} wants to import '{wanted[:100]}', expected only NumPy arrays, lists, dicts, numbers and "
                "text. Such a file can run any code when it is opened, so it is not opened further: get it from "
                "where it was first published, or save its arrays anew with np.savez."
            )
        return _ADMITTED[wanted]

    def load_build(self) -> None:
        """Give an array or a dtype its state; nothing else has one here."""
        state = self.stack.pop()
        built = self.stack[-1]
        if isinstance(built, _Dtype):
            built.order(state)
            return
        if type(built) is not np.ndarray or built.size or not isinstance(state, tuple) or len(state) != 5:
            raise ValueError(f"a state for a {type(built).__name__}")
        _, shape, kind, by_column, raw = state
        _check_array(kind, shape, raw)
        reopened: Any = built
        reopened.__setstate__((1, shape, kind.dtype, bool(by_column), raw))

    def load_bytearray8(self) -> None:
        """Read the bytes before memory is taken for them."""
        (size,) = struct.unpack("<Q", self.read(8))
        self.append(bytearray(self.read(size)))

    def load_ext(self) -> None:
        """Refuse codes that stand for imports."""
        raise pickle.UnpicklingError("an extension code")

    def check_depth(self, load: Callable[..., None]) -> None:
        """Make a tuple, unless it is nested so deeply that its hash would overflow the stack."""
        load(self)
        made = self.stack[-1]
        depth = 1 + max((self._depth.get(id(part), 0) for part in made if type(part) is tuple), default=0)
        if depth > _DEEPEST:
            raise pickle.UnpicklingError(f"more than {_DEEPEST} tuples in one another")
        self._depth[id(made)] = depth

    dispatch[pickle.BUILD[0]] = load_build
    for _code in (pickle.TUPLE, pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3):
        dispatch[_code[0]] = partial(check_depth, load=dispatch[_code[0]])
    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8
    for _code in (pickle.EXT1, pickle.EXT2, pickle.EXT4):
        dispatch[_code[0]] = load_ext


def load_pickle(path: str | Path) -> Any:
    """Return what a pickle file holds: NumPy arrays, builtin containers, numbers and text, of Python 2 or 3.

    Nothing of the file's choice is ever imported or called, and no memory is taken on its word.

    Raises:
        UserError: no such file, damaged, too large for the memory, or one that wants to import something else.
    """
    path = existing_file(path, "a pickle file")
    check_memory(path, "it", path.stat().st_size)
    with damage_as_error(path, "a pickle file"), path.open("rb") as file:
        return Unpickler(Source(file, path.stat().st_size), str(path)).load()


def load_object_npz(path: str | Path, names: Collection[str] | None = None) -> dict[str, Any]:
    """Return the arrays of an npz file that may hold pickled objects, opened as `load_pickle` does.

    An object array without dimensions comes as the object itself. With ``names`` only these are read.

    Raises:
        UserError: no such file, damaged, too large for the memory, or one that wants to import something else.
    """
    path = existing_file(path, "an .npz file")
    with damage_as_error(path, "an .npz file"), zipfile.ZipFile(path) as archive:
        members = [m for m in archive.infolist() if names is None or m.filename.removesuffix(".npy") in names]
        check_memory(path, "it", sum(member.file_size for member in members), path.stat().st_size)
        return {m.filename.removesuffix(".npy"): _read_member(path, archive, m) for m in members}


def _read_member(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Any:
    if not member.filename.endswith(".npy"):
        raise UserError(f"{path}: holds '{member.filename}', expected only arrays (.npy) in an .npz file.")
    with archive.open(member) as file:
        shape, by_column, dtype = read_header(file)
        left = member.file_size - file.tell()
        if dtype.hasobject:
            array = Unpickler(Source(file, left), f"{path}, array '{member.filename.removesuffix('.npy')}'").load()
            if not isinstance(array, np.ndarray) or array.shape != shape:
                raise ValueError(f"'{member.filename}' is not the array that its header announces")
            return array.item() if array.dtype == object and array.ndim == 0 else array
        return _array_of(file.read(left), _Dtype(dtype), shape, "F" if by_column else "C")
