"""Records of JSON for each frame: its number, its bodies, their keypoints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.reading.bodies import Chunk, Walk
from benchmarks.reading.lines import GAP, decimals, filled, whole_numbers

__all__ = ["POINT", "SCORE", "Cells", "each", "gaps", "lists", "number", "together", "xyc"]

POINT, SCORE = 13, 16  # decimals of a network's numbers: all that a double has
Cells = list[np.ndarray]


def gaps(count: int, of: str = GAP) -> str:
    return ", ".join([of] * count)


def lists(path: Path, walk: Walk, start: str, template: str, cells: Callable[[Chunk], Cells], end: str) -> None:
    """Write a list with one record a frame of ``walk``."""
    with path.open("wb") as file:
        file.write(start.encode())
        for chunk in walk.chunks():
            text = filled(template + ", ", cells(chunk))
            last = chunk.frame[-1] == walk.frames - 1
            file.write(text[:-2] if last else text)
        file.write(end.encode())


def together(*arrays: np.ndarray) -> Cells:
    """Return the arrays' gaps in turns."""
    return [array[:, gap : gap + 1] for gap in range(arrays[0].shape[1]) for array in arrays]


def number(values: np.ndarray) -> np.ndarray:
    return whole_numbers(values)[:, None]


def xyc(chunk: Chunk, body: int, points: int = POINT, scores: int = SCORE) -> tuple[np.ndarray, ...]:
    """Return the (frames, joints, width) bytes of x, y and score of one body."""
    lost = chunk.missing[:, body]
    xy = (decimals(chunk.xy[:, body, :, axis], points, lost, seed=axis) for axis in (0, 1))
    return (*xy, decimals(chunk.score[:, body], scores, lost, seed=2))


def each(walk: Walk, body: Callable[[Chunk, int], Cells], *, numbers: int = 1) -> Callable[[Chunk], Cells]:
    """Return what fills a frame's record: its number so many times, then its bodies."""

    def cells(chunk: Chunk) -> Cells:
        found = [number(chunk.frame)] * numbers
        for one in range(walk.bodies):
            found += body(chunk, one)
        return found

    return cells
