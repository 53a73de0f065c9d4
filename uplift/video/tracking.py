"""People followed from frame to frame: who is who, who is there long enough to be somebody, and which side is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from uplift.data.poses import USUAL_FPS
from uplift.skeleton.propose import mirror_pairs, seen_in

__all__ = ["Tracker", "chosen_tracks", "partners", "sizes_of", "swapped_sides"]

_LOST_S = 1.0
"""Someone who was not seen for longer is someone new."""
_FAR = 0.6
"""Mean distance of the joints, in sizes of the body, from where they are expected, beyond which it is someone else."""
_SIZES = 2.0
"""Nobody grows or shrinks by this factor from one sight to the next."""
_STEADY = 0.5
"""How much of the velocity of before is kept."""
_NEVER = 1e6


@dataclass
class _Track:
    """Someone as last seen."""

    number: int
    keypoints: np.ndarray
    seen: np.ndarray
    size: float
    frame: int
    velocity: np.ndarray
    """(2,) px a frame, of the middle."""


class Tracker:
    """Gives everyone in each frame a number, the same from frame to frame.

    People are paired with those of before where they are expected, at constant velocity, so that the mean distance of their
    joints in sizes of the body is least over all of them (the assignment of Kuhn 1955).
    """

    def __init__(self, fps: float | None = None):
        self._patience = round(_LOST_S * (fps or USUAL_FPS))
        self._tracks: list[_Track] = []
        self._count = 0

    def follow(
        self,
        keypoints: Float[np.ndarray, "people joints 2"],
        confidence: Float[np.ndarray, "people joints"],
        frame: int,
    ) -> Int[np.ndarray, " people"]:
        """Return the number of each; frames come in order."""
        from scipy.optimize import linear_sum_assignment

        self._tracks = [one for one in self._tracks if frame - one.frame <= self._patience]
        seen = seen_in(keypoints, confidence)
        sizes = sizes_of(keypoints, confidence).tolist()
        cost = np.full((len(keypoints), len(self._tracks)), _NEVER)
        for place, (points, there, size) in enumerate(zip(keypoints, seen, sizes, strict=True)):
            for other, track in enumerate(self._tracks):
                cost[place, other] = _apart(points, there, size, track, frame)
        pairs = dict(zip(*(ends.tolist() for ends in linear_sum_assignment(cost)), strict=True))
        numbers = np.zeros(len(keypoints), np.int64)
        for place, (points, there, size) in enumerate(zip(keypoints, seen, sizes, strict=True)):
            other = pairs.get(place, -1)
            if other >= 0 and cost[place, other] <= _FAR:
                track = self._tracks[other]
                _move(track, points, there, size, frame)
            else:
                track = _Track(self._count, points, there, size, frame, np.zeros(2))
                self._tracks.append(track)
                self._count += 1
            numbers[place] = track.number
        return numbers


def sizes_of(
    keypoints: Float[np.ndarray, "rows joints 2"], confidence: Float[np.ndarray, "rows joints"]
) -> Float[np.ndarray, " rows"]:
    """Return the larger side of the box around the visible joints of each, px; 1 at least."""
    seen = seen_in(keypoints, confidence)[..., None]
    low, high = (np.where(seen, keypoints, blank) for blank in (np.inf, -np.inf))
    return np.maximum((high.max(1) - low.min(1)).max(-1), 1.0)


def _apart(points: np.ndarray, seen: np.ndarray, size: float, track: _Track, frame: int) -> float:
    """Return the mean distance of the joints that both show from where those of a track are expected, in sizes of the body."""
    both = seen & track.seen
    larger = max(size, track.size)
    if not both.any() or larger > _SIZES * min(size, track.size):
        return _NEVER
    expected = track.keypoints[both] + track.velocity * (frame - track.frame)
    return float(np.linalg.norm(points[both] - expected, axis=-1).mean() / larger)


def _move(track: _Track, points: np.ndarray, seen: np.ndarray, size: float, frame: int) -> None:
    """Let a track be where it is seen now."""
    both = seen & track.seen
    velocity = (points[both] - track.keypoints[both]).mean(0) / max(frame - track.frame, 1)
    track.velocity = _STEADY * track.velocity + (1 - _STEADY) * velocity
    track.keypoints, track.seen, track.size, track.frame = points, seen, size, frame


# Which of those who were followed are people, and which of them are wanted.

_SHORTEST_S = 0.5
"""What is found for less than this is hardly a person."""


def chosen_tracks(
    track: Int[np.ndarray, " rows"],
    size: Float[np.ndarray, " rows"],
    fps: float | None,
    frames: int,
    people: int | None = None,
) -> list[int]:
    """Return the tracks that last, the largest and longest first (by the sum of their sizes), at most ``people``.

    A track lasts where it has half a second of frames, or half of all ``frames`` of a video that is shorter.
    """
    numbers, row = np.unique(track, return_inverse=True)
    lasting = np.bincount(row) >= min(_SHORTEST_S * (fps or USUAL_FPS), frames / 2)
    weight = np.where(lasting, np.bincount(row, size), -1)
    order = np.argsort(-weight, kind="stable")
    return [int(numbers[one]) for one in order if weight[one] >= 0][:people]


# Left and right, which detectors take for each other in some frames.

_SWAPPED = 0.5
"""Sides are swapped where that brings the joints this much nearer to where they were."""
_MOVED = 0.03
"""Distances below this share of the body's size tell nothing: seen from the side left and right are in one place."""
_NEXT_S = 0.2
"""After a longer gap someone may have turned round."""


def swapped_sides(
    keypoints: Float[np.ndarray, "frames joints 2"],
    confidence: Float[np.ndarray, "frames joints"],
    frame: Int[np.ndarray, " frames"],
    names: Sequence[str],
    fps: float | None = None,
) -> Bool[np.ndarray, " frames"]:
    """Return the frames of one track in which left and right of the whole body are taken for each other.

    Nobody turns round from one frame to the next: where all joints that have a partner are far nearer to their partners of
    the frame before, the sides are swapped from there on, until they are again. Of the two ways to name the sides
    of such a stretch, the one that most of its frames have (by confidence) is right.
    """
    found = np.zeros(len(frame), bool)
    partner = partners(names)
    sided = partner != np.arange(len(names))
    nearest = _NEXT_S * (fps or USUAL_FPS)
    if not sided.any() or nearest < 1:
        return found
    points, others = keypoints[:, sided], keypoints[:, partner][:, sided]
    seen = seen_in(keypoints, confidence)
    seen = seen[:, sided] & seen[:, partner][:, sided]
    both = seen[1:] & seen[:-1]
    stayed, changed = (_mean_way(points[:-1], after[1:], both) for after in (points, others))
    turns = (changed < _SWAPPED * stayed) & (stayed > _MOVED * sizes_of(keypoints, confidence)[1:])
    found[1:] = np.cumsum(turns) % 2 == 1
    starts = np.flatnonzero(np.diff(frame, prepend=frame[:1] - 2 * round(nearest + 1)) > nearest)
    for start, end in zip(starts, [*starts[1:], len(frame)], strict=True):
        weight = confidence[start:end].sum(1)
        found[start:end] ^= weight[found[start:end]].sum() > weight.sum() / 2
    return found


def partners(names: Sequence[str]) -> Int[np.ndarray, " joints"]:
    """Return the place of each joint's partner on the other side, by its name; its own where it has none."""
    places, found = {name: place for place, name in enumerate(names)}, np.arange(len(names))
    for right, left in mirror_pairs(names):
        found[places[right]], found[places[left]] = places[left], places[right]
    return found


def _mean_way(before: np.ndarray, after: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return (frames,) mean distances of the joints that are seen in both; 0 without any."""
    way = np.linalg.norm(np.where(seen[..., None], after - before, 0), axis=-1)
    return way.sum(1) / np.maximum(seen.sum(1), 1)
