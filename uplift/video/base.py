"""What all sources of frames share: one frame, a stream of frames, and limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import UInt8

from uplift.errors import UserError

__all__ = ["MAX_PIXELS", "Frame", "Frames", "need_av", "reason_of"]

MAX_PIXELS = 100_000_000
"""Of one frame: 300 MB in RGB, three times what 8K is."""


@dataclass(frozen=True)
class Frame:
    """One frame."""

    image: UInt8[np.ndarray, "height width 3"]
    """RGB, upright: rotated as the file says, pixels square."""
    index: int
    """Its number from 0: of a video its time in steps of the frame rate, so that numbers can be missing."""
    time_s: float
    """Seconds from the first frame; of a picture 0."""
    name: str = ""
    """File name of a picture."""


class Frames:
    """Frames of one source: iterable once, a context manager, in constant memory.

    Attributes:
        source: as it was given.
        width, height: of the first frame as it is shown, px.
        fps: frames a second; None for pictures.
        count: about how many frames there are, for showing progress; None where that is not known.
        focal_px: focal length in pixels by the EXIF data of the first picture; None where it has none, and for videos.
        is_video, is_live: whether frames follow one another in time; whether they come from a camera.
        notes: what was noticed, one sentence each; complete once all frames have been read.
    """

    is_video = False
    is_live = False
    fps: float | None = None
    count: int | None = None
    focal_px: float | None = None

    def __init__(self, source: str):
        self.source = source
        self.width = self.height = 0
        self._notes: list[str] = []
        self._frames: Iterator[Frame] | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What was noticed so far."""
        return tuple(self._notes)

    def __iter__(self) -> Iterator[Frame]:
        """Return the frames; a second time they go on where they are."""
        if self._frames is None:
            self._frames = self._read()
        return self._frames

    def _read(self) -> Iterator[Frame]:
        raise NotImplementedError

    def close(self) -> None:
        """Close the file or the camera."""
        if self._frames is not None:
            self._frames.close()  # type: ignore[attr-defined]

    def __enter__(self) -> Frames:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.close()


def need_av(task: str, otherwise: str = "") -> Any:
    """Return PyAV; raises UserError where it is not installed. ``task`` begins the message, ``otherwise`` ends it."""
    try:
        import av  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise UserError(f'{task} needs PyAV: pip install "uplift3d[video]".{otherwise}') from None
    return av


def reason_of(error: BaseException) -> str:
    """Return what FFmpeg or the system says, without numbers and names of files."""
    return str(getattr(error, "strerror", None) or error or type(error).__name__).splitlines()[0][:120]
