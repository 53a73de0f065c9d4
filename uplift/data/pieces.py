"""Where the rows of a file are cut so that clips stay whole."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from jaxtyping import Int

from uplift.data.poses import PoseData

__all__ = ["cuts", "pieces_of"]


def pieces_of(data: PoseData, frames: int) -> Iterator[PoseData]:
    """Yield the rows of ``data`` in order, in pieces of whole clips: at most ``frames`` each, or one clip that is longer.

    Clips whose rows take turns stay together, however many they are.
    """
    if len(data) <= frames:
        yield data
        return
    ends = cuts(*_runs(data), len(data), frames)
    for start, end in pairwise(ends):
        yield data.select(slice(start, end))


def _runs(data: PoseData) -> tuple[np.ndarray, np.ndarray]:
    """Return the first row of each run of frames of one clip, and the number of its clip."""
    clip = data.clips()
    starts = np.flatnonzero(np.diff(clip, prepend=-1))
    return starts, clip[starts]


def cuts(starts: Int[np.ndarray, " runs"], clip: Int[np.ndarray, " runs"], rows: int, frames: int) -> list[int]:
    """Return the rows at which pieces of whole clips begin, and ``rows``, where the last one ends.

    Args:
        starts: first row of each run of rows of one clip, from 0.
        clip: the number of its clip, from 0.
        rows: rows in all.
        frames: rows of a piece at most, where no clip is longer.
    """
    runs = np.arange(len(clip))
    last = np.zeros(int(clip.max(initial=0)) + 1, np.int64)
    last[clip] = runs  # of equal clips the last run
    ends = np.append(starts[1:], rows)[np.maximum.accumulate(last[clip]) == runs]
    found = [0]
    while found[-1] < rows:
        place = int(np.searchsorted(ends, found[-1] + frames, side="right")) - 1
        if place < 0 or ends[place] <= found[-1]:  # one clip alone is longer
            place = int(np.searchsorted(ends, found[-1], side="right"))
        found.append(int(ends[place]))
    return found
