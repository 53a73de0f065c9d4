"""Which joints a bone may join, out of 2D alone: those that stay close and keep their distance."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float, Shaped

from uplift.skeleton import Skeleton

__all__ = ["TOO_LONG", "apart", "joining_bones", "seen_in", "stretch_of", "stretched"]

TOO_LONG = 1.9
"""From where `stretched` says that joints have each other's names."""

Bone = tuple[str, str]

_MOST_NUMBERS = 2_000_000  # frames x joints x joints at once
_SMOOTHING = 0.05  # of the mean distance, so that few frames are judged by their distances, not by luck
_IN_A_ROW = 0.5  # how far apart tail_1 and tail_2 count


def seen_in(
    keypoints: Shaped[np.ndarray, "frames joints 2"], confidence: Shaped[np.ndarray, "frames joints"]
) -> Bool[np.ndarray, "frames joints"]:
    """Return which joints are visible: confidence above 0 and a finite place."""
    return (confidence > 0) & np.isfinite(keypoints).all(-1)


def apart(
    keypoints: Shaped[np.ndarray, "frames joints 2"],
    visible: Bool[np.ndarray, "frames joints"],
    names: Sequence[str],
) -> Float[np.ndarray, "joints joints"]:
    """Return how little a bone is to be expected between two joints: the geometric mean of their mean distance and of
    how much it varies over the frames, in sizes of the body; infinite where no frame shows both.

    Names in a row (tail_1, tail_2) count as closer.
    """
    distance = _distances(*_some_rows(keypoints, visible))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # pairs that no frame shows
        mean, varies = np.nanmean(distance, axis=0), np.nanstd(distance, axis=0)
    score = np.sqrt(mean * (varies + _SMOOTHING * mean))
    score[np.isnan(score)] = np.inf
    rows = np.array([[_in_a_row(one, other) for other in names] for one in names])
    return np.where(rows, _IN_A_ROW * score, score)


def joining_bones(
    score: Float[np.ndarray, "joints joints"],
    names: Sequence[str],
    mirror: Sequence[tuple[str, str]] = (),
    known: Sequence[Bone] = (),
) -> list[Bone]:
    """Return the bones that join all joints with the least sum of scores, beside those that are ``known``.

    The same on both sides: joints on the midline are joined first, then pairs to them and to each
    other (a minimum spanning tree of the halves).
    """
    at = {name: place for place, name in enumerate(names)}
    across = np.arange(len(names))
    for one, other in mirror:
        across[[at[one], at[other]]] = at[other], at[one]
    score = np.minimum(score, score.max(where=np.isfinite(score), initial=1.0) * 10)
    score = (score + score[across][:, across]) / 2
    group = _Groups(len(names))
    for one, other in known:
        group.join(at[one], at[other])
    middle = [place for place in range(len(names)) if across[place] == place]
    found: list[tuple[int, int]] = []
    if not middle:  # nothing but pairs: one of them holds the sides together
        held = [place for place in range(len(names)) if group.of(place) == group.of(int(across[place]))]
        first = min(held or range(len(names)), key=lambda place: float(score[place, across[place]]))
        middle = [first]
        found += group.joined((first, int(across[first])))
    found += _grown(score, middle, across, group, lambda place: across[place] == place)
    found += _grown(score, range(len(names)), across, group, lambda place: True)
    return [(names[one], names[other]) for one, other in found]


def stretched(
    keypoints: Shaped[np.ndarray, "frames joints 2"],
    visible: Bool[np.ndarray, "frames joints"],
    bones: Sequence[Sequence[int]],
) -> float:
    """Return how many times as long as need be the bones are: their mean over that of the shortest lines that join
    the joints. 1 to 1.6 where the names are right, 2 or more where joints were given each other's; NaN where nothing is seen.
    """
    seen = np.flatnonzero(visible.any(0))
    if len(seen) < 3:
        return float("nan")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        mean = np.nanmean(_distances(*_some_rows(keypoints[:, seen], visible[:, seen])), axis=0)
    at = {int(place): number for number, place in enumerate(seen)}
    ours = [mean[at[one], at[other]] for one, other in bones if one in at and other in at]
    ours = [length for length in ours if np.isfinite(length)]
    if not ours:
        return float("nan")
    names = [str(number) for number in range(len(seen))]
    score = np.where(np.isfinite(mean), mean, np.inf)
    least = [mean[int(one), int(other)] for one, other in joining_bones(score, names)]
    return float(np.mean(ours) / max(np.nanmean(least), 1e-9))


def stretch_of(
    keypoints: Shaped[np.ndarray, "frames joints 2"],
    confidence: Shaped[np.ndarray, "frames joints"],
    skeleton: Skeleton,
) -> float:
    """Return how far the bones of ``skeleton`` are stretched in keypoints of its joints; 0 where nothing is seen."""
    visible = seen_in(keypoints, confidence)
    return float(np.nan_to_num(stretched(keypoints, visible, skeleton.bone_indices.tolist())))


def _grown(
    score: np.ndarray, places: Sequence[int] | range, across: np.ndarray, group: _Groups, may: Callable[[int], bool]
) -> Iterator[tuple[int, int]]:
    """Join what ``places`` holds to the group of its first joint, the nearest first, each bone with its mirror image."""
    start = next((place for place in places if may(place) and across[place] == place), places[0])
    while True:
        inside = [place for place in range(len(score)) if group.of(place) == group.of(start)]
        outside = [place for place in places if group.of(place) != group.of(start)]
        if not outside:
            return
        between = score[np.ix_(inside, outside)]
        one, other = np.unravel_index(int(between.argmin()), between.shape)
        bone = inside[int(one)], outside[int(other)]
        yield from group.joined(bone)
        yield from group.joined((int(across[bone[0]]), int(across[bone[1]])))


class _Groups:
    """Which places bones join so far."""

    def __init__(self, count: int) -> None:
        self._group = list(range(count))

    def of(self, place: int) -> int:
        while self._group[place] != place:
            self._group[place] = place = self._group[self._group[place]]
        return place

    def join(self, one: int, other: int) -> None:
        self._group[self.of(other)] = self.of(one)

    def joined(self, bone: tuple[int, int]) -> list[tuple[int, int]]:
        """Join two places; the bone, unless they were joined before."""
        if self.of(bone[0]) == self.of(bone[1]):
            return []
        self.join(*bone)
        return [bone]


def _some_rows(keypoints: np.ndarray, visible: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frames that show three joints or more, as many as the memory holds, spread evenly."""
    rows = np.flatnonzero(visible.sum(1) >= 3)
    most = max(2, _MOST_NUMBERS // keypoints.shape[1] ** 2)
    if len(rows) > most:
        rows = rows[np.linspace(0, len(rows) - 1, most).astype(int)]
    return keypoints[rows].astype(np.float64), visible[rows]


def _distances(keypoints: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Return (frames joints joints) distances in sizes of the body in that frame; NaN where a joint is hidden.

    The size is that of the visible joints' spread, then what makes the distances most alike over the
    frames: hidden joints do not shrink the body.
    """
    points = np.where(visible[..., None], keypoints, np.nan)
    found = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        spread = np.sqrt(np.nanmean(found**2, axis=(1, 2)))
        found /= np.where(spread > 0, spread, np.nan)[:, None, None]
        usual = np.nanmedian(found, axis=0)
        size = np.nanmedian(found / np.where(usual > 0, usual, np.nan), axis=(1, 2))
    return found / np.where(size > 0, size, np.nan)[:, None, None]


def _in_a_row(one: str, other: str) -> bool:
    """Return whether two names differ in one number alone, by one."""
    first, second = (re.split(r"(\d+)", name) for name in (one, other))
    if len(first) != len(second):
        return False
    differ = [(a, b) for a, b in zip(first, second, strict=True) if a != b]
    return (
        len(differ) == 1
        and all(text.isdigit() for text in differ[0])
        and abs(int(differ[0][0]) - int(differ[0][1])) == 1
    )
