"""From frames to keypoints: every frame through a detector, everyone followed, as a file of a tracker would have it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from uplift.config.files import files_of
from uplift.config.progress import progress
from uplift.data.concat import concat_poses
from uplift.data.formats import checked
from uplift.data.formats.base import ReadOptions
from uplift.data.formats.rows import video_name, video_names
from uplift.data.poses import PoseData, clips_of
from uplift.errors import UserError, listed
from uplift.skeleton import Skeleton
from uplift.video.base import Frame, Frames
from uplift.video.detector import Detector, found_in, make_detector
from uplift.video.frames import VIDEOS, open_frames
from uplift.video.tracking import Tracker, chosen_tracks, partners, sizes_of, swapped_sides

__all__ = ["Detection", "detect_in", "keypoints_of"]


@dataclass(frozen=True)
class Detection:
    """How keypoints are found in frames."""

    detector: str | Detector | None = None
    """A built-in, ``file.py:Class``, or one that is made; None: the built-in for the skeleton."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """What it is made with."""
    people: int | None = None
    """At most how many people, the largest and longest in the picture; None: all."""
    start_s: int | float | None = None
    end_s: int | float | None = None
    """The part of a video that is looked at, seconds; None: from its beginning, to its end."""


def detect_in(source: str | Path, how: Detection, skeleton: Skeleton | None = None) -> PoseData:
    """Return the keypoints of everyone in videos, pictures or what a camera sees, in the detector's joints.

    Several videos, with commas or a pattern between, are looked at one after the other, each with a new detector.

    Raises:
        UserError: as `uplift.video.frames.open_frames`, `uplift.video.detector.make_detector` and `keypoints_of`.
    """
    parts = []
    if str(source).startswith("camera:") and how.end_s is None:
        raise UserError(
            f"{source} has no end: say how many seconds, video.end_s=10; or lift it as it comes, output=live."
        )
    for one in _videos(source):
        with open_frames(one, start_s=how.start_s, end_s=how.end_s) as frames:
            detector = make_detector(how.detector, how.options, skeleton)
            try:
                parts.append(keypoints_of(frames, detector, how.people))
            finally:
                detector.close()
    return concat_poses(parts)


def _videos(source: str | Path) -> list[str | Path]:
    """Return each of several videos; anything else as it is."""
    paths = [] if str(source).startswith("camera:") else files_of(source)
    several = len(paths) > 1 and all(path.suffix.lower() in VIDEOS for path in paths)
    return [*paths] if several else [source]


def keypoints_of(frames: Frames, detector: Detector, people: int | None = None) -> PoseData:
    """Return the keypoints that a detector finds in frames: of a video a clip for each person, of photos a row for each.

    Pictures whose names count on (``img_0001.png``) are those of a video.

    Raises:
        UserError: nobody is found, or the detector fails or returns something else than it should.
    """
    found = _Found(frames, tuple(detector.names))
    for frame in progress(frames, f"finding keypoints in {Path(frames.source).name}", frames.count):
        if not frames.is_video:
            detector.forget()
        found.add(frame, *found_in(detector, frame.image))
    return found.data(people, detector.notes)


@dataclass
class _Found:
    """Everyone in the frames so far."""

    frames: Frames
    names: tuple[str, ...]
    looked: int = 0
    parts: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    """Keypoints and confidence of each frame that shows anyone."""
    at: list[tuple[int, str]] = field(default_factory=list)
    """Number and name of each of those frames."""
    sizes: set[tuple[int, int]] = field(default_factory=set)

    def add(self, frame: Frame, keypoints: np.ndarray, confidence: np.ndarray) -> None:
        """Add those who are seen in a frame."""
        self.looked += 1
        self.sizes.add((frame.image.shape[1], frame.image.shape[0]))
        there = (confidence > 0).any(1)
        if not there.any():
            return
        keypoints, confidence = keypoints[there], confidence[there]
        if not self.parts:  # numbers that are no pixels are refused now, not after hours
            checked(self._data(keypoints, confidence, {}), ReadOptions())
        self.parts.append((keypoints, confidence))
        self.at.append((frame.index, frame.name))

    def data(self, people: int | None, notes: Sequence[str]) -> PoseData:
        """Return the rows of those who last, at most ``people`` of them; raises UserError where nobody does."""
        where = self.frames.source
        if not self.parts:
            raise UserError(
                f"{where}: nothing was found in {self.looked:,} frames; looked for {listed(self.names, 4)}."
            )
        keypoints, confidence = (np.concatenate(part) for part in zip(*self.parts, strict=True))
        size = sizes_of(keypoints, confidence)
        video = self._video()
        if video is None:
            rows, identity = self._photos(size, people)
            left_out = []
        else:
            rows, identity, left_out = self._clips(*video, size, people)
            left_out += self._unswap(keypoints, confidence, identity, rows)
        if not len(rows):
            raise UserError(f"{where}: nobody is seen for half a second or more in {self.looked:,} frames.")
        identity = {key: values[rows] for key, values in identity.items()}
        found = checked(self._data(keypoints[rows], confidence[rows], identity), ReadOptions())
        return replace(found, notes=(*self.frames.notes, *notes, *found.notes, *left_out))

    def _unswap(
        self, keypoints: np.ndarray, confidence: np.ndarray, identity: Mapping[str, np.ndarray], rows: np.ndarray
    ) -> list[str]:
        """Put left and right back in place, in the arrays, in frames where a detector swaps them; return a note on how many."""
        clip, swapped = clips_of({key: values[rows] for key, values in identity.items()}), np.zeros(len(rows), bool)
        for one in np.unique(clip):
            here = rows[clip == one]
            swapped[clip == one] = swapped_sides(
                keypoints[here], confidence[here], identity["frame"][here], self.names, self.frames.fps
            )
        there, order = rows[swapped], partners(self.names)
        keypoints[there], confidence[there] = keypoints[there][:, order], confidence[there][:, order]
        share = f"{swapped.sum():,} of {len(rows):,} rows"
        return [f"the detector took left for right in {share}: put right, as in the frames around them"] * bool(
            swapped.any()
        )

    def _data(self, keypoints: np.ndarray, confidence: np.ndarray, identity: dict[str, np.ndarray]) -> PoseData:
        return PoseData(
            keypoints=keypoints,
            confidence=confidence,
            joint_names=self.names,
            identity=identity,
            fps=self.frames.fps,
            image_size=next(iter(self.sizes)) if len(self.sizes) == 1 else None,
            focal_px=self.frames.focal_px,
            stills="image" in identity,
            source=self.frames.source,
        )

    def _video(self) -> tuple[list[str], list[int]] | None:
        """Return the name and the number in it of each frame of a video, or of pictures that are one; None for photos."""
        name = video_name(self.frames.source)
        if self.frames.is_video:
            return [name] * len(self.at), [number for number, _ in self.at]
        return video_names([Path(picture).stem for _, picture in self.at], name)

    def _photos(self, size: np.ndarray, people: int | None) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the rows of the largest people of each photo, and what they are of."""
        photo = np.repeat(np.arange(len(self.at)), self._counts)
        order = np.lexsort([-size, photo])
        place = np.empty_like(order)  # from 0 in each photo, the largest first
        place[order] = np.arange(len(order)) - np.searchsorted(photo, photo)[order]
        names = np.array([name or video_name(self.frames.source) for _, name in self.at])
        identity = {"image": names[photo]} | ({"instance": place.astype(str)} if place.any() and people != 1 else {})
        return np.flatnonzero(place < (people or len(place))), identity

    @property
    def _counts(self) -> list[int]:
        return [len(keypoints) for keypoints, _ in self.parts]

    def _clips(
        self, names: Sequence[str], numbers: Sequence[int], size: np.ndarray, people: int | None
    ) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
        """Return the rows of people who last, clip after clip, what rows are of, and a note on who is left out.

        People are named from 0, the largest and longest first; one who is alone has no name.
        """
        trackers = {name: Tracker(self.frames.fps) for name in names}
        tracks = [
            trackers[name].follow(*part, number) for name, number, part in zip(names, numbers, self.parts, strict=True)
        ]
        track, sequence, frame = (
            np.concatenate(tracks),
            np.repeat(names, self._counts),
            np.repeat(numbers, self._counts),
        )
        rows, who, gone = [], np.full(len(track), -1), 0
        for name in trackers:
            here = sequence == name
            length = min(self.looked, int(np.ptp(frame[here])) + 1)
            wanted = chosen_tracks(track[here], size[here], self.frames.fps, length, people)
            gone += len(np.unique(track[here])) - len(wanted)
            for place, number in enumerate(wanted):
                rows.append(np.flatnonzero(here & (track == number)))
                who[rows[-1]] = place
        identity = {"sequence": sequence, "frame": frame} | ({"instance": who.astype(str)} if who.max() > 0 else {})
        why = "there for less than half a second" + ("" if people is None else f", or more than people={people}")
        left_out = [f"{gone} of {gone + len(rows)} who were followed are left out: {why}"] if gone else []
        return np.concatenate([np.zeros(0, int), *rows]), identity, left_out
