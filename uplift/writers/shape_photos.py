"""The part of a photo that a mask's crop shows, small, as text for a page."""

from __future__ import annotations

import base64
import io
from pathlib import Path, PurePosixPath

import numpy as np

from uplift.errors import UserError
from uplift.shapes.prediction import ShapePrediction

__all__ = ["photos_of"]

_SIDE_PX, _QUALITY = 224, 72
_MOST_PIXELS = 120_000_000


def photos_of(prediction: ShapePrediction, folder: str | Path | None) -> tuple[list[str], list[str]]:
    """Return each item's crop of its photo as a data address, empty where there is none, and what went wrong.

    Photos are looked for in ``folder``, by their whole name and by its last part, and without a folder where
    `ShapePrediction.images` says. Raises UserError for a folder that is none.
    """
    if folder is not None and not Path(folder).expanduser().is_dir():
        raise UserError(f"images={folder}: no such folder. Expected the folder with the photos of the masks.")
    if prediction.images is None:
        return [""] * len(prediction), []
    found, wrong = [], []
    for item, name in enumerate(str(image) for image in prediction.images):
        path = _find(name, folder) if name else None
        data = ""
        if path is not None:
            try:
                data = _crop(path, prediction.centre_px[item], float(prediction.scale_px[item]))
            except (OSError, ValueError, SyntaxError) as error:
                wrong.append(f"{name}: {error}")
        found.append(data)
    notes = [f"{len(wrong)} photos could not be read, such as {wrong[0]}."] if wrong else []
    return found, notes


def _find(name: str, folder: str | Path | None) -> Path | None:
    if folder is None:
        return Path(name) if Path(name).is_file() else None
    named = PurePosixPath(name)
    # A name never leads out of the folder.
    inside = [] if named.is_absolute() or ".." in named.parts else [named]
    for part in [*inside, PurePosixPath(named.name)]:
        path = Path(folder).expanduser() / part
        if path.is_file():
            return path
    return None


def _crop(path: Path, centre: np.ndarray, half: float) -> str:
    """Return the square about ``centre``, 2 ``half`` pixels wide, grey where the photo ends."""
    from PIL import Image

    try:
        photo = Image.open(path)
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from error
    with photo:
        if photo.width * photo.height > _MOST_PIXELS:
            raise ValueError(f"is {photo.width} x {photo.height} px, more than is opened for a small picture")
        low, high = centre - half, centre + half
        left, top = (max(0, round(float(edge))) for edge in low)
        right, bottom = min(photo.width, round(float(high[0]))), min(photo.height, round(float(high[1])))
        if right - left < 2 or bottom - top < 2:
            raise ValueError(f"is {photo.width} x {photo.height} px and the mask is not in it")
        share = _SIDE_PX / (2 * half)
        start = round((left - low[0]) * share), round((top - low[1]) * share)
        size = max(1, round((right - left) * share)), max(1, round((bottom - top) * share))
        small = photo.convert("RGB").resize(size, Image.Resampling.BILINEAR, (left, top, right, bottom), reducing_gap=2)
    square = Image.new("RGB", (_SIDE_PX, _SIDE_PX), (128, 128, 128))
    square.paste(small, start)
    buffer = io.BytesIO()
    square.save(buffer, "JPEG", quality=_QUALITY, optimize=True)
    return f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
