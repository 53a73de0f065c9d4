"""Read the arrays of an untrusted npz file: no code runs, and no memory is taken on its word."""

from __future__ import annotations

import io
import sys
import warnings
import zipfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.parsers.files import bytes_of, check_claim, check_memory, damage_as_error, existing_file
from uplift.errors import UserError, did_you_mean

__all__ = [
    "CheckedArrays",
    "array_headers",
    "first_rows",
    "iterate_rows",
    "read_arrays",
    "read_header",
    "refuse_unknown",
    "sound",
]

_MAX_HEADER_BYTES = 10_000
_Header = tuple[tuple[int, ...], np.dtype]
"""Shape and dtype."""


def read_arrays(
    path: str | Path, names: Collection[str] | None = None, *, others: bool = True
) -> dict[str, np.ndarray]:
    """Read the arrays of an npz file, after checking that it is what it claims to be.

    No pickle is ever opened, and no memory is taken before each array's header has been compared with the
    bytes that are really there. With ``names`` only those arrays are read; with ``others`` off, no other
    may be in the file.

    Raises:
        UserError: not a file, not an npz, damaged, pickled, or larger than the memory at hand.
    """
    path = Path(path)
    headers = array_headers(path)
    if names is not None and not others:
        refuse_unknown(path, headers, names)
    wanted = [name for name in headers if names is None or name in names]
    check_memory(path, "it", sum(bytes_of(*headers[name]) for name in wanted), path.stat().st_size)
    with damage_as_error(path, "an .npz file"), _no_warnings(), np.load(path, allow_pickle=False) as file:
        return {name: sound(name, file[name]) for name in wanted}


def refuse_unknown(path: Path, found: Collection[str], names: Collection[str]) -> None:
    """Raise UserError for the first array that is ``found`` in a file and not one of ``names``."""
    unknown = next((name for name in found if name not in names), None)
    if unknown is not None:
        raise UserError(f"{path}: unknown array '{unknown}'.{did_you_mean(unknown, sorted(names))}")


_READ_AT_ONCE = 1 << 22


def iterate_rows(path: Path, names: Collection[str], counts: Iterable[int]) -> Iterator[dict[str, np.ndarray]]:
    """Yield the rows of arrays that `array_headers` has found, in order, so many at a time; nothing else is in memory.

    Packed arrays are unpacked as they are read. Those whose columns come first, which have no rows in a row, are
    read as a whole.

    Raises:
        UserError: damaged.
    """
    with damage_as_error(path, "an .npz file"), zipfile.ZipFile(path) as archive, ExitStack() as opened:
        sources = {name: _Rows(path, name, opened.enter_context(archive.open(f"{name}.npy"))) for name in names}
        for count in counts:
            yield {name: sound(name, source.take(count)) for name, source in sources.items()}


class _Rows:
    """The rows of one array of an npz file, from the first on."""

    def __init__(self, path: Path, name: str, file: Any) -> None:
        self.shape, by_columns, self.dtype = read_header(file)
        self.file, self.at = file, 0
        self.whole = read_arrays(path, (name,))[name] if by_columns and len(self.shape) > 1 else None

    def take(self, count: int) -> np.ndarray:
        """Return the next ``count`` rows."""
        self.at += count
        if self.whole is not None:
            return np.ascontiguousarray(self.whole[self.at - count : self.at])
        shape = (count, *self.shape[1:])
        rows = np.empty(bytes_of(shape, self.dtype), np.uint8)
        for start in range(0, len(rows), _READ_AT_ONCE):
            piece = self.file.read(min(_READ_AT_ONCE, len(rows) - start))
            rows[start : start + len(piece)] = np.frombuffer(piece, np.uint8)
        return rows.view(self.dtype).reshape(shape)


@contextmanager
def _no_warnings() -> Iterator[None]:
    """Let NumPy read headers of Python 2 as it reads any, without a word."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def sound(name: str, array: np.ndarray) -> np.ndarray:
    """Return an array, if its text is of characters; raises ValueError for numbers that are none, which break later."""
    if array.dtype.kind == "U" and array.dtype.itemsize and array.size:
        codes = np.ascontiguousarray(array).reshape(-1).view(array.dtype.byteorder.replace("|", "=") + "u4")
        if codes.max() > sys.maxunicode:
            raise ValueError(f"'{name}' holds text of characters that do not exist")
    return array


def array_headers(path: str | Path) -> dict[str, _Header]:
    """Return shape and dtype of each array of an npz file, compared with the bytes that are there.

    Raises:
        UserError: not a file, not an npz, damaged, or pickled.
    """
    path = existing_file(path, "an .npz file")
    with damage_as_error(path, "an .npz file"), zipfile.ZipFile(path) as archive:
        return dict(_header(path, archive, member) for member in archive.infolist())


def first_rows(path: Path, name: str, rows: int) -> np.ndarray:
    """Return up to ``rows`` rows of an array that `array_headers` has found, nothing else loaded."""
    with damage_as_error(path, "an .npz file"), zipfile.ZipFile(path) as archive, archive.open(f"{name}.npy") as file:
        shape, by_columns, dtype = read_header(file)
        if by_columns or not shape:
            return read_arrays(path, (name,))[name][:rows]
        kept = (min(rows, shape[0]), *shape[1:])
        return np.frombuffer(file.read(bytes_of(kept, dtype)), dtype).reshape(kept)


def _header(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[str, _Header]:
    name = member.filename.removesuffix(".npy")
    if name == member.filename:
        raise UserError(f"{path}: holds '{name}', expected only arrays (.npy) in an .npz file.")
    with archive.open(member) as file:
        try:
            shape, _, dtype = read_header(file)
        except ValueError as error:
            raise UserError(f"{path}: array '{name}' is damaged: {error}") from error
        stored = member.file_size - file.tell()
    if dtype.hasobject:
        raise UserError(
            f"{path}: '{name}' holds pickled Python objects, which could run code and are never "
            "opened. Save plain numbers or text: np.savez(file, keypoints=array.astype('float32'), ...)."
        )
    if (claimed := check_claim(f"{path}: '{name}'", shape, dtype)) != stored:
        raise UserError(f"{path}: '{name}' claims {claimed:,} bytes but holds {stored:,}: damaged file.")
    return name, (shape, dtype)


def read_header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Return shape, whether columns come first, and dtype of the array that a file begins with; raises ValueError."""
    start = file.tell()
    head = io.BytesIO(file.read(_MAX_HEADER_BYTES))  # NumPy would read as long a header as the file announces
    version = np.lib.format.read_magic(head)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    with _no_warnings():
        found = read(head, max_header_size=_MAX_HEADER_BYTES)
    file.seek(start + head.tell())
    return found


class CheckedArrays:
    """The arrays of one file, each checked against the kind, shape and range it should have."""

    def __init__(self, where: str, arrays: dict[str, np.ndarray]) -> None:
        self.where, self.arrays = where, arrays

    def floats(self, name: str, shape: tuple[int | None, ...]) -> np.ndarray | None:
        """Return an array of numbers or flags as float32, NaN and infinity as they are; None where absent."""
        array = self._of(name, shape, "fiub", "numbers")
        with np.errstate(over="ignore"):
            return None if array is None else array.astype(np.float32)

    def numbers(
        self, name: str, shape: tuple[int | None, ...], above: int | float | None = None, infinite: bool = False
    ) -> np.ndarray | None:
        """Return an array of finite numbers as float32, None where absent; ``above``: a bound; ``infinite``: inf is allowed."""
        array = self._of(name, shape, "fiu", "numbers")
        if array is None:
            return None
        bad = np.isnan(array) | (np.isinf(array) & (not infinite))
        with np.errstate(over="ignore"):
            array = array.astype(np.float32)
        bad |= np.isinf(array) & (not infinite)
        if above is not None:
            bad |= array <= above
        if bad.any():
            row = np.argwhere(bad)[0].tolist()
            expected = "finite numbers" if above is None else f"numbers above {above:g}"
            raise UserError(f"{self.where}: '{name}' is {array[tuple(row)]:g} at {row}, expected {expected}.")
        return array

    def indices(self, name: str, shape: tuple[int | None, ...], below: int) -> np.ndarray | None:
        """Return an array of whole numbers from 0 to less than ``below``, None where absent."""
        array = self._of(name, shape, "iu", "whole numbers")
        if array is not None and array.size and not (array.min() >= 0 and array.max() < below):
            raise UserError(
                f"{self.where}: '{name}' goes from {array.min()} to {array.max()}, expected 0 to {below - 1}."
            )
        return None if array is None else array.astype(np.int64)

    def starts(self, name: str, end: int) -> np.ndarray | None:
        """Return where each mesh begins: rising from 0 to ``end``."""
        array = self.indices(name, (None,), end + 1)
        if array is not None and (len(array) < 2 or array[0] != 0 or array[-1] != end or (np.diff(array) <= 0).any()):
            raise UserError(f"{self.where}: '{name}' must rise from 0 to {end}, one number a mesh and one more.")
        return array

    def text(self, name: str, items: int | None) -> np.ndarray | None:
        """Return an array of text, None where absent."""
        return self._of(name, (items,), "U", "text")

    def flags(self, name: str, items: int) -> np.ndarray | None:
        """Return an array of yes and no, None where absent."""
        return self._of(name, (items,), "b", "true or false")

    def _of(self, name: str, shape: tuple[int | None, ...], kinds: str, expected: str) -> np.ndarray | None:
        array = self.arrays.get(name)
        if array is None:
            return None
        fits = array.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
        if not fits or array.dtype.kind not in kinds:
            wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + "," * (len(shape) == 1) + ")"
            found = f"{array.dtype} of shape {array.shape}"
            raise UserError(f"{self.where}: '{name}' is {found}, expected {expected} of shape {wanted}.")
        return array
