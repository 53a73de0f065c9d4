"""Photographs that poses came from: found by the name of the frame, cropped to the body, small."""

from __future__ import annotations

import base64
import io
from pathlib import Path, PurePosixPath

import numpy as np

from uplift.errors import UserError
from uplift.writers.gallery_views import Crop

__all__ = ["Photos"]

_ENDINGS = (".jpg", ".jpeg", ".png")
_SIDE_PX, _QUALITY = 320, 72
_MOST_PIXELS = 120_000_000


class Photos:
    """The photographs of one folder."""

    def __init__(self, folder: str | Path):
        self.folder = Path(folder).expanduser()
        if not self.folder.is_dir():
            raise UserError(
                f"images={folder}: no such folder. Expected the folder with the photos of the input's frames."
            )
        self.shown = 0
        self.absent: list[str] = []
        self.unreadable: list[str] = []

    def cropped(self, name: str, crop: Crop) -> str:
        """Return an SVG image of what ``crop`` shows of the photo ``name``; nothing where there is none."""
        path = self._find(name)
        if path is None:
            self.absent.append(name)
            return ""
        try:
            found = _read(path, crop)
        except (OSError, ValueError, SyntaxError) as error:
            self.unreadable.append(f"{name} ({error})")
            return ""
        self.shown += bool(found)
        return found

    def _find(self, name: str) -> Path | None:
        """Return the photo's file: as it is named, or its last part, never outside of the folder."""
        named = PurePosixPath(name)
        if not named.name:
            return None
        safe = [] if named.is_absolute() or ".." in named.parts else [named]
        for part in [*safe, PurePosixPath(named.name)]:
            for ending in ("", *_ENDINGS):
                path = self.folder / f"{part}{ending}"
                if path.is_file():
                    return path
        return None


def _read(path: Path, crop: Crop) -> str:
    from PIL import Image

    try:
        photo = Image.open(path)
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from error
    with photo:
        if photo.width * photo.height > _MOST_PIXELS:
            raise ValueError(f"is {photo.width} x {photo.height} px, more than is opened for a small picture")
        # The stored pixels, as keypoints count them: a camera's note on how it was held is not applied.
        left, top = max(0, round(crop.left)), max(0, round(crop.top))
        right, bottom = min(photo.width, round(crop.left + crop.side)), min(photo.height, round(crop.top + crop.side))
        if right - left < 2 or bottom - top < 2:
            raise ValueError(f"is {photo.width} x {photo.height} px and the body is not in it")
        scale = min(1.0, _SIDE_PX / crop.side)
        size = max(1, int((right - left) * scale)), max(1, int((bottom - top) * scale))
        small = photo.convert("RGB").resize(size, Image.Resampling.BOX, (left, top, right, bottom))
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=_QUALITY, optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    (x, y), (x1, y1) = crop.place(np.array([[left, top], [right, bottom]], float))
    return (
        f'<image x="{x:.1f}" y="{y:.1f}" width="{x1 - x:.1f}" height="{y1 - y:.1f}" preserveAspectRatio="none" '
        f'href="data:image/jpeg;base64,{data}"/>'
    )
