"""Arrays as a short text for a page: quantised to steps, differenced over rows, deflated, base64."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

__all__ = ["ABSENT", "pack", "quantise", "unpack"]

ABSENT = -32768
_LARGEST = 32767


def quantise(values: np.ndarray, finest: float) -> tuple[np.ndarray, float, float]:
    """Return int16 codes, step and offset with ``codes * step + offset`` near ``values``.

    The step is ``finest`` or what the range of the values needs, whichever is larger; the error is
    at most half a step. A value that is not finite becomes ``ABSENT``.
    """
    values = np.asarray(values, np.float64)
    finite = np.isfinite(values)
    known = values[finite]
    low, high = (known.min(), known.max()) if known.size else (0.0, 0.0)
    step = max((high - low) / 2 / (_LARGEST - 1), finest, np.finfo(np.float32).tiny)
    # A whole number of steps keeps zeros and whole numbers exact.
    offset = np.rint((low + high) / 2 / step) * step
    codes = np.full(values.shape, ABSENT, np.int16)
    codes[finite] = np.clip(np.rint((known - offset) / step), -_LARGEST, _LARGEST).astype(np.int16)
    return codes, float(step), float(offset)


def pack(arrays: dict[str, tuple[np.ndarray, float]]) -> tuple[str, list[dict[str, Any]]]:
    """Return the text and its description of ``{name: (values, finest step)}``, rows first."""
    planes, described = [], []
    for name, (values, finest) in arrays.items():
        codes, step, offset = quantise(values, finest)
        rows = codes.reshape(len(codes), -1).view(np.uint16)
        changes = np.diff(rows, axis=0, prepend=np.zeros((1, rows.shape[1]), np.uint16))
        planes += [(changes & 0xFF).astype(np.uint8).T.tobytes(), (changes >> 8).astype(np.uint8).T.tobytes()]
        described.append({"name": name, "shape": list(np.shape(values)), "step": step, "offset": offset})
    return base64.b64encode(zlib.compress(b"".join(planes), 6)).decode("ascii"), described


def unpack(text: str, described: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Return the arrays of ``pack``; absent values are NaN."""
    data = zlib.decompress(base64.b64decode(text))
    arrays, at = {}, 0
    for item in described:
        rows = item["shape"][0]
        size = int(np.prod(item["shape"], dtype=np.int64))
        low, high = (np.frombuffer(data, np.uint8, size, at + part * size) for part in (0, 1))
        at += 2 * size
        changes = (low.astype(np.uint16) | high.astype(np.uint16) << 8).reshape(-1, rows).T
        codes = np.cumsum(changes, axis=0, dtype=np.uint16).view(np.int16).reshape(item["shape"])
        values = codes * item["step"] + item["offset"]
        arrays[item["name"]] = np.where(codes == ABSENT, np.nan, values)
    return arrays
