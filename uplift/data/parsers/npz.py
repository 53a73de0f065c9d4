"""Read the arrays of an npz file of unknown origin: no code runs, no memory is taken on its word."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path

import numpy as np

from uplift.errors import UserError, did_you_mean

__all__ = ["CheckedArrays", "read_arrays"]

# Read the arrays of an npz file that nobody vouches for: no code runs, no memory is taken on its word.

_MAX_HEADER_BYTES = 10_000


def read_arrays(
    path: str | Path, names: Collection[str] | None = None, *, others: bool = True
) -> dict[str, np.ndarray]:
    """Read the arrays of an npz file, after checking that it is what it claims to be.

    No pickle is ever opened, and no memory is taken before each array's header has been held
    against the bytes that are really there. With ``names`` only those arrays are read; with
    ``others`` off, no other may be in the file.

    Raises:
        UserError: not a file, not an npz, damaged, pickled, or larger than the memory at hand.
    """
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path} is a folder, expected an .npz file.")
    if not path.is_file():
        raise UserError(f"No file {path} (looked in {path.absolute().parent}).")
    if path.stat().st_size == 0:
        raise UserError(f"{path} is empty (0 bytes), expected an .npz file with at least 'keypoints'.")
    try:
        with zipfile.ZipFile(path) as archive:
            if names is not None and not others:
                _refuse_others(path, archive, names)
            _check_sizes(path, archive, names)
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files if names is None or name in names}
    except zipfile.BadZipFile as error:
        raise UserError(f"{path} is not a whole .npz file ({error}): truncated, or another format?") from error
    except (ValueError, EOFError, OSError, KeyError, NotImplementedError, RuntimeError, zlib.error) as error:
        raise UserError(f"{path} cannot be read as .npz: {error}") from error


def _refuse_others(path: Path, archive: zipfile.ZipFile, names: Collection[str]) -> None:
    for member in archive.namelist():
        name = member.removesuffix(".npy")
        if name != member and name not in names:
            raise UserError(f"{path}: unknown array '{name}'.{did_you_mean(name, sorted(names))}")


def _check_sizes(path: Path, archive: zipfile.ZipFile, names: Collection[str] | None) -> None:
    total = 0
    for member in archive.infolist():
        if not member.filename.endswith(".npy"):
            raise UserError(f"{path}: holds '{member.filename}', expected only arrays (.npy) in an .npz file.")
        with archive.open(member) as file:
            try:
                version = np.lib.format.read_magic(file)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, dtype = read(file, max_header_size=_MAX_HEADER_BYTES)
            except ValueError as error:
                raise UserError(f"{path}: array '{member.filename}' is damaged: {error}") from error
            header = file.tell()
        name = member.filename.removesuffix(".npy")
        if dtype.hasobject:
            raise UserError(
                f"{path}: '{name}' holds pickled Python objects, which could run code and are never "
                "opened. Save plain numbers or text: np.savez(file, keypoints=array.astype('float32'), ...)."
            )
        claimed = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
        if claimed != member.file_size - header:
            raise UserError(
                f"{path}: '{name}' claims {claimed:,} bytes but holds {member.file_size - header:,}: damaged file."
            )
        total += claimed if names is None or name in names else 0
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if total > memory // 2:
        raise UserError(
            f"{path}: would take {total / 1e9:.1f} GB, more than half of this machine's memory "
            f"({memory / 1e9:.1f} GB). Split it into smaller files."
        )


# Arrays of a file that nobody vouches for, each held against what it should be.


class CheckedArrays:
    """The arrays of one file, each held against what it should be."""

    def __init__(self, where: str, arrays: dict[str, np.ndarray]) -> None:
        self.where, self.arrays = where, arrays

    def numbers(
        self, name: str, shape: tuple[int | None, ...], above: int | float | None = None, infinite: bool = False
    ) -> np.ndarray | None:
        """Return an array as float32, None where absent; ``above``: a bound; ``infinite``: whether inf may be."""
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
            wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
            raise UserError(
                f"{self.where}: '{name}' is {array.dtype} of shape {array.shape}, expected {expected} of shape {wanted}."
            )
        return array
