"""Frames of a video file: each decoded once, numbered by its presentation time on the grid of the frame rate."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped, UInt8

from uplift.data.poses import USUAL_FPS
from uplift.errors import UserError
from uplift.video.base import MAX_PIXELS, Frame, Frames, need_av, reason_of

__all__ = ["VideoFrames"]

_FORMATS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,mpegvideo,asf,flv,ogg,mxf,gif,dv,wtv,rm,ivf,nut,h264,hevc,m4v"
"""What is opened: playlists and patterns, which name other files, are not among them."""
_PEEKED = 120
"""Packets whose times tell the frame rate."""
_LOST = 600
"""Packets without a frame after which a file is given up."""
_NEXT = 0.75
"""Of a step: a frame that comes this much early or late is still the next one."""


class VideoFrames(Frames):
    is_video = True

    def __init__(self, path: Path, start_s: int | float, end_s: int | float | None, as_stored: bool):
        super().__init__(str(path))
        self._av, self._path = need_av(f"{path}: a video", " Pictures need nothing more."), path
        self._start_s, self._end_s, self._as_stored = start_s, math.inf if end_s is None else end_s, as_stored
        self._lost = self._partly = self._gaps = self._taken = 0
        self._scaler = self._av.video.reformatter.VideoReformatter()  # one for all: to make one costs 20 ms
        with self._opened() as container:
            self._look(container)

    def _opened(self) -> Any:
        """Return the open file; raises UserError where it is no video."""
        options = {"protocol_whitelist": "file", "format_whitelist": _FORMATS}
        try:
            return self._av.open(f"file:{self._path.absolute()}", options=options)
        except PermissionError:
            raise UserError(f"{self._path}: no permission to read it.") from None
        except (self._av.error.FFmpegError, OSError, ValueError, UnicodeError) as error:
            if not self._path.stat().st_size:
                raise UserError(f"{self._path} is empty (0 bytes): copy or record it again.") from None
            raise UserError(
                f"{self._path} is not a video that can be read, or it is cut off or damaged at its beginning "
                f"({reason_of(error)}): play it in a video player; if it plays there, convert it to .mp4."
            ) from None

    def _stream(self, container: Any) -> Any:
        """Return the first stream of moving pictures; a cover of music is none."""
        cover = self._av.stream.Disposition.attached_pic
        moving = [one for one in container.streams.video if not one.disposition & cover]
        if not moving:
            sound = " but sound" if container.streams.audio else ""
            raise UserError(f"{self._path} has nothing{sound} in it: expected a video with pictures.")
        stream = moving[0]
        context = stream.codec_context
        if context is None:
            raise UserError(f"{self._path}: its pictures are coded in an unknown way: convert it to .mp4.")
        if context.width * context.height > MAX_PIXELS:
            self._refuse_size(context.width, context.height)
        context.options = {"max_pixels": str(MAX_PIXELS)}
        context.thread_type = "AUTO"
        context.thread_count = min(4, os.cpu_count() or 1)  # each holds a frame
        return stream

    def _refuse_size(self, width: int, height: int) -> None:
        raise UserError(
            f"{self._path}: its frames are {width} x {height} px, the most is {MAX_PIXELS // 10**6} million pixels: "
            "make a smaller copy."
        )

    def _look(self, container: Any) -> None:
        """Learn what there is to know from the first frames."""
        stream = self._stream(container)
        times: list[int] = []
        first, tried = None, 0
        for packet in self._packets(container, stream):
            if packet.pts is not None:
                times.append(packet.pts)
            tried += 1
            if first is None:
                first = next(iter(self._decoded(packet)), None)
            if (first is not None and tried >= _PEEKED) or tried >= _LOST:
                break
        if first is None:
            what = "has no frames" if tried <= 1 else "is damaged: none of its first frames can be decoded"
            raise UserError(f"{self._path} {what}. Record, copy or convert it again.")
        self._lost = self._partly = 0  # they are counted when all of it is read
        self._unit = float(stream.time_base)
        self._first = first.pts if first.pts is not None else (min(times) if times else 0)
        self._set_rate(stream, np.unique(times) * self._unit)
        self._set_size(stream, first)
        self._set_count(container, stream)

    def _set_rate(self, stream: Any, times: Shaped[np.ndarray, " times"]) -> None:
        """Set ``fps``: what the file or custom says where the times of the first frames agree, else what those say."""
        steps = np.diff(times)
        said = [float(rate) for rate in (stream.guessed_rate, stream.average_rate) if rate]
        if len(steps):
            step, slack = _step(times)
            whole = round(1 / step)
            said = [*said[:1], whole, whole * 1000 / 1001, *said[1:]]
            self.fps = float(next((rate for rate in said if abs(rate * step - 1) < slack), 1 / step))
        elif said and 0.01 <= said[0] <= 10_000:
            self.fps = said[0]
        else:
            self.fps = USUAL_FPS
            self._notes.append(f"the video does not say its frame rate: {USUAL_FPS:g} a second are assumed (fps=)")

    def _set_size(self, stream: Any, first: Any) -> None:
        self._size = first.width, first.height
        aspect = stream.sample_aspect_ratio
        if aspect and 0.1 < aspect < 10 and aspect != 1:
            self._size = round(first.width * aspect), first.height
            self._notes.append(
                f"its pixels are not square ({aspect.numerator}:{aspect.denominator}): {first.width} x {first.height} px "
                f"are shown as {self._size[0]} x {self._size[1]}"
            )
            if self._size[0] * self._size[1] > MAX_PIXELS:
                self._refuse_size(*self._size)
        self.height, self.width = self._image(first).shape[:2]

    def _set_count(self, container: Any, stream: Any) -> None:
        """Set ``count``, and refuse a cut behind the end."""
        lasts = stream.duration * self._unit if stream.duration else (container.duration or 0) / 1e6
        assert self.fps is not None
        self._lasts_s = lasts
        if lasts and self._start_s >= lasts:
            raise UserError(
                f"video.start_s={self._start_s:g} is after the end of {self._path}: it lasts {lasts:.1f} s."
            )
        whole = not self._start_s and self._end_s >= (lasts or math.inf)
        seconds = min(lasts, self._end_s) - self._start_s
        if whole and stream.frames:
            self.count = stream.frames
        elif lasts and lasts < 1e8:
            self.count = max(1, round(seconds * self.fps))

    def _packets(self, container: Any, stream: Any) -> Iterator[Any]:
        """Yield the packets as far as the file can be read."""
        try:
            yield from container.demux(stream)
        except (self._av.error.FFmpegError, OSError) as error:
            self._notes.append(f"the video cannot be read to its end ({reason_of(error)}): what is before it is used")

    def _decoded(self, packet: Any) -> list[Any]:
        """Return the frames that a packet completes; damaged ones are counted and left out."""
        try:
            frames = packet.decode()
        except (self._av.error.FFmpegError, ValueError):
            self._lost += 1
            return []
        self._partly += sum(frame.is_corrupt for frame in frames)
        return [frame for frame in frames if frame.width * frame.height <= MAX_PIXELS]

    def _read(self) -> Iterator[Frame]:
        with self._opened() as container:
            stream = self._stream(container)
            last, time_s = -1, 0.0
            for stored, (frame, time_s) in enumerate(self._timed(container, stream)):
                index = stored if self._as_stored else self._number(time_s, last)
                if index is None:
                    continue
                last = index
                if time_s >= self._end_s - 1e-6:
                    break
                if time_s >= self._start_s - 1e-6:
                    yield Frame(self._image(frame), index, time_s)
            else:
                self._note_end(time_s)
        self._note_times()

    def _timed(self, container: Any, stream: Any) -> Iterator[tuple[Any, float]]:
        """Yield the frames with their times from the first, which never go back."""
        assert self.fps is not None
        if self._start_s and not self._as_stored:
            with suppress(self._av.error.FFmpegError):  # what cannot be sought is decoded up to there
                container.seek(self._first + round(self._start_s / self._unit), stream=stream)
        last, shift = -math.inf, 0.0
        for packet in self._packets(container, stream):
            for frame in self._decoded(packet):
                time_s = math.nan if frame.pts is None else (frame.pts - self._first) * self._unit + shift
                if not time_s > last:  # none, or a clock that starts again: it goes on
                    onward = 0.0 if math.isinf(last) else last + 1 / self.fps
                    shift += 0.0 if math.isnan(time_s) else onward - time_s
                    time_s = onward
                last = time_s
                yield frame, time_s

    def _number(self, time_s: float, last: int) -> int | None:
        """Return a frame's number on the grid of the frame rate; None where one before it has taken its place."""
        assert self.fps is not None
        due = time_s * self.fps
        if last < 0 and due > 1:  # the first after a cut
            return round(due)
        if abs(due - last - 1) <= _NEXT:
            return last + 1
        if due < last + 1:
            self._taken += 1
            return None
        self._gaps += round(due) - last - 1
        return round(due)

    def _image(self, frame: Any) -> UInt8[np.ndarray, "height width 3"]:
        """Return a frame in RGB with square pixels, turned as the file says."""
        width, height = self._size
        image = self._scaler.reformat(frame, width, height, "rgb24", threads=1).to_ndarray()
        return np.ascontiguousarray(_turned(image, frame))

    def _note_end(self, last_s: float) -> None:
        """Note what is missing of a video that was read to its end."""
        assert self.fps is not None
        if last_s + 2 / self.fps < 0.98 * self._lasts_s:
            self._notes.append(
                f"the video ends after {last_s:.1f} s, its file says {self._lasts_s:.1f} s: it may be cut off; what is there is used"
            )

    def _note_times(self) -> None:
        if self._lost:
            self._notes.append(f"{self._lost:,} damaged parts of the video cannot be decoded and are left out")
        if self._partly:
            self._notes.append(f"{self._partly:,} frames of the video are damaged in part and are used as they are")
        if self._gaps or self._taken:
            self._notes.append(
                f"the video's frame rate varies: frames are numbered by their times, {self.fps:.6g} a second; "
                f"{self._gaps:,} numbers have no frame, {self._taken:,} frames came too early for one of their own"
            )


def _step(times: Shaped[np.ndarray, " times"]) -> tuple[float, float]:
    """Return the usual step of increasing times, with gaps some steps wide, and how far from it a rate is still the same."""
    steps = np.diff(times)
    step = np.median(steps)
    step = steps.sum() / max(1, np.rint(steps / step).sum())
    jitter = 0.0
    for _ in range(2):
        number = np.rint((times - times[0]) / step)
        fit = np.polyfit(number, times, 1) if len(np.unique(number)) > 1 else np.array([step, times[0]])
        step = fit[0]
        jitter = float(np.std(times - np.polyval(fit, number)) / step)
    return float(step), 5e-4 + 4 * jitter * math.sqrt(12) / len(times) ** 1.5


def _turned(image: np.ndarray, frame: Any) -> np.ndarray:
    """Return an image as the display matrix of its frame says: x' = a x + c y, y' = b x + d y (ISO/IEC 14496-12, 8.3.2)."""
    for data in frame.side_data:
        if getattr(data.type, "name", "") == "DISPLAYMATRIX":
            a, b, _, c, d = np.frombuffer(bytes(data)[:20], np.int32).tolist()
            if abs(b) + abs(c) > abs(a) + abs(d):
                image, a, d = image.swapaxes(0, 1), c, b
            return image[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]
    return image
