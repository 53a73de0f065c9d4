"""Rows of keypoints as readers find them become `PoseData`: honest confidence, who is who, clips that stand together."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.data.container import PoseData, codes_of
from uplift.errors import UserError
from uplift.readers.base import ReadOptions
from uplift.readers.texts import texts
from uplift.readers.tracks import link_bodies

__all__ = ["SHARES_NOTE", "frames_or_images", "pose_data", "seen_by_flag", "split_names", "to_pixels", "video_names"]

SHARES_NOTE = (
    "coordinates are shares of the image, whose size is not known: taken as square; say image_size=WIDTHxHEIGHT"
)
_LINKED = "bodies have no numbers: those of neighbouring frames are linked by place"
_TWICE = "a track's number stands twice in one frame: bodies are linked by place instead"
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

    Scores above 1 are taken as 1. In a video an ``instance`` that is empty, or not there although
    a frame has several bodies, is found by linking. ``known`` are further fields of `PoseData`.

    Raises:
        UserError: a name that comes twice, or no visible keypoint at all.
    """
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise UserError(f"{path} names '{twice[0]:.60}' twice among its keypoints; names must differ.")
    keypoints, confidence = _honest(keypoints, confidence)
    seen = np.any(confidence > 0, axis=1)
    if not seen.any():
        raise UserError(f"{path} has no visible keypoint in it ({len(seen):,} bodies, {len(names)} keypoints each).")
    if not seen.all():
        keypoints, confidence = keypoints[seen], confidence[seen]
        identity = {key: value[seen] for key, value in identity.items()}
    told = list(notes)
    if "frame" in identity:
        identity, order = _clips(keypoints, confidence, identity, told)
        if order is not None:
            keypoints, confidence = keypoints[order], confidence[order]
            identity = {key: value[order] for key, value in identity.items()}
    return PoseData(
        keypoints=keypoints.astype(np.float32, copy=False),
        confidence=confidence,
        joint_names=tuple(names),
        identity=identity,
        notes=tuple(told),
        source=str(path),
        **known,  # type: ignore[arg-type]
    )


def _honest(keypoints: np.ndarray, confidence: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return keypoints that are numbers or NaN, and a confidence of 0 to 1 that is 0 where they are NaN."""
    confidence = np.clip(np.nan_to_num(confidence, nan=0, posinf=0, neginf=0), 0, 1).astype(np.float32, copy=False)
    finite = np.all(np.isfinite(keypoints), axis=-1)
    if finite.all():
        return keypoints, confidence
    return np.where(finite[..., None], keypoints, np.float32(np.nan)), np.where(finite, confidence, np.float32(0))


def _clips(
    keypoints: np.ndarray, confidence: np.ndarray, identity: dict[str, np.ndarray], notes: list[str]
) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Return the identity with bodies told apart, and the order in which each one's frames stand together."""
    frame = identity["frame"]
    _, video = codes_of(identity["sequence"])
    times, time = codes_of(frame)
    places, place = codes_of(video * len(times) + time)
    several = len(places) < len(frame)
    track = identity.get("instance", np.full(len(frame), ""))
    nameless = track == ""
    if not nameless.all():
        tracks, who = codes_of(track)
        own = (place * len(tracks) + who)[~nameless]
        if len(np.unique(own)) < len(own):
            notes.append(_TWICE)
            nameless[:] = True
        elif nameless.any():
            notes.append(_SOME)
            found = _linked(keypoints, confidence, video, frame, nameless)
            track = np.where(nameless, np.char.add("untracked ", found), track)
    elif several:
        notes.append(_LINKED)
    rest = {key: value for key, value in identity.items() if key != "instance"}
    if nameless.all():
        if not several:
            return rest, _order(video, None, frame)
        track = _linked(keypoints, confidence, video, frame, nameless)
    return {**rest, "instance": track}, _order(video, track, frame)


def _linked(
    keypoints: np.ndarray, confidence: np.ndarray, video: np.ndarray, frame: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """Return (rows,) numbers of bodies as text for those that ``rows`` picks, nothing for others."""
    found = np.full(len(frame), "", dtype="U20")
    order = np.flatnonzero(rows)[np.argsort(video[rows], kind="stable")]
    for here in np.split(order, np.flatnonzero(np.diff(video[order])) + 1):
        found[here] = link_bodies(keypoints[here], confidence[here], frame[here]).astype(str)
    return found


def _order(video: np.ndarray, track: np.ndarray | None, frame: np.ndarray) -> np.ndarray | None:
    """Return the order by video, body and frame; None where the rows stand so already."""
    keys = [frame] if track is None else [frame, codes_of(track)[1]]
    order = np.lexsort([*keys, video])
    return None if (np.diff(order) == 1).all() else order


def seen_by_flag(third: Float[np.ndarray, "rows joints"], notes: list[str]) -> Float[np.ndarray, "rows joints"]:
    """Return the confidence that COCO's third numbers stand for: 0 missing, 1 occluded, 2 visible; or scores.

    Where no number is 2, 1 is taken as visible; where any is none of the three, all are scores.
    """
    if not (np.isin(third, (0, 1, 2)) | ~np.isfinite(third)).all():
        return third
    if (third == 2).any():
        return third / np.float32(2)
    notes.append("flags are 0 and 1 only: 1 is taken as visible, not as COCO's 'occluded'")
    return third


def to_pixels(
    keypoints: Float[np.ndarray, "rows joints 2"], options: ReadOptions, notes: list[str]
) -> Float[np.ndarray, "rows joints 2"]:
    """Return shares of the image in pixels where the user says how large it is; else as they are, with a note."""
    if options.image_size is None:
        notes.append(SHARES_NOTE)
        return keypoints
    return keypoints * np.array(options.image_size, np.float32)


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


def frames_or_images(
    path: Path, stems: Sequence[str], file: Sequence[int], frame: Sequence[int | None], track: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return the identity of bodies that come from frames of videos, a file each, or from images, a file each.

    ``frame`` is None for bodies of an image; images of a folder that are numbered as a video's frames
    are one. ``file`` is the place of each body's file in ``stems``.
    """
    known = {"instance": texts(path, track)} if any(track) else {}
    if all(number is not None for number in frame):
        return {"sequence": np.array(stems)[file], "frame": np.array(frame, np.int64), **known}
    video = video_names(stems, path.absolute().stem) if len(stems) > 1 else None
    if video is not None and all(number is None for number in frame):
        sequences, frames = np.array(video[0]), np.array(video[1], np.int64)
        return {"sequence": sequences[file], "frame": frames[file], **known}
    return {"image": np.array(stems)[file], "instance": np.arange(len(file)).astype(str)}
