"""Look over the heaps of text in an HDF5 file before the library does: a wrong size there makes it walk in circles."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

__all__ = ["heaps_are_sound"]

_START = b"GCOL\x01\0\0\0"
_HEADER = 16
_MOST_BYTES = 2**33
"""Longer files are not looked over: that would take longer than reading what is asked of them."""


def heaps_are_sound(path: Path) -> bool:
    """Return whether every object of every heap (global heap collection, version 1) ends inside its heap."""
    size = path.stat().st_size
    if not 0 < size < _MOST_BYTES:
        return True
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(_START)
        while start >= 0:
            if not _is_sound(content, start, size):
                return False
            start = content.find(_START, start + len(_START))
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
