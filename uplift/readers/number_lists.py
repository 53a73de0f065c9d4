"""Lists of numbers as JSON holds them, checked one by one, as one array."""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np

from uplift.errors import UserError
from uplift.readers.json_file import shown

__all__ = ["Numbers"]

_BLOCK = 4096
_KINDS = {int, float, type(None)}


class Numbers:
    """Lists of numbers, one a row and all of one length, that become one float32 array.

    ``what`` names them in errors. Lists may hold lists, which are taken one after the other.
    """

    def __init__(self, what: str):
        self.what = what
        self.rows = 0
        self.width: int | None = None
        self._first = ""
        self._waiting: list[Any] = []
        self._places: list[str] = []
        self._blocks: list[np.ndarray] = []

    def add(self, values: Any, where: str) -> None:
        """Take the next row; ``where`` names it in errors.

        Raises:
            UserError: no list of numbers, or not as long as the rows before it.
        """
        flat = self.flat(values, where)
        if len(flat) != self.width:
            if self.width is not None:
                raise UserError(
                    f"{where}: '{self.what}' has {len(flat)} numbers, but {self.width} in {self._first}. "
                    "Expected the same keypoints everywhere."
                )
            self.width, self._first = len(flat), where
        self._waiting.extend(flat)
        self._places.append(where)
        self.rows += 1
        if len(self._places) >= _BLOCK:
            self._flush()

    def flat(self, values: Any, where: str) -> list[Any]:
        """Return numbers, or lists of them, as one list; raises UserError for anything else."""
        flat = values
        if type(values) is list and values and type(values[0]) is list:
            parts = set(map(type, values)) == {list} and len(set(map(len, values))) == 1
            flat = list(chain.from_iterable(values)) if parts else None
        if type(flat) is not list or not set(map(type, flat)) <= _KINDS:
            raise UserError(f"{where}: '{self.what}' is {shown(values)}, expected a list of numbers.")
        return flat

    def _flush(self) -> None:
        width = self.width or 0
        try:
            block = np.array(self._waiting, np.float64)
        except OverflowError:
            wrong = next(n for n, value in enumerate(self._waiting) if _too_large(value))
            where = self._places[wrong // max(width, 1)]
            raise UserError(f"{where}: '{self.what}' holds a number of more digits than any pixel has.") from None
        with np.errstate(over="ignore"):
            self._blocks.append(block.reshape(len(self._places), width).astype(np.float32))
        self._waiting, self._places = [], []

    def array(self, *shape: int) -> np.ndarray:
        """Return all rows, (rows, *shape); with no shape (rows, numbers)."""
        self._flush()
        self._blocks = [np.concatenate(self._blocks)]
        return self._blocks[0].reshape(self.rows, *(shape or (self.width or 0,)))


def _too_large(value: Any) -> bool:
    try:
        float(value or 0)
    except OverflowError:
        return True
    return False
