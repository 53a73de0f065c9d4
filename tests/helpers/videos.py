"""Tiny videos made with PyAV: frames whose grey levels are their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

__all__ = ["numbered", "shown", "write_sound", "write_video"]

_UNIT = Fraction(1, 600)


def numbered(count: int, size: tuple[int, int] = (64, 48)) -> list[np.ndarray]:
    """Return frames: grey levels are 8 times their number, and the upper left quarter is red."""
    width, height = size
    frames = np.empty((count, height, width, 3), np.uint8)
    frames[:] = ((8 * np.arange(count)) % 256)[:, None, None, None]
    frames[:, : height // 2, : width // 2] = (255, 0, 0)
    return list(frames)


def shown(image: np.ndarray) -> int:
    """Return the number of a frame, by the grey level of its lower right corner as it was stored upright."""
    return round(float(image[-8:, -8:].mean()) / 8)


def write_video(
    path: Path,
    frames: Sequence[np.ndarray],
    *,
    fps: float = 30,
    times_s: Sequence[float] | None = None,
    codec: str = "mpeg4",
    turn_deg: int = 0,
    sound: bool = False,
    aspect: Fraction | None = None,
) -> Path:
    """Write a video, at ``times_s`` where they are given; ``turn_deg`` says how a player turns it counter-clockwise."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(fps).limit_denominator(1001))
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuvj420p" if codec == "mjpeg" else "yuv420p", 4_000_000
        stream.codec_context.thread_count = 1
        scaler = av.video.reformatter.VideoReformatter()
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        if turn_deg:
            stream.set_display_rotation(turn_deg)
        if times_s is not None:
            stream.codec_context.time_base = _UNIT
        noise = container.add_stream("aac", rate=48000) if sound else None
        for place, image in enumerate(frames):
            frame = scaler.reformat(av.VideoFrame.from_ndarray(image, format="rgb24"), format=stream.pix_fmt, threads=1)
            if times_s is not None:
                frame.time_base, frame.pts = _UNIT, round(times_s[place] / _UNIT)
            else:
                frame.pts = None
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
        if noise is not None:
            container.mux(noise.encode(_silence()))
            container.mux(noise.encode())
    return path


def write_sound(path: Path) -> Path:
    """Write a file with sound alone."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=48000)
        container.mux(stream.encode(_silence()))
        container.mux(stream.encode())
    return path


def _silence():
    import av

    frame = av.AudioFrame.from_ndarray(np.zeros((2, 1024), np.float32), format="fltp", layout="stereo")
    frame.sample_rate = 48000
    return frame
