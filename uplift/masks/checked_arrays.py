"""Arrays of a file that nobody vouches for, each held against what it should be."""

from __future__ import annotations

import numpy as np

from uplift.errors import UserError

__all__ = ["CheckedArrays"]


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
