"""Frames that are pictures: upright by their EXIF orientation, with the focal length that EXIF data gives."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from uplift.errors import UserError, listed
from uplift.video.base import MAX_PIXELS, Frame, Frames, reason_of

__all__ = ["PictureFrames"]


class PictureFrames(Frames):
    def __init__(self, source: str, paths: list[Path]):
        super().__init__(source)
        self._paths, self.count = paths, len(paths)
        self._unreadable: list[str] = []
        self._other: list[str] = []
        for start, path in enumerate(paths):
            try:
                image, self.focal_px = _picture(path)
            except UserError as error:
                if len(paths) == 1:
                    raise
                self._unreadable.append(path.name)
                first = str(error)
                continue
            self.height, self.width = image.shape[:2]
            self._first, self._start = image, start
            return
        raise UserError(f"{source}: none of its {len(paths):,} pictures can be read: {first}")

    def _read(self) -> Iterator[Frame]:
        yield Frame(self._first, self._start, 0.0, self._paths[self._start].name)
        for index in range(self._start + 1, len(self._paths)):
            path = self._paths[index]
            try:
                image, focal_px = _picture(path)
            except UserError:
                self._unreadable.append(path.name)
                continue
            if image.shape != self._first.shape:
                self._other.append(f"{path.name} ({image.shape[1]} x {image.shape[0]})")
            elif self.focal_px != focal_px and not any("focal" in note for note in self._notes):
                self._notes.append(
                    f"the focal length is that of {self._paths[self._start].name}; {path.name} has another"
                )
            yield Frame(image, index, 0.0, path.name)
        if self._unreadable:
            self._notes.append(f"{len(self._unreadable):,} pictures cannot be read: {listed(self._unreadable, 3)}")
        if self._other:
            size = f"{self.width} x {self.height} px as the first"
            self._notes.append(f"{len(self._other):,} pictures are not of {size}: {listed(self._other, 3)}")


def _picture(path: Path) -> tuple[UInt8[np.ndarray, "height width 3"], float | None]:
    """Return a picture upright in RGB, and its focal length in pixels where that is known.

    Raises UserError: not a picture, damaged, too large.
    """
    from PIL import Image, ImageOps, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures: refused below, before anything is decoded
            with Image.open(path) as image:
                if image.width * image.height > MAX_PIXELS:
                    raise Image.DecompressionBombError
                focal_px = _focal_px(image)
                return _rgb(ImageOps.exif_transpose(image)), focal_px
    except Image.DecompressionBombError:
        most = MAX_PIXELS // 10**6
        raise UserError(
            f"{path} is larger than {most} million pixels, the most that is opened: make a smaller copy."
        ) from None
    except PermissionError:
        raise UserError(f"{path}: no permission to read it.") from None
    except UnidentifiedImageError:
        kind = (
            "A .heic is not read" if path.suffix.lower() in (".heic", ".heif") else "It may be damaged, or no picture"
        )
        raise UserError(f"{path} cannot be read as a picture. {kind}: save it as .jpg or .png.") from None
    except MemoryError:
        raise
    except Exception as error:  # Pillow raises a dozen kinds for damaged files
        raise UserError(f"{path} is damaged and cannot be read as a picture ({reason_of(error)}).") from None


def _rgb(image: Any) -> UInt8[np.ndarray, "height width 3"]:
    """Return an image in RGB; deeper grey levels are stretched from the darkest to the brightest."""
    if image.mode.startswith(("I", "F")):
        grey = np.nan_to_num(np.asarray(image, np.float32))
        low, high = float(grey.min()), float(grey.max())
        grey = ((grey - low) * (255 / max(high - low, 1e-6))).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=-1)
    return np.asarray(image.convert("RGB"))


_EXIF_IFD = 0x8769
_FOCAL_MM, _FOCAL_35, _PLANE_X, _PLANE_UNIT, _EXIF_WIDTH, _EXIF_HEIGHT = 0x920A, 0xA405, 0xA20E, 0xA210, 0xA002, 0xA003
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}
_FILM_MM = math.hypot(36, 24)


def _focal_px(image: Any) -> float | None:
    """Return the focal length in pixels by the EXIF data of a picture; None where that does not say it.

    By the focal plane's resolution where it is given, else by the equivalent on 35 mm film, which is that of the
    picture's diagonal (CIPA DCG-001). A picture that was cut since has lost it.
    """
    try:
        exif = image.getexif().get_ifd(_EXIF_IFD)
        number = {
            key: float(exif[key]) for key in (_FOCAL_MM, _FOCAL_35, _PLANE_X, _EXIF_WIDTH, _EXIF_HEIGHT) if key in exif
        }
        unit_mm = _UNIT_MM.get(int(exif.get(_PLANE_UNIT, 2)), 25.4)
    except Exception:  # EXIF data of any kind of damage
        return None
    sides = image.width, image.height
    taken = [number.get(key) or side for key, side in zip((_EXIF_WIDTH, _EXIF_HEIGHT), sides, strict=True)]
    if (
        abs(sides[0] * taken[1] / (sides[1] * taken[0]) - 1) > 0.02
        and abs(sides[0] * taken[0] / (sides[1] * taken[1]) - 1) > 0.02
    ):
        return None
    found = []
    if number.get(_FOCAL_MM) and number.get(_PLANE_X):
        found.append(number[_FOCAL_MM] * number[_PLANE_X] / unit_mm * max(sides) / max(taken))
    if number.get(_FOCAL_35):
        found.append(number[_FOCAL_35] / _FILM_MM * math.hypot(*sides))
    return next((focal for focal in found if 0.2 < focal / max(sides) < 50), None)
