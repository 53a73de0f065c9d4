"""Read the HDF5 files of DeepLabCut: a table that pandas wrote, of frames or images by body parts."""

from __future__ import annotations

import io
import os
import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError
from uplift.readers.base import Peek, need
from uplift.readers.deeplabcut_columns import LEVELS, layout_of, pose_data
from uplift.readers.unpickler import Source, Unpickler

__all__ = ["looks_like_deeplabcut_h5", "read_deeplabcut_h5"]

# pandas reads these files through PyTables, which unpickles each attribute of each node that looks like a
# pickle, and each object array: a file could run what it likes. h5py unpickles nothing. The few attributes
# that are pickles, lists of names, go through the unpickler that runs nothing; arrays of objects are refused.
_KEYS = ("df_with_missing", "tracks")
_MOST_PACKED = 1100  # zlib makes data a thousandth at best
_DAMAGE = (
    OSError, RuntimeError, ValueError, LookupError, TypeError, AttributeError, MemoryError, OverflowError,
    NotImplementedError, EOFError, ArithmeticError, ImportError, pickle.UnpicklingError, struct.error,
)  # fmt: skip


def looks_like_deeplabcut_h5(peek: Peek) -> bool:
    """Return whether an HDF5 file has a table that pandas wrote."""
    try:
        import h5py

        with h5py.File(peek.path, "r") as file:
            return bool(_tables(file))
    except (*_DAMAGE, RecursionError):
        return False


def read_deeplabcut_h5(path: Path) -> PoseData:
    """Read predictions (frames of a video) or labels (images) of one or several individuals.

    Raises:
        UserError: no table of pandas, several, one with pickled objects, or damaged.
    """
    try:
        import h5py
    except ImportError:
        raise need("h5py", "trackers", path) from None
    try:
        with h5py.File(path, "r") as file:
            group: Any = file[_key(path, _tables(file))]
            columns, numbers, index = _appendable(path, group) if "table" in group else _fixed(path, group)
    except _DAMAGE as error:
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise UserError(f"{path} cannot be read as a table of pandas: truncated or damaged? ({said})") from error
    if not columns or len({len(column) for column in columns}) != 1 or len(columns[0]) not in (3, 4):
        raise UserError(
            f"{path}: columns of {len(columns[0]) if columns else 0} levels, expected {', '.join(LEVELS[0])}, "
            "with individuals for several."
        )
    layout = layout_of(path, columns)
    with np.errstate(over="ignore", invalid="ignore"):
        used = np.ascontiguousarray(numbers[:, layout.columns], np.float32)
    return pose_data(path, layout, used, index)


def _tables(file: Any) -> list[str]:
    """Return the groups at the root that hold a DataFrame."""
    import h5py

    found = []
    for name in file:
        if isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(file[name], h5py.Group):
            kind = file[name].attrs.get("pandas_type", b"")
            if _as_text(kind) in ("frame_table", "frame"):
                found.append(name)
    return found


def _key(path: Path, keys: list[str]) -> str:
    chosen = [key for key in _KEYS if key in keys] or keys
    if not chosen:
        raise UserError(f"{path}: no table of pandas in it, expected one such as 'df_with_missing'.")
    if len(chosen) > 1:
        raise UserError(f"{path}: {len(chosen)} tables ({', '.join(chosen[:6])}), expected one.")
    return chosen[0]


def _appendable(path: Path, group: Any) -> tuple[list[tuple[str, ...]], np.ndarray, np.ndarray]:
    """Return columns, (rows, columns) numbers and the index of pandas' format "table"."""
    table = _array(path, group, "table", records=True)
    axes = _unpickled(path, group, "non_index_axes")
    columns = [_names(path, column) for column in axes[0][1]]
    place = {column: at for at, column in enumerate(columns)}
    rows = table[()]
    numbers = np.full((len(rows), len(columns)), np.nan)
    for field in rows.dtype.names:
        if field.startswith("values_block_"):
            _check_numbers(path, rows[field].dtype)
            kinds = [_names(path, column) for column in _unpickled(path, table, f"{field}_kind")]
            numbers[:, [place[kind] for kind in kinds]] = rows[field].reshape(len(rows), len(kinds))
    return columns, numbers, _index(path, rows["index"], _as_text(group.attrs.get("encoding", b"utf-8")))


def _fixed(path: Path, group: Any) -> tuple[list[tuple[str, ...]], np.ndarray, np.ndarray]:
    """Return columns, (rows, columns) numbers and the index of pandas' format "fixed"."""
    encoding = _as_text(group.attrs.get("encoding", b"utf-8"))
    columns = list(zip(*_levels(path, group, "axis0", encoding), strict=True))
    place = {column: at for at, column in enumerate(columns)}
    if _as_text(group.attrs.get("axis1_variety", b"regular")) == "multi":
        parts = _levels(path, group, "axis1", encoding)
        index = np.array(["/".join(part for part in parts if part) for parts in zip(*parts, strict=True)], np.str_)
    else:
        index = _index(path, _array(path, group, "axis1")[()], encoding)
    numbers = np.full((len(index), len(columns)), np.nan)
    for block in range(int(group.attrs["nblocks"])):
        items = list(zip(*_levels(path, group, f"block{block}_items", encoding), strict=True))
        values = _array(path, group, f"block{block}_values")
        _check_numbers(path, values.dtype)
        values = values[()] if values.attrs.get("transposed", 0) else values[()].T
        numbers[:, [place[item] for item in items]] = values.reshape(len(index), len(items))
    return columns, numbers, index


def _levels(path: Path, group: Any, name: str, encoding: str) -> list[list[str]]:
    """Return the text of each level of a MultiIndex, one entry per column or row."""
    if _as_text(group.attrs.get(f"{name}_variety", b"")) != "multi":
        raise UserError(f"{path}: columns of one level, expected {', '.join(LEVELS[0])}.")
    found = []
    for level in range(int(group.attrs[f"{name}_nlevels"])):
        texts = _index(path, _array(path, group, f"{name}_level{level}")[()], encoding).astype(np.str_).tolist()
        codes = _array(path, group, f"{name}_label{level}")[()].tolist()
        found.append([texts[code] if code >= 0 else "" for code in codes])
        if len(found[0]) != len(found[-1]):
            raise ValueError(f"levels of {len(found[0])} and {len(found[-1])} entries")
    return found


def _index(path: Path, values: np.ndarray, encoding: str) -> np.ndarray:
    """Return numbers as they are and bytes as text with ``/`` between folders."""
    if values.ndim != 1:
        raise ValueError(f"an index of shape {values.shape}")
    if values.dtype.kind == "S":
        texts = [text.decode(encoding, errors="replace").replace("\\", "/") for text in values.tolist()]
        return np.array(texts, np.str_)
    _check_numbers(path, values.dtype)
    return values.astype(np.float64)


def _array(path: Path, group: Any, name: str, *, records: bool = False) -> Any:
    """Return a dataset that is in the file itself, of numbers or text and no larger than the file can hold."""
    import h5py

    item = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    if not isinstance(item, h5py.Dataset) or item.external or item.is_virtual:
        raise UserError(f"{path}: '{name}' is no array in the file itself.")
    if item.dtype.hasobject:
        raise UserError(
            f"{path}: '{name}' holds pickled Python objects, which could run code and are never opened. "
            "Save numbers: DataFrame.astype(float).to_hdf(...), or DataFrame.to_csv(...)."
        )
    if (item.dtype.names is not None) != records or item.dtype.itemsize > 1 << 24:
        raise ValueError(f"'{name}' holds {str(item.dtype)[:60]}")
    claimed = int(np.prod([int(n) for n in item.shape], dtype=object)) * item.dtype.itemsize
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if claimed > min(memory // 2, path.stat().st_size * _MOST_PACKED):
        raise UserError(f"{path}: '{name}' claims {claimed / 1e9:.3g} GB, more than the file or the memory can hold.")
    return item


def _check_numbers(path: Path, dtype: np.dtype) -> None:
    if dtype.base.kind not in "fiu":
        raise UserError(f"{path}: a column of {dtype.base}, expected numbers.")


def _unpickled(path: Path, item: Any, name: str) -> Any:
    """Return a list that pandas keeps as a pickle in an attribute."""
    raw = item.attrs[name]
    raw = raw.tobytes() if isinstance(raw, np.ndarray) else bytes(raw)
    return Unpickler(Source(io.BytesIO(raw), len(raw)), f"{path}, '{name}'").load()


def _names(path: Path, column: Any) -> tuple[str, ...]:
    if not isinstance(column, tuple):
        raise UserError(f"{path}: columns of one level, expected {', '.join(LEVELS[0])}.")
    return tuple(str(part) for part in column)


def _as_text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
