"""Long inputs part by part: what is lifted at a time, where a long clip is cut, and frames that nobody is in."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from uplift.data.clean import clean
from uplift.data.poses import USUAL_FPS, PoseData
from uplift.errors import UserError
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton

__all__ = ["AT_ONCE", "PART_FRAMES", "Piece", "lift_piece", "pieces"]

AT_ONCE = 200_000
"""Frames up to which an input is lifted as a whole: clips then learn from one another, and it takes 2 GB at most."""
PART_FRAMES = 50_000
"""Frames of a part of a longer one: large enough for what is learned of all its clips, and some 300 MB."""
_SCRAP = 0.25
"""Of a part: what is smaller is lifted with the part before it, as little is learned from it alone."""
_BESIDE_SECONDS = 4.0
_LEAST_BESIDE = 120
"""Frames on either side that a piece of a clip is lifted with. More than half a second of live use needs, which is 3.5 s."""


class Piece(NamedTuple):
    """What is lifted together."""

    data: PoseData
    kept: slice
    """The rows that are the piece's own; the others are those before and after a cut, for the frames beside it."""

    @property
    def frames(self) -> int:
        """How many rows are its own."""
        return len(range(*self.kept.indices(len(self.data))))


def pieces(parts: Iterable[PoseData], frames: int, *, cut: bool = True) -> Iterator[Piece]:
    """Yield every row of ``parts`` once, in order, in pieces of about ``frames``.

    Parts are whole clips, one after the other. A part that is longer, which is one clip or several that take turns, is
    cut unless ``cut`` is off, and each piece of it is lifted with the frames on both sides of it. A short part goes with
    the one before.
    """
    for part in _without_scraps(parts, frames):
        if not cut or len(part) <= (1 + _SCRAP) * frames or not _in_time(part):
            yield Piece(part, slice(0, len(part)))
            continue
        edges = np.linspace(0, len(part), -(-len(part) // frames) + 1).round().astype(int).tolist()
        beside = min(_rows_beside(part), frames)
        for start, end in pairwise(edges):
            low, high = max(0, start - beside), min(len(part), end + beside)
            yield Piece(part.select(slice(low, high)), slice(start - low, end - low))


def _without_scraps(parts: Iterable[PoseData], frames: int) -> Iterator[PoseData]:
    """Yield the parts, the short ones joined to those before them."""
    held: PoseData | None = None
    for part in parts:
        if held is None or len(part) >= _SCRAP * frames or len(held) > frames:
            if held is not None:
                yield held
            held = part
        else:
            held = PoseData.concat([held, part], notes=tuple(dict.fromkeys((*held.notes, *part.notes))))
    if held is not None:
        yield held


def _in_time(part: PoseData) -> bool:
    """Return whether the frames of each clip follow one another in the rows."""
    return bool((part.previous() < np.arange(len(part))).all())


def _rows_beside(part: PoseData) -> int:
    """Return how many rows of a part go with a piece on either side: clips that take turns need more."""
    seconds = round(_BESIDE_SECONDS * (part.fps or USUAL_FPS))
    return max(_LEAST_BESIDE, seconds) * len(np.unique(part.clips()))


# Frames that nobody is in.


def lift_piece(predict: Callable[[PoseData], Prediction], piece: Piece, skeleton: Skeleton) -> Prediction:
    """Return the poses of a piece's own rows.

    A piece without a frame that can be lifted, which a whole file is refused for, is lifted with a stand-in: its rows
    are NaN as theirs are in a longer file.
    """
    data = piece.data
    if can_be_lifted(data, skeleton):
        return predict(data).select(piece.kept)
    stand_in = data.select([0])
    points = np.random.default_rng(0).normal(500, 100, stand_in.keypoints.shape).astype(np.float32)
    stand_in = replace(stand_in, keypoints=points, confidence=np.ones_like(stand_in.confidence))
    found = predict(PoseData.concat([data, stand_in])).select(slice(0, len(data)))
    return replace(found.select(piece.kept), notes=data.notes)  # others are about the stand-in


_LOOKED_AT = 1000


def can_be_lifted(data: PoseData, skeleton: Skeleton) -> bool:
    """Return whether there is a frame that `uplift.data.clean.clean` leaves."""
    starts = range(0, len(data), _LOOKED_AT)
    return any(_is_clean(data.select(slice(start, start + _LOOKED_AT)), skeleton) for start in starts)


def _is_clean(data: PoseData, skeleton: Skeleton) -> bool:
    try:
        clean(data, skeleton)
    except UserError:
        return False
    return True
