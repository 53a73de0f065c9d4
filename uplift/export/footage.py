"""The video or the pictures that poses were lifted from: the image of each moment of a clip."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from uplift.config.files import files_of, inside
from uplift.errors import UserError, listed
from uplift.export.clips import Clip
from uplift.models.prediction import Prediction
from uplift.video.frames import PICTURES, Frame, Frames, open_frames

__all__ = ["Footage", "every_frame"]

_ASPECT = 0.02
"""How far the shape of a video may be from that of the images that keypoints are in."""


class Footage:
    """Images of the moments of ``prediction``, out of ``source``: a video, several, or pictures.

    Videos are told apart by their names, which are those of the sequences. Frames are told by their numbers, pictures
    by their names where the prediction has those (`image`). Numbers are those of the video's own reader where the
    keypoints came out of it, else those that trackers give: the order of the frames in the file.

    Raises:
        UserError: no such file, or one that cannot be read; of another shape than the images of the keypoints; of
            several clips none that has the name of a video.
    """

    def __init__(self, source: str | Path, prediction: Prediction):
        self.source, self._prediction = str(source), prediction
        self._paths = files_of(source)
        self._by_name = "image" in prediction.identity and all(map(_has_pictures, self._paths))
        with self._opened(self._paths[0]) as frames:
            size = frames.width, frames.height
        self.image_size: Sequence[int] = prediction.image_size or size
        """Width and height of the images, in px of the keypoints."""
        ratio = size[0] * self.image_size[1] / (size[1] * self.image_size[0])
        if not self._by_name and abs(ratio - 1) > _ASPECT:
            raise UserError(
                f"video={source}: its frames are {size[0]} x {size[1]} px, the keypoints are in images of "
                f"{self.image_size[0]} x {self.image_size[1]} px: not the video that they were found in."
            )

    def of(self, clips: Sequence[Clip], of: int) -> list[bool]:
        """Return which clips, all or some ``of`` so many, it shows; raises UserError for none."""
        found = [self.shows(clip, alone=of == 1) for clip in clips]
        if not any(found):
            names = listed((self._sequence(clip) for clip in clips), 3)
            raise UserError(f"video={self.source}: there are {of} clips, and none has its name: {names}.")
        return found

    def shows(self, clip: Clip, *, alone: bool) -> bool:
        """Return whether a clip is shown; ``alone``: there is no other."""
        return self._path_of(clip, alone) is not None

    def images(
        self, clip: Clip, moments: Iterable[int], *, alone: bool
    ) -> Iterator[tuple[int, UInt8[np.ndarray, "height width 3"]]]:
        """Yield the moments with their images, as long as there are images; ``alone``: there is no other clip.

        A moment between two frames of the video has the earlier one. Raises UserError where no moment has an image.
        """
        moment = None
        for moment, frame in self._named(clip, moments) if self._by_name else self._numbered(clip, moments, alone):
            yield moment, frame.image
        if moment is None:
            numbers = f"{clip.frames[0]:,} to {clip.frames[-1]:,}"
            raise UserError(f"video={self.source} has none of the frames of the keypoints, which are {numbers}.")

    def _numbered(self, clip: Clip, moments: Iterable[int], alone: bool) -> Iterator[tuple[int, Frame]]:
        path = self._path_of(clip, alone)
        if path is None:
            return
        with self._opened(path, clip.frames[0]) as frames:
            stream = iter(frames)
            shown, coming = None, next(stream, None)
            for moment in moments:
                number = clip.frames[moment]
                while coming is not None and coming.index <= number:
                    shown, coming = coming, next(stream, None)
                if coming is None and (shown is None or shown.index < number):
                    return
                if shown is not None:
                    yield moment, shown

    def _named(self, clip: Clip, moments: Iterable[int]) -> Iterator[tuple[int, Frame]]:
        names = self._prediction.identity["image"][clip.rows].astype(str)
        for moment in moments:
            path = self._picture(str(names[clip.moment == moment][0])) if (clip.moment == moment).any() else None
            if path is not None:
                with open_frames(path) as frames:
                    yield moment, next(iter(frames))

    def _picture(self, name: str) -> Path | None:
        for path in self._paths:
            found = inside(path, name) if path.is_dir() else path if path.name == Path(name).name else None
            if found is not None and found.is_file():
                return found
        return None

    def _opened(self, path: Path, first: int = 0) -> Frames:
        """Open a video from about its frame ``first`` on."""
        if _has_pictures(path):
            return open_frames(self.source if len(self._paths) > 1 else path)
        own = path.name in {Path(one).name for one in self._prediction.source.split(",")}
        frames = open_frames(path, as_stored=not own)
        if not (own and first and frames.fps):
            return frames
        frames.close()
        return open_frames(path, start_s=max(0.0, (first - 0.5) / frames.fps))

    def _path_of(self, clip: Clip, alone: bool) -> Path | None:
        if self._by_name or (len(self._paths) > 1 and all(map(_has_pictures, self._paths))):
            return self._paths[0]
        stem = Path(self._sequence(clip)).stem
        by_stem = {path.stem: path for path in self._paths}
        return by_stem.get(stem) or (self._paths[0] if alone and len(self._paths) == 1 else None)

    def _sequence(self, clip: Clip) -> str:
        names = self._prediction.identity.get("sequence")
        return clip.name if names is None or not len(clip.rows) else str(names[clip.rows[0]])


def _has_pictures(path: Path) -> bool:
    return path.is_dir() or path.suffix.lower() in PICTURES


_MOST_MOMENTS = 2_000_000


def every_frame(clip: Clip) -> Clip:
    """Return the clip with the moments between its first and last in which nobody is seen."""
    numbers = np.asarray(clip.frames)
    sizes, count = np.unique(np.diff(numbers), return_counts=True)
    if not len(sizes) or np.ptp(numbers) / sizes[np.argmax(count)] > _MOST_MOMENTS:
        return clip
    frames = np.union1d(numbers, np.arange(numbers[0], numbers[-1], sizes[np.argmax(count)]))
    return replace(clip, moment=np.searchsorted(frames, numbers)[clip.moment], frames=tuple(frames.tolist()))
