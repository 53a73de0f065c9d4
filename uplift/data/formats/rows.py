"""Rows of keypoints as formats find them become `PoseData`: confidence, tracks, and clips in order of time."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Float32, Num

from uplift.data.names import codes_of
from uplift.data.parsers.json import is_text, shown, texts
from uplift.data.poses import PoseData
from uplift.errors import UserError

__all__ = [
    "Bodies",
    "as_float32",
    "by_appearance",
    "confidence_of",
    "distinct",
    "frame_numbers",
    "honest",
    "link_bodies",
    "name_of",
    "named_tracks",
    "pairs_of",
    "pose_data",
    "rows_of",
    "same_or_none",
    "seen_by_flag",
    "split_names",
    "track_of",
    "video_name",
    "video_names",
    "visible_only",
]

# What readers do to keypoints and names alike: mark what is missing, tell equal names apart.

_T = TypeVar("_T")


def visible_only(
    keypoints: Num[np.ndarray, "... 2"], score: Num[np.ndarray, "..."]
) -> tuple[Float32[np.ndarray, "... 2"], Float32[np.ndarray, "..."]]:
    """Return keypoints with NaN where a coordinate is not a number or the score is not over 0, and scores with 0 for NaN."""
    score = as_float32(score)
    there = np.isfinite(as_float32(keypoints)).all(-1) & ~np.isnan(score)
    seen = there & (score > 0)
    keypoints = np.where(seen[..., None], as_float32(keypoints), np.float32(np.nan))
    return keypoints, np.where(there, score, np.float32(0))


def as_float32(values: Num[np.ndarray, "..."]) -> Float32[np.ndarray, "..."]:
    """Return numbers as float32; those too large for it are infinite."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32, copy=False)


def video_name(path: str) -> str:
    """Return the name of a video, without folders (of any system) and ending."""
    name = re.split(r"[\\/]", path.strip().rstrip("\\/"))[-1]
    return re.sub(r"(?<=.)\.[A-Za-z0-9]{1,5}$", "", name)


def distinct(names: Iterable[str]) -> list[str]:
    """Return the names, a later one that has been there before with ``#2``, ``#3`` ... behind it."""
    given: list[str] = []
    count: dict[str, int] = {}
    for name in names:
        new = name
        while new in count:
            count[name] += 1
            new = f"{name}#{count[name]}"
        count[new] = 1
        given.append(new)
    return given


def pairs_of(pairs: Iterable[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Return pairs of partners of which none is in two."""
    found: dict[str, str] = {}
    for a, b in pairs:
        if a != b and not {a, b} & (set(found) | set(found.values())):
            found[a] = b
    return tuple(found.items())


def same_or_none(values: Iterable[_T | None]) -> _T | None:
    """Return the value that all are; None where they differ, or there are none."""
    found = list(dict.fromkeys(values))
    return found[0] if len(found) == 1 else None


# Who is who from frame to frame, where a tracker lists bodies without naming them.

_FAR = 1.0
"""Mean distance of joints, in sizes of the body, beyond which two frames show different bodies."""
_LONGEST_GAP = 10
_ALIKE = 1e-6
_BLOCK = 20_000


def link_bodies(
    keypoints: Float[np.ndarray, "rows joints 2"],
    confidence: Float[np.ndarray, "rows joints"],
    frame: np.ndarray,
) -> np.ndarray:
    """Return (rows,) numbers of bodies, the same for one body in all frames of one video.

    Bodies of a frame are paired with those last seen, in the ten frames before it, so that the mean
    distance of their visible joints, in sizes of the body, is least over all of them (the assignment
    of Kuhn 1955); a body farther than its own size from all is a new one. Rows come in any order.
    """
    seen = np.isfinite(keypoints).all(-1) & (confidence > 0)
    bodies = _Bodies(keypoints, seen, _sizes(keypoints, seen))
    order = np.argsort(frame, kind="stable")
    starts = np.flatnonzero(np.diff(frame[order], prepend=frame[order][:1] - 1))
    body = np.zeros(len(frame), np.int64)
    if len(starts) == len(order):  # one body a frame: no assignment to solve
        new = np.ones(len(order), bool)
        new[1:] = bodies.apart(order[1:], order[:-1]) > _FAR
        new[1:] |= np.diff(frame[order]) > _LONGEST_GAP
        body[order] = np.cumsum(new) - 1
        return body
    body[order] = _followed(bodies, order, starts, frame[order[starts]])
    return body


def _followed(bodies: _Bodies, order: np.ndarray, starts: np.ndarray, times: np.ndarray) -> list[int]:
    """Return the number of the body of each row of ``order``, whose frames begin at ``starts``, at ``times``."""
    obvious, same = bodies.obvious(order, starts, times)
    bounds, whens, sames = [*starts.tolist(), len(order)], times.tolist(), same.tolist()
    found: list[int] = []
    here: list[int] = []  # the bodies of the frame before
    gone: dict[int, tuple[int, int]] = {}  # others of the last frames -> row and time when last seen
    count = 0
    for number, clear in enumerate(obvious.tolist()):
        start, end, now = bounds[number], bounds[number + 1], whens[number]
        if gone:
            gone = {one: last for one, last in gone.items() if now - last[1] <= _LONGEST_GAP}
        if clear and not gone:
            here = [here[place] for place in sames[start:end]]
            found += here
            continue
        if number and now - whens[number - 1] <= _LONGEST_GAP:
            before = order[start - len(here) : start].tolist()
            gone |= {one: (row, whens[number - 1]) for one, row in zip(here, before, strict=True)}
        known = sorted(gone)
        pairs = bodies.paired(order[start:end], np.array([gone[one][0] for one in known], np.int64))
        new = [place for place in range(end - start) if place not in pairs]
        fresh = dict(zip(new, range(count, count + len(new)), strict=True))
        here = [fresh[place] if place in fresh else known[pairs[place]] for place in range(end - start)]
        count += len(new)
        gone = {one: last for one, last in gone.items() if one not in here}
        found += here
    return found


@dataclass(frozen=True)
class _Bodies:
    """The bodies of all rows."""

    keypoints: np.ndarray
    seen: np.ndarray
    size: np.ndarray

    def paired(self, rows: np.ndarray, before: np.ndarray) -> dict[int, int]:
        """Return which of ``before`` each of ``rows`` is, by their places; those that are new are absent."""
        from scipy.optimize import linear_sum_assignment

        cost = np.empty((len(rows), len(before)))
        for place, one in enumerate(before):
            cost[:, place] = self.apart(rows, np.full(len(rows), one))
        pairs = zip(*(places.tolist() for places in linear_sum_assignment(cost)), strict=True)
        return {row: one for row, one in pairs if cost[row, one] <= _FAR}

    def obvious(self, order: np.ndarray, starts: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (frames,) which frames have the bodies of the frame before, each nearest to its own, and whose each row is.

        Where the nearest of all are different bodies, no other assignment can cost as little. The
        second has for each row of ``order`` the place of its body in the frame before.
        """
        size = np.diff(np.append(starts, len(order)))
        found, same = np.zeros(len(starts), bool), np.zeros(len(order), np.int64)
        alike = (size[1:] == size[:-1]) & (np.diff(times) <= _LONGEST_GAP)
        for count in np.unique(size[1:][alike]).tolist():
            frames = np.flatnonzero(alike & (size[1:] == count)) + 1
            for part in np.array_split(frames, -(-len(frames) * count**2 // _BLOCK)):
                rows = starts[part, None] + np.arange(count)
                before = np.broadcast_to(order[rows - count][:, None], (len(part), count, count))
                now = np.broadcast_to(order[rows][:, :, None], before.shape)
                cost = self.apart(now.ravel(), before.ravel()).reshape(before.shape)
                nearest = cost.argmin(2)
                least = np.sort(cost, 2)
                clear = (least[..., 0] <= _FAR).all(1) & (np.sort(nearest, 1) == np.arange(count)).all(1)
                if count > 1:  # of two as near as each other, neither is obvious
                    clear &= (least[..., 1] - least[..., 0] > _ALIKE).all(1)
                found[part], same[rows] = clear, nearest
        return found, same

    def apart(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Return mean distances, row by row, of the joints that both show, else of their middles, in sizes."""
        both = self.seen[one] & self.seen[other]
        gap = np.where(both[..., None], self.keypoints[one] - self.keypoints[other], 0)
        mean = np.linalg.norm(gap, axis=-1).sum(-1) / np.maximum(both.sum(-1), 1)
        none = ~both.any(-1)
        if none.any():
            mean[none] = np.linalg.norm(self._middle(one[none]) - self._middle(other[none]), axis=-1)
        return np.minimum(mean / np.maximum(self.size[one], self.size[other]), 10 * _FAR)

    def _middle(self, rows: np.ndarray) -> np.ndarray:
        weight = self.seen[rows][..., None]
        return np.where(weight, self.keypoints[rows], 0).sum(1) / np.maximum(weight.sum(1), 1)


def _sizes(keypoints: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return (rows,) the larger side of the box around each body's visible joints, px; at least half the usual one."""
    low = np.where(seen[..., None], keypoints, np.inf).min(1)
    high = np.where(seen[..., None], keypoints, -np.inf).max(1)
    side = (high - low).max(-1)
    known = side[np.isfinite(side) & (side > 0)]
    least = np.median(known) / 2 if len(known) else 1.0
    return np.fmax(np.where(np.isfinite(side), side, 0), least)


# Rows of keypoints that name their image, or their video and frame, become `PoseData`.

_LINKED = "bodies have no numbers: those of neighbouring frames are linked by place"
_TWICE = "a track number occurs twice in one frame: bodies are linked by place instead"
_SOME = "some bodies have no track: they are linked by place, as untracked 0 and so on"
_NUMBERED = re.compile(r"^(.*?)[ ._-]*?([0-9]{1,15})$", re.DOTALL)


def pose_data(
    path: Path,
    names: Sequence[str],
    keypoints: Float[np.ndarray, "rows joints 2"],
    confidence: Float[np.ndarray, "rows joints"],
    identity: dict[str, np.ndarray],
    *,
    notes: Sequence[str] = (),
    **known: object,
) -> PoseData:
    """Return the rows with a visible joint as `PoseData`, clip by clip where there are videos.

    In a video an ``instance`` that is empty, or not there although
    a frame has several bodies, is found by linking. ``known`` are further fields of `PoseData`.

    Raises:
        UserError: a name that comes twice, or no visible keypoint at all.
    """
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise UserError(f"{path} names '{twice[0]:.60}' twice among its keypoints; names must differ.")
    keypoints, confidence = honest(keypoints, confidence)
    seen = np.any(confidence > 0, axis=1)
    if not seen.any():
        raise UserError(f"{path} has no visible keypoint in it ({len(seen):,} bodies, {len(names)} keypoints each).")
    if not seen.all():
        keypoints, confidence = keypoints[seen], confidence[seen]
        identity = {key: value[seen] for key, value in identity.items()}
    found = list(notes)
    if "frame" in identity:
        identity, order = _clips(keypoints, confidence, identity, found)
        keypoints, confidence = keypoints[order], confidence[order]
        identity = {key: value[order] for key, value in identity.items()}
    return PoseData(
        keypoints=keypoints.astype(np.float32, copy=False),
        confidence=confidence,
        joint_names=tuple(names),
        identity=identity,
        notes=tuple(found),
        source=str(path),
        **known,  # type: ignore[arg-type]
    )


def honest(keypoints: np.ndarray, confidence: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return keypoints that are numbers or NaN, and a confidence that is a number, and 0 where they are NaN."""
    confidence = np.nan_to_num(confidence, nan=0, posinf=0, neginf=0).astype(np.float32, copy=False)
    finite = np.all(np.isfinite(keypoints), axis=-1)
    if finite.all():
        return keypoints, confidence
    return np.where(finite[..., None], keypoints, np.float32(np.nan)), np.where(finite, confidence, np.float32(0))


def _clips(
    keypoints: np.ndarray, confidence: np.ndarray, identity: dict[str, np.ndarray], notes: list[str]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the identity with a track for each body, and the order that puts the frames of each body together."""
    identity, frame = dict(identity), identity["frame"]
    _, video = codes_of(identity["sequence"])
    times, time = codes_of(frame)
    places, place = codes_of(video * len(times) + time)
    track = identity.pop("instance", np.full(len(frame), ""))
    nameless = track == ""
    if not nameless.all():
        tracks, who = codes_of(track)
        taken = (place * len(tracks) + who)[~nameless]
        if len(np.unique(taken)) < len(taken):
            notes.append(_TWICE)
            track = np.full(len(frame), "")
        elif nameless.any():
            notes.append(_SOME)
    elif len(places) < len(frame):
        notes.append(_LINKED)
    else:
        return identity, np.lexsort([frame, video])
    track = named_tracks(keypoints, confidence, video, frame, track)
    return {**identity, "instance": track}, np.lexsort([frame, codes_of(track)[1], video])


def named_tracks(
    keypoints: Float[np.ndarray, "rows joints 2"],
    confidence: Float[np.ndarray, "rows joints"],
    video: np.ndarray,
    frame: np.ndarray,
    track: np.ndarray,
) -> np.ndarray:
    """Return (rows,) names of tracks: bodies without one are linked by place, as "untracked 0" where others have one."""
    nameless = track == ""
    if not nameless.any():
        return track
    found = np.full(len(frame), "", dtype="U20")
    order = np.flatnonzero(nameless)[np.argsort(video[nameless], kind="stable")]
    for here in np.split(order, np.flatnonzero(np.diff(video[order])) + 1):
        found[here] = link_bodies(keypoints[here], confidence[here], frame[here]).astype(str)
    return found if nameless.all() else np.where(nameless, np.char.add("untracked ", found), track)


def seen_by_flag(third: Float[np.ndarray, "rows joints"], notes: list[str]) -> Float[np.ndarray, "rows joints"]:
    """Return the confidence that COCO's third numbers stand for: 0 missing, 1 occluded, 2 visible; or scores.

    Where no number is 2, 1 is taken as visible; where any is another number, all are scores.
    """
    if not (np.isin(third, (0, 1, 2)) | ~np.isfinite(third)).all():
        return third
    if (third == 2).any():
        return third / np.float32(2)
    notes.append("flags are 0 and 1 only: 1 is taken as visible, not as COCO's 'occluded'")
    return third


def split_names(stems: Sequence[str]) -> tuple[list[str], list[int]] | None:
    """Return the part before the number and the number that each name ends with; None where one has none."""
    found = [_NUMBERED.match(stem) for stem in stems]
    if not all(found):
        return None
    return [one[1] for one in found if one], [int(one[2]) for one in found if one]


def video_names(stems: Sequence[str], video: str) -> tuple[list[str], list[int]] | None:
    """Return (sequence, frame) of picture names that are numbers of a video's frames; None where they are not.

    They are where every name ends with a number, and at least half of the numbers between the first
    and the last of each name are there. A name that is a number only is of ``video``.
    """
    found = split_names(stems)
    if found is None or not found[0]:
        return None
    frames: dict[str, set[int]] = {}
    for sequence, frame in zip(*found, strict=True):
        frames.setdefault(sequence, set()).add(frame)
    for numbers in frames.values():
        if len(numbers) < 2 or 2 * len(numbers) < max(numbers) - min(numbers) + 1:
            return None
    return [sequence or video for sequence in found[0]], found[1]


@dataclass
class Bodies:
    """Where the bodies of JSON files belong: each one's image or file, frame, track and class."""

    path: Path
    """The file or folder that was given."""
    name: list[str] = field(default_factory=list)
    """Of the image or of the file, without ending."""
    frame: list[int | None] = field(default_factory=list)
    """None for a body of an image."""
    track: list[str] = field(default_factory=list)
    """Empty where a body has none."""
    category: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.name)

    def add(self, name: str, frame: int | None = None, track: str = "", category: str = "") -> None:
        """Take the next body."""
        self.name.append(name)
        self.frame.append(frame)
        self.track.append(track)
        self.category.append(category)

    def identity(self) -> dict[str, np.ndarray]:
        """Return sequence, frame and track of bodies in videos, image and number of the others.

        Several images that are numbered as a video's frames are one.
        """
        tracks = {"instance": texts(self.path, self.track)} if any(self.track) else {}
        tracks |= self._categories()
        if None not in self.frame:
            return {"sequence": texts(self.path, self.name), "frame": np.array(self.frame, np.int64), **tracks}
        names = list(dict.fromkeys(self.name))
        video = video_names(names, self.path.absolute().stem)
        if video is None or any(number is not None for number in self.frame):
            return self.images(self.name)
        place = {name: at for at, name in enumerate(names)}
        rows = np.array([place[name] for name in self.name])
        return {"sequence": texts(self.path, video[0])[rows], "frame": np.array(video[1], np.int64)[rows], **tracks}

    def images(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Return image and number of bodies whose images have these ``names``."""
        return {"image": texts(self.path, names), "instance": np.arange(len(self)).astype(str), **self._categories()}

    def _categories(self) -> dict[str, np.ndarray]:
        return {"category": texts(self.path, self.category)} if len(set(self.category)) > 1 else {}


def track_of(value: Any, where: str, key: str, kinds: tuple[type, ...] = (int, str)) -> str:
    """Return a track's number or name as text; nothing for None and -1.

    Raises:
        UserError: a value that is not of ``kinds``, or negative where names are not among them.
    """
    if value is None or value == -1:
        return ""
    unknown = isinstance(value, bool) or not isinstance(value, kinds) or value != value
    if unknown or (str not in kinds and value < 0):
        raise UserError(f"{where} has {key} {shown(value)}, expected the number of a track.")
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def name_of(value: Any, where: str, key: str, *, number: bool = True) -> str:
    """Return the name, or the ``number``, of an image or class as text; raises UserError for anything else."""
    if is_text(value) or (number and type(value) is int):
        return str(value)
    raise UserError(f"{where} has {key} {shown(value)}, expected a {'number or a ' if number else ''}name.")


# From the numbers of a table to rows of keypoints: what is missing, its confidence, and who is seen.

_FARTHEST_PX = 1e7
_LAST_FRAME = 2**53


def rows_of(
    path: Path,
    keypoints: np.ndarray,
    scores: np.ndarray | None,
    names: Sequence[str],
    identity: dict[str, np.ndarray],
    bodies: Sequence[str] = (),
    **known: object,
) -> PoseData:
    """Return (frames bodies joints 2) keypoints and (frames bodies joints) scores as rows, without bodies unseen.

    ``identity`` has (frames,) values; ``bodies`` names the bodies, and nothing where there is one
    without a name; ``known`` goes into the `PoseData` as it is. Missing are coordinates that are NaN,
    scores that are NaN or at most 0, and, where the file has no scores, keypoints at exactly (0, 0).

    Raises:
        UserError: coordinates beyond any image, a name twice, no visible joint.
    """
    _check_names(path, names, "joint")
    _check_names(path, bodies, "individual")
    confidence = confidence_of(keypoints, scores)
    _check_distance(path, keypoints, confidence, names)
    seen: np.ndarray = np.any(confidence > 0, axis=-1)
    if not seen.any():
        raise UserError(f"{path}: no visible joint in any of {len(keypoints):,} frames.")
    body, frame = np.nonzero(seen.T)  # one body after the other: its frames stand together
    rows = {key: values[frame] for key, values in identity.items()}
    if len(bodies):
        rows["instance"] = np.array(bodies, np.str_)[body]
    if "frame" in rows and "sequence" in rows:  # clips by first appearance, the rows of each by time
        parts = [rows[key] for key in ("subject", "sequence", "camera", "instance") if key in rows]
        order = np.lexsort((rows["frame"], by_appearance(parts, len(frame))[0]))
        frame, body, rows = frame[order], body[order], {key: values[order] for key, values in rows.items()}
    return PoseData(
        keypoints=keypoints[frame, body],
        confidence=confidence[frame, body],
        joint_names=tuple(names),
        identity=rows,
        source=str(path),
        **known,  # type: ignore[arg-type]
    )


def by_appearance(parts: Sequence[Any], rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (rows,) numbers, equal where all of ``parts`` are, by first appearance, and the row of each of those."""
    code = np.zeros(rows, np.int64)
    for part in parts:
        _, one = codes_of(part)
        _, code = codes_of(code * (one.max(initial=0) + 1) + one)
    _, first, code = np.unique(code, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return np.argsort(order)[code], first[order]


def _check_names(path: Path, names: Sequence[str], what: str) -> None:
    """Raise UserError where a name comes twice or is empty."""
    if not all(names):
        raise UserError(f"{path}: {what} {list(names).index('') + 1} has no name.")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise UserError(f"{path}: {what} '{twice[0]}' is there {Counter(names)[twice[0]]} times; names must differ.")


def frame_numbers(
    path: Path, numbers: np.ndarray, lines: np.ndarray | None = None, *, once: bool = False
) -> np.ndarray:
    """Return frame numbers as int64; with ``once`` none may come twice. Raises UserError for other numbers."""

    def place(row: int) -> str:
        return f"row {row}" if lines is None else f"line {lines[row]}"

    valid = np.isfinite(numbers) & (numbers >= 0) & (numbers < _LAST_FRAME) & (np.floor(numbers) == numbers)
    if not valid.all():
        row = int(np.argmin(valid))
        raise UserError(f"{path}, {place(row)}: {numbers[row]:g} is not a frame number, expected 0, 1, 2, ...")
    frame = numbers.astype(np.int64)
    if once and len(frame) > 1 and not (np.diff(frame) > 0).all():
        order = np.argsort(frame, kind="stable")
        again = np.flatnonzero(np.diff(frame[order]) == 0)
        if len(again):
            row = int(order[again[0] + 1])
            raise UserError(f"{path}, {place(row)}: frame {frame[row]} is there twice: two files in one?")
    return frame


def confidence_of(keypoints: np.ndarray, scores: np.ndarray | None) -> np.ndarray:
    """Return the confidence of each keypoint, on the scale of its score, 0 where it is missing."""
    finite = ~np.isnan(keypoints).any(-1)
    if scores is None:
        return (finite & (keypoints != 0).any(-1)).astype(np.float32)
    return np.where(finite & ~np.isnan(scores), scores, np.float32(0)).astype(np.float32)


def _check_distance(path: Path, keypoints: np.ndarray, confidence: np.ndarray, names: Sequence[str]) -> None:
    far = (np.abs(keypoints).max(-1) > _FARTHEST_PX) & (confidence > 0)
    if far.any():
        frame, body, joint = np.argwhere(far)[0].tolist()
        x, y = keypoints[frame, body, joint].tolist()
        raise UserError(
            f"{path}: '{names[joint]}' in row {frame} is at ({x:g}, {y:g}), expected pixels within an image: damaged?"
        )
