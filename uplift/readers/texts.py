"""Columns of text from files that nobody vouches for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uplift.errors import UserError

__all__ = ["texts"]

_LONGEST = 4000
_MOST = 500_000_000


def texts(path: Path, values: Sequence[str]) -> np.ndarray:
    """Return names of rows as an array of text, in which every name takes the room of the longest.

    Raises:
        UserError: a name so long that the array would not fit in memory.
    """
    longest = max(map(len, values), default=0)
    if longest > _LONGEST or longest * len(values) > _MOST:
        name = next(value for value in values if len(value) == longest)
        raise UserError(f"{path} has a name of {longest:,} characters ({name[:40]!r}...), expected short ones.")
    return np.array(values) if len(values) else np.empty(0, "U1")
