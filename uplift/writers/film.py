"""A clip as a film, ``.gif`` or ``.mp4``: keypoints beside the 3D pose, seen by a camera that slowly turns."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Int
from PIL import Image

from uplift.errors import UserError
from uplift.prediction import Prediction
from uplift.saving import replacing
from uplift.writers.film_canvas import film_palette
from uplift.writers.film_drawing import FilmDrawing
from uplift.writers.film_scene import film_scene
from uplift.writers.moving import frame_rate, one_clip

__all__ = ["gif_durations_ms", "thinned", "write_film"]

_USUAL_FPS = 30.0
_GIF_FRAMES, _GIF_FPS, _GIF_SCALE = 600, 34.0, 0.625
_MP4_FPS, _MP4_SCALE = 61.0, 1.0
_MP4_QUALITY = 20
"""Of x264: its constant rate factor."""


def write_film(prediction: Prediction, path: str | Path, fps: int | float | None = None) -> None:
    """Write one clip with all its individuals, 1280 x 640 pixels as ``.mp4`` and 800 x 400 as ``.gif``.

    ``fps`` replaces the prediction's; where neither is known it is 30, and no seconds are shown. Every n-th frame
    is drawn, n as small as keeps a gif within 600 frames and 34 a second, an mp4 within 61 a second; the film lasts
    as long as the clip. Frame numbers that are missing are passed over. Axes are the camera's, or level ones.
    Raises UserError for several clips, another extension, or where the package for mp4 is not there.
    """
    extension = Path(path).suffix.lower()
    if extension not in (".gif", ".mp4"):
        raise UserError(f"cannot write {path}: a film is a .gif or an .mp4.")
    program = _ffmpeg(path) if extension == ".mp4" else None
    clip = one_clip(prediction, path)
    known = frame_rate(prediction, fps)
    rate = known or _USUAL_FPS
    scene = film_scene(prediction, clip, rate)
    scale, most, fastest = (_MP4_SCALE, len(clip.frames), _MP4_FPS) if program else (_GIF_SCALE, _GIF_FRAMES, _GIF_FPS)
    moments = thinned(len(clip.frames), rate, most, fastest)
    drawing = FilmDrawing(scene, scale, rate, timed=known is not None)
    pictures = (drawing.picture(moment) for moment in moments.tolist())
    with replacing(path) as handle:
        if program:
            _write_mp4(pictures, handle, program, drawing.size, rate * len(moments) / len(clip.frames))
        else:
            _write_gif(pictures, handle, gif_durations_ms(len(moments), len(clip.frames) / rate))


def thinned(moments: int, rate: float, most: int, fastest: float) -> Int[np.ndarray, " kept"]:
    """Return every n-th moment, n the least with no more than ``most`` of them and ``fastest`` a second."""
    return np.arange(0, moments, max(int(np.ceil(moments / most)), int(np.ceil(rate / fastest)), 1))


def gif_durations_ms(frames: int, seconds: float) -> list[int]:
    """Return how long each frame stands, in whole hundredths of a second as a gif has them, none less than two."""
    ends = np.round(np.linspace(0, max(seconds, 0.02 * frames), frames + 1) * 100).astype(int)
    return (np.diff(ends) * 10).tolist()


def _write_gif(pictures: Iterator[Image.Image], handle: BinaryIO, durations: list[int]) -> None:
    palette = film_palette()
    small = (picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    first = next(small)
    rest = {"save_all": True, "append_images": small, "duration": durations, "loop": 0, "optimize": False}
    first.save(handle, format="GIF", **rest)


def _write_mp4(
    pictures: Iterator[Image.Image], handle: BinaryIO, program: str, size: tuple[int, int], rate: float
) -> None:
    """Pipe the pictures through ffmpeg into a file of its own: an mp4's index is written last, to its beginning."""
    with tempfile.TemporaryDirectory() as folder, open(Path(folder) / "said", "w+b") as said:
        film = Path(folder) / "film.mp4"
        command = [program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        command += ["-s", f"{size[0]}x{size[1]}", "-r", f"{rate:.6f}", "-i", "-", "-an", "-c:v", "libx264"]
        command += ["-preset", "veryfast", "-crf", str(_MP4_QUALITY), "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
        # Without these, players guess the colours' matrix by the size of the picture.
        command += ["-vf", "scale=out_color_matrix=bt709:out_range=tv", "-color_range", "tv", "-colorspace", "bt709"]
        command += ["-color_primaries", "bt709", "-color_trc", "bt709"]
        with subprocess.Popen([*command, str(film)], stdin=subprocess.PIPE, stdout=said, stderr=said) as process:
            assert process.stdin is not None
            try:
                for picture in pictures:
                    process.stdin.write(picture.tobytes())
                process.stdin.close()
            except BrokenPipeError:
                pass  # ffmpeg says why below
            except BaseException:
                process.kill()
                raise
        if process.returncode:
            said.seek(0)
            words = said.read().decode("utf-8", "replace").strip().splitlines()
            raise OSError(f"ffmpeg could not make the film: {words[-1] if words else process.returncode}")
        with open(film, "rb") as made:
            shutil.copyfileobj(made, handle)


def _ffmpeg(path: str | Path) -> str:
    """Return the ffmpeg of the package imageio-ffmpeg; raises UserError where there is none."""
    hint = 'pip install "uplift3d[video]". A .gif needs nothing more.'
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        raise UserError(f"cannot write {path}: an .mp4 needs imageio-ffmpeg: {hint}") from None
    try:
        return get_ffmpeg_exe()
    except RuntimeError as error:
        raise UserError(f"cannot write {path}: imageio-ffmpeg has no ffmpeg for this machine ({error}).") from None
