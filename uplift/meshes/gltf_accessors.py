"""Numbers out of a glTF file's buffers: strides, sparse changes, normalised integers."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from uplift.meshes.gltf_file import Document

__all__ = ["floats", "wholes"]

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_MOST_EMPTY = 5_000_000
"""Rows of an accessor without data of its own, which costs a file nothing to claim."""


def floats(document: Document, index: Any, kind: str, whose: str) -> Float[np.ndarray, "rows width"]:
    """Return an accessor's numbers, normalised integers as -1..1 or 0..1. Raises UserError for what is not there."""
    accessor = document.entry("accessors", index, whose)
    found = _rows(document, accessor, f"accessor {index}", kind)
    values = found.astype(np.float64)
    if accessor.get("normalized") is True and found.dtype.kind in "iu":
        values = np.maximum(values / np.iinfo(found.dtype).max, -1.0)
    if not np.isfinite(values).all():
        raise document.wrong(f"{whose} has numbers that are not finite")
    return values


def wholes(document: Document, index: Any, kind: str, whose: str) -> Int[np.ndarray, "rows width"]:
    """Return an accessor's whole numbers, 0 or more. Raises UserError for what is not there."""
    found = _rows(document, document.entry("accessors", index, whose), f"accessor {index}", kind)
    if found.dtype.kind != "u":
        raise document.wrong(f"{whose} are not unsigned whole numbers")
    return found.astype(np.int64)


def _rows(document: Document, accessor: dict[str, Any], name: str, kind: str) -> np.ndarray:
    if accessor.get("type") != kind:
        raise document.wrong(f"{name} is {str(accessor.get('type'))[:20]}, expected {kind}")
    count = document.whole(accessor, "count", None, name)
    dtype, width = _component(document, accessor, name), _WIDTHS[kind]
    if "bufferView" in accessor:
        found = _viewed(document, accessor, "byteOffset", dtype, (count, width), name)
    elif count <= _MOST_EMPTY:
        found = np.zeros((count, width), dtype)
    else:
        raise document.wrong(f"{name} claims {count:,} rows and has no data")
    return _changed(document, accessor, found, name) if "sparse" in accessor else found


def _component(document: Document, entry: dict[str, Any], name: str) -> np.dtype:
    kind = entry.get("componentType")
    if not isinstance(kind, int) or kind not in _COMPONENTS:
        raise document.wrong(f"{name} has the component type {str(kind)[:20]}")
    return np.dtype(_COMPONENTS[kind])


def _viewed(
    document: Document, entry: dict[str, Any], key: str, dtype: np.dtype, shape: tuple[int, int], name: str
) -> np.ndarray:
    """Return rows of a buffer view, without a copy."""
    view = document.entry("bufferViews", entry.get("bufferView"), name)
    buffer = document.buffers[document.number_of("buffers", view.get("buffer"), f"the view of {name}")]
    start = document.whole(view, "byteOffset", 0, f"the view of {name}")
    length = document.whole(view, "byteLength", None, f"the view of {name}")
    offset = document.whole(entry, key, 0, name)
    size = dtype.itemsize * shape[1]
    stride = document.whole(view, "byteStride", size, f"the view of {name}")
    if stride < size:
        raise document.wrong(f"the rows of {name} are {size} bytes and {stride} apart")
    needed = offset + (stride * (shape[0] - 1) + size if shape[0] else 0)
    if start + length > len(buffer) or needed > length:
        raise document.wrong(
            f"{name} needs {start + needed:,} bytes, its buffer has {min(start + length, len(buffer)):,}"
        )
    if not shape[0]:
        return np.zeros(shape, dtype)
    return np.ndarray(shape, dtype, buffer, start + offset, (stride, dtype.itemsize))


def _changed(document: Document, accessor: dict[str, Any], found: np.ndarray, name: str) -> np.ndarray:
    sparse = accessor["sparse"] if isinstance(accessor["sparse"], dict) else {}
    at, values = sparse.get("indices"), sparse.get("values")
    if not isinstance(at, dict) or not isinstance(values, dict):
        raise document.wrong(f"the sparse changes of {name} are no objects")
    count = document.whole(sparse, "count", None, name)
    where = _component(document, at, name)
    rows = _viewed(document, at, "byteOffset", where, (count, 1), name)[:, 0]
    if where.kind != "u" or (rows >= len(found)).any():
        raise document.wrong(f"the sparse changes of {name} are at rows it does not have")
    changed = found.copy()
    changed[rows] = _viewed(document, values, "byteOffset", found.dtype, (count, found.shape[1]), name)
    return changed
