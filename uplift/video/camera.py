"""Frames of a camera of this machine."""

from __future__ import annotations

import math
import re
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from uplift.data.parsers.json import in_order
from uplift.data.poses import USUAL_FPS
from uplift.errors import UserError, listed
from uplift.video.base import Frame, Frames, need_av, reason_of

__all__ = ["CameraFrames"]


class CameraFrames(Frames):
    """The newest frame each time: those that come while one is worked on are left out."""

    is_video = is_live = True

    def __init__(self, source: str, name: str, end_s: int | float | None = None):
        super().__init__(source)
        self._av = need_av(f"{source}: a camera")
        self._container = self._opened(name)
        stream = self._container.streams.video[0]
        rate = float(stream.average_rate or stream.guessed_rate or USUAL_FPS)
        self.fps = rate if 1 <= rate <= 1000 else USUAL_FPS
        self.width, self.height = stream.codec_context.width, stream.codec_context.height
        self._end_s = math.inf if end_s is None else end_s
        self.count = None if end_s is None else round(end_s * self.fps)
        self._unit = float(stream.time_base)
        self._newest: Any = None
        self._failed: BaseException | None = None
        self._stop, self._there = threading.Event(), threading.Condition()
        self._thread = threading.Thread(target=self._listen, args=(stream,), daemon=True)
        self._thread.start()

    def _opened(self, name: str) -> Any:
        """Return the open camera; raises UserError where there is none, or none that may be used."""
        where, kind = _device(name)
        try:
            return self._av.open(where, format=kind)
        except PermissionError:
            raise UserError(
                f"{self.source}: no permission to use {where}: on Linux add yourself to the group 'video' and log in again."
            ) from None
        except Exception as error:
            if isinstance(error, OSError) and error.errno == 16:
                raise UserError(f"{self.source}: {where} is in use by another program: close it.") from None
            raise UserError(
                f"{self.source}: no camera can be opened at {where} ({reason_of(error)}).{_cameras()}"
            ) from None

    def _listen(self, stream: Any) -> None:
        try:
            for frame in self._container.decode(stream):
                with self._there:
                    self._newest = frame
                    self._there.notify()
                if self._stop.is_set():
                    return
        except Exception as error:  # unplugged
            self._failed = error
        with self._there:
            self._stop.set()
            self._there.notify()

    def _read(self) -> Iterator[Frame]:
        assert self.fps is not None
        scaler = self._av.video.reformatter.VideoReformatter()
        first, last = math.nan, -1
        while True:
            with self._there:
                self._there.wait_for(lambda: self._newest is not None or self._stop.is_set(), timeout=10)
                frame, self._newest = self._newest, None
            if frame is None:
                if last < 0:
                    why = f" ({reason_of(self._failed)})" if self._failed else " for ten seconds"
                    raise UserError(f"{self.source}: the camera gives no picture{why}.")
                return
            now = (frame.pts or 0) * self._unit
            first = now if math.isnan(first) else first
            if now - first >= self._end_s:
                return
            last = max(last + 1, round((now - first) * self.fps))
            yield Frame(scaler.reformat(frame, format="rgb24", threads=1).to_ndarray(), last, now - first)

    def close(self) -> None:
        super().close()
        self._stop.set()
        self._thread.join(timeout=2)
        if not self._thread.is_alive():
            self._container.close()


def _device(name: str) -> tuple[str, str]:
    """Return what FFmpeg calls a camera, and its kind of devices on this system."""
    if sys.platform == "darwin":
        return name, "avfoundation"
    if sys.platform == "win32":
        if name.isdecimal():
            raise UserError(f"camera:{name}: on Windows give the name of the camera: camera:Integrated Camera.")
        return f"video={name}", "dshow"
    path = f"/dev/video{name}" if name.isdecimal() else name
    if not Path(path).exists():
        raise UserError(f"camera:{name}: no {path} on this machine.{_cameras()}")
    if not re.fullmatch(r"/dev/(video\w+|v4l/.+)", path):
        raise UserError(f"camera:{name}: {path} is no camera: expected a number, or /dev/videoN.")
    return path, "v4l2"


def _cameras() -> str:
    """Return which cameras there are, on Linux."""
    if not sys.platform.startswith("linux"):
        return ""
    found = sorted(Path("/dev").glob("video*"), key=lambda path: in_order(path.name))
    names = [f"camera:{path.name.removeprefix('video')}" for path in found]
    return f" There are {listed(names)}." if names else " No camera is plugged in."
