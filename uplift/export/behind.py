"""Small pictures behind the 2D of a page: what the video shows around the keypoints of each clip."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from uplift.config.progress import progress
from uplift.export.clips import Clip
from uplift.export.footage import Footage
from uplift.models.prediction import Prediction

__all__ = ["pictures_behind"]

_MOST_BYTES = 12_000_000
"""Of all pictures of a page; as text they are a third longer."""
_KINDS = ((480, 70), (480, 55), (400, 50), (320, 45), (256, 40))
"""Sides of the pictures, px, and their JPEG quality, best first."""
_AROUND = 0.75
"""How far pictures reach from the middle of the keypoints, in extents of these."""

Box = tuple[float, float, float, float]
"""Left, top, right, bottom in px of the keypoints."""


def pictures_behind(
    prediction: Prediction, clips: Sequence[Clip], chosen: Sequence[Clip], video: str | Path
) -> tuple[list[dict[str, Any] | None], str]:
    """Return what a page draws behind each of the ``chosen`` of all ``clips``, and a remark where moments share pictures.

    A clip has ``x``, ``y``, ``wide`` and ``tall`` of its pictures in px of the keypoints, and ``jpegs``, one for
    ``every`` so many moments, in base64; empty where there is none. Raises UserError as `Footage` does.
    """
    footage = Footage(video, prediction)
    shown = footage.of(chosen, of=len(clips))
    boxes = [_box(prediction, clip, footage.image_size) for clip in chosen]
    moments = sum(len(clip.frames) for clip, shows in zip(chosen, shown, strict=True) if shows)
    found: list[dict[str, Any] | None] = []
    kind: _Kind | None = None
    for clip, shows, box in zip(chosen, shown, boxes, strict=True):
        if not shows:
            found.append(None)
            continue
        if kind is None:
            _, first = next(footage.images(clip, range(len(clip.frames)), alone=len(clips) == 1))
            kind = _Kind.for_bytes(first, _in_image(first, box, footage.image_size), _MOST_BYTES / moments)
        wanted = range(0, len(clip.frames), kind.every)
        jpegs = [""] * len(wanted)
        images: Iterator[Any] = footage.images(clip, wanted, alone=len(clips) == 1)
        for moment, image in progress(images, "pictures behind the 2D", len(wanted)):
            jpegs[moment // kind.every] = kind.jpeg(image, _in_image(image, box, footage.image_size))
        left, top, right, bottom = box
        sides = {"x": left, "y": top, "wide": right - left, "tall": bottom - top}
        found.append({**sides, "every": kind.every, "jpegs": jpegs})
    every = 1 if kind is None else kind.every
    return found, f"The pictures behind the 2D are every {every}th frame, to keep the page small." * (every > 1)


class _Kind:
    """How large and how good pictures are, and of how many moments each is."""

    def __init__(self, side: int, quality: int, every: int = 1):
        self.side, self.quality, self.every = side, quality, every

    @classmethod
    def for_bytes(cls, image: UInt8[np.ndarray, "height width 3"], box: Box, most: int | float) -> _Kind:
        """Return the best kind of which ``image`` takes no more bytes; else the least, of every so many moments."""
        size = math.inf
        for side, quality in _KINDS:
            kind = cls(side, quality)
            size = len(kind.jpeg(image, box)) * 3 / 4
            if size <= most:
                return kind
        return cls(*_KINDS[-1], every=math.ceil(size / most))

    def jpeg(self, image: UInt8[np.ndarray, "height width 3"], box: Box) -> str:
        """Return what is in the box, in px of the image, as a JPEG in base64."""
        left, top, right, bottom = (round(side) for side in box)
        part = Image.fromarray(image[max(0, top) : max(bottom, top + 1), max(0, left) : max(right, left + 1)])
        ratio = min(1.0, math.sqrt(0.75 * self.side**2 / (part.width * part.height)), 2 * self.side / max(part.size))
        small = max(1, round(part.width * ratio)), max(1, round(part.height * ratio))
        buffer = io.BytesIO()
        part.resize(small, Image.Resampling.BILINEAR, reducing_gap=2).save(buffer, "JPEG", quality=self.quality)
        return base64.b64encode(buffer.getvalue()).decode("ascii")


def _box(prediction: Prediction, clip: Clip, size: Sequence[int]) -> Box:
    """Return the part of the image with the keypoints of a clip and what is around them; all of it where there are none."""
    points = np.asarray(prediction.keypoints, float)[clip.rows]
    seen = np.isfinite(points).all(-1) & (np.nan_to_num(np.asarray(prediction.confidence)[clip.rows]) > 0)
    whole = np.array(size, float)
    if not seen.any():
        return 0.0, 0.0, whole[0], whole[1]
    low, high = (np.clip(end, 0, whole) for end in (points[seen].min(0), points[seen].max(0)))
    reach = max(_AROUND * float((high - low).max()), float(whole.max()) / 8)
    low, high = np.clip((low + high) / 2 - reach, 0, whole - 1), np.clip((low + high) / 2 + reach, 1, whole)
    left, top, right, bottom = (round(float(side), 1) for side in (*low, *high))
    return left, top, right, bottom


def _in_image(image: np.ndarray, box: Box, size: Sequence[int]) -> Box:
    """Return a box in px of the keypoints in those of an image."""
    across, along = image.shape[1] / size[0], image.shape[0] / size[1]
    return box[0] * across, box[1] * along, box[2] * across, box[3] * along
