"""`Names`: what many frames are of, as numbers and the few names that these stand for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

__all__ = ["Names", "codes_of"]


class Names:
    """A column of text that takes a byte or a few for each row, and behaves as the NumPy array of text that it stands for.

    Rows that are picked are `Names` again; functions of NumPy are given the text.
    """

    __slots__ = ("codes", "names")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, codes: np.ndarray, names: np.ndarray):
        """``codes`` are places in ``names``."""
        self.codes, self.names = codes.astype(np.min_scalar_type(max(0, len(names) - 1)), copy=False), names

    @classmethod
    def of(cls, values: Any) -> Names:
        """Return an array of text as names."""
        if isinstance(values, Names):
            return values
        names, codes = codes_of(np.asarray(values, str))
        return cls(codes, names)

    @classmethod
    def concat(cls, parts: Sequence[Any]) -> Names:
        """Return the rows of all ``parts``, one after the other."""
        parts = [cls.of(part) for part in parts]
        if all(part.names is parts[0].names for part in parts):
            return cls(np.concatenate([part.codes for part in parts]), parts[0].names)
        names = np.unique(np.concatenate([part.names for part in parts]))
        wide = np.min_scalar_type(max(0, len(names) - 1))
        places = [np.searchsorted(names, part.names).astype(wide) for part in parts]
        codes = [place[part.codes] if len(place) else place for place, part in zip(places, parts, strict=True)]
        return cls(np.concatenate(codes), names)

    # As an array.

    @property
    def dtype(self) -> np.dtype:
        """The type of the text."""
        return self.names.dtype

    @property
    def shape(self) -> tuple[int]:
        """The number of rows."""
        return self.codes.shape  # type: ignore[return-value]

    @property
    def size(self) -> int:
        """The number of rows."""
        return self.codes.size

    @property
    def nbytes(self) -> int:
        """Bytes of the numbers and the names."""
        return self.codes.nbytes + self.names.nbytes

    ndim = 1

    def __len__(self) -> int:
        return len(self.codes)

    def __iter__(self) -> Iterator[np.str_]:
        return iter(np.asarray(self))

    def __getitem__(self, rows: Any) -> Any:
        picked = self.codes[rows]
        return Names(picked, self.names) if isinstance(picked, np.ndarray) and picked.ndim == 1 else self.names[picked]

    def __setitem__(self, rows: Any, values: Any) -> None:
        text = np.asarray(self).astype(object)  # which longer names fit into
        text[rows] = values
        changed = Names.of(text.astype(str))
        self.codes, self.names = changed.codes, changed.names

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if not len(self.names):
            return np.empty(0, self.names.dtype if dtype is None else dtype)
        return self.names[self.codes].astype(self.names.dtype if dtype is None else dtype, copy=False)

    def __array_function__(self, function: Any, types: Any, given: Any, options: Any) -> Any:
        return function(*_plain(given), **_plain(options))

    def __eq__(self, other: Any) -> Any:
        return (self.names == other)[self.codes] if isinstance(other, str) else np.asarray(self) == other

    def __ne__(self, other: Any) -> Any:
        return ~(self == other)

    def __repr__(self) -> str:
        return f"Names({len(self):,} rows, {len(self.names):,} names)"

    def astype(self, dtype: Any, copy: bool = True) -> np.ndarray:
        """Return the text as an array of that type."""
        return np.asarray(self).astype(dtype, copy=False)

    def tolist(self) -> list[str]:
        """Return the text of each row."""
        return np.asarray(self).tolist()


def _plain(value: Any) -> Any:
    """Return arguments with arrays in place of names."""
    if isinstance(value, Names):
        return np.asarray(value)
    if isinstance(value, (list, tuple)):
        return type(value)(map(_plain, value))
    return {key: _plain(one) for key, one in value.items()} if isinstance(value, dict) else value


def codes_of(values: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return what ``np.unique(values, return_inverse=True)`` does, quickly for names, and where equal values stand together."""
    if isinstance(values, Names):
        places, code = codes_of(values.codes)
        names = values.names[places]
        if (names[1:] > names[:-1]).all():
            return names, code
        names, place = np.unique(names, return_inverse=True)
        return names, place[code]
    starts = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]])) if len(values) else np.zeros(0, int)
    names, code = np.unique(values[starts], return_inverse=True)
    return names, np.repeat(code, np.diff(np.append(starts, len(values))))
