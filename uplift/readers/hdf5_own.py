"""What of an HDF5 file lies in the file itself, and is no larger than the file can hold."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from uplift.errors import UserError

__all__ = ["Elsewhere", "OwnParts", "check_room"]

_MOST_LINKS = 8
_SMALL = 2**26
"""Arrays of fewer bytes are taken without asking how many bytes stand behind them."""
_MOST_PACKED = 1100
"""Deflate, the filter of these files, packs 1032 bytes into one at most."""


def check_room(path: Path, what: str, wanted_bytes: int) -> None:
    """Raise UserError where something would take more than half of this machine's memory."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if wanted_bytes > memory // 2:
        raise UserError(
            f"{path}: {what} would take {wanted_bytes / 1e9:.1f} GB, more than half of this machine's memory "
            f"({memory / 1e9:.1f} GB)."
        )


class Elsewhere(UserError):
    """A link to another file."""


class OwnParts:
    """The groups and datasets of an open file; links inside it are followed, others never."""

    def __init__(self, path: Path, what: str, file: Any):
        self.path, self.what = path, what
        self._file = file
        self._groups: dict[str, Any] = {}
        self._taken = 0

    def find(self, name: str, hops: int = 0) -> Any:
        """Return a group or dataset, None where there is none; raises `Elsewhere` where it is a link to another file."""
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
                    raise UserError(f"{self.path}: '{walked}' is a link that leads round in circles.")
                place = self.find(link.path if link.path.startswith("/") else f"{place.name}/{link.path}", hops + 1)
            elif isinstance(link, h5py.HardLink):
                place = place[part]  # type: ignore[index]
            else:
                raise Elsewhere(f"{self.path}: '{walked}' is a link to elsewhere, which is never followed.")
            if isinstance(place, h5py.Group):
                self._groups[walked] = place
        return place

    def dataset(self, name: str) -> Any:
        """Return a dataset; raises UserError where its values are not here, or more than there can be."""
        import h5py

        item = self.find(name)
        if not isinstance(item, h5py.Dataset):
            raise UserError(f"{self.path}: no array '{name}', expected in {self.what}.")
        if item.shape is None or item.external or item.is_virtual:
            raise UserError(f"{self.path}: '{name}' has no values of its own, and others are never followed.")
        claimed, stored = _bytes(item.shape, item.dtype), item.id.get_storage_size()
        if claimed > max(_SMALL, _MOST_PACKED * stored) or _bytes(item.chunks or (), item.dtype) > 4 * _SMALL + claimed:
            raise UserError(f"{self.path}: '{name}' claims {claimed:,} bytes but holds {stored:,}: damaged file.")
        self._taken += claimed
        check_room(self.path, f"'{name}'" if self._taken == claimed else f"all up to '{name}'", self._taken)
        return item


def _bytes(shape: tuple[int, ...], dtype: np.dtype) -> int:
    return int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
