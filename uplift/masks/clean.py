"""What enters training and prediction: one whole object a mask, centred, at one scale."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from uplift.errors import UserError
from uplift.masks.container import FILL, MaskData
from uplift.masks.covered import covered
from uplift.masks.found import Found, Skipped
from uplift.masks.options import CleanOptions
from uplift.masks.pieces import PIECE, fill_noise, largest_piece
from uplift.masks.report import MIN_SIDE_PX, MaskReport
from uplift.masks.resample import resample

__all__ = ["Crop", "clean", "clean_mask"]

_FULL = 0.995
_THIN_PX = 2


@dataclass(frozen=True)
class Crop:
    """One mask cut out."""

    mask: UInt8[np.ndarray, "side side"]
    """How much of each pixel the object covers, 0..255; row 0 is the top."""
    centre_px: tuple[float, float]
    """The crop's centre in the image: x right, y down from its top left corner."""
    scale_px: float
    """Pixels of the image in half the crop's side."""
    mended: frozenset[str] = frozenset()
    """Keys of `uplift.masks.report.MENDED`."""


def clean_mask(mask: np.ndarray | Found, options: CleanOptions | None = None) -> Crop | str:
    """Return a mask's largest piece as a crop, or why it is refused: a key of `uplift.masks.report.REASONS`.

    Specks are left out, and holes of a few pixels filled; the longer side of what is left is `FILL` of the crop,
    and the middle of its box the crop's middle. ``mask`` is (height width) of any type that `covered` knows.

    Raises:
        UserError: no array of height and width, or none of numbers.
    """
    options = options or CleanOptions()
    found = mask if isinstance(mask, Found) else Found("", mask)
    object_ = covered(found.mask)
    width, height = found.image_size or object_.shape[::-1]
    if not object_.any():
        return "empty"
    if np.count_nonzero(object_) >= _FULL * width * height:
        return "full"
    object_, left, top = _boxed(object_, *found.corner_px)
    object_, second = largest_piece(object_)
    mended = set()
    if second > 0:
        object_, left, top = _boxed(object_, left, top)
        mended.add("largest" if second >= PIECE else "specks")
    tall, wide = object_.shape
    if max(tall, wide) < MIN_SIDE_PX:
        return "small"
    slack = found.slack_px
    if left <= slack or top <= slack or left + wide >= width - slack or top + tall >= height - slack:
        mended.add("cut")
    if "cut" in mended and options.border == "skip":
        return "border"
    if "largest" in mended and options.pieces == "skip":
        return "pieces"
    if min(tall, wide) < _THIN_PX:
        return "thin"
    object_, holes = fill_noise(object_)
    mended |= {"holes"} if holes else set()
    scale_px = max(tall, wide) / 2 / FILL
    crop = resample(object_, (wide / 2, tall / 2), scale_px, options.side)
    if crop.max() < 128:
        return "thin"
    return Crop(crop, (left + wide / 2, top + tall / 2), scale_px, frozenset(mended))


def _boxed(mask: np.ndarray, left: int, top: int) -> tuple[np.ndarray, int, int]:
    """Return the part of a mask inside its box, and where that is if the mask's corner is at (left, top)."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], left + int(columns[0]), top + int(rows[0])


def clean(
    items: Iterable[Found | Skipped],
    options: CleanOptions | None = None,
    *,
    most: int | None = None,
    source: str = "",
) -> tuple[MaskData, MaskReport]:
    """Return the masks that are one whole object each, cut out by `clean_mask`, and what became of the others.

    One mask is in memory at a time. With ``most`` no more are looked at once that many are found.

    Raises:
        UserError: none is left: what was wrong with them.
    """
    options, report = options or CleanOptions(), MaskReport()
    kept: list[tuple[Found, Crop]] = []
    for item in items:
        result = item.reason if isinstance(item, Skipped) else clean_mask(item, options)
        if isinstance(result, str):
            report.skip(item.name, result)
            continue
        assert isinstance(item, Found)
        item.mask = result.mask  # the picture itself is let go
        kept.append((item, result))
        report.kept += 1
        report.mended.update(result.mended)
        if most is not None and len(kept) >= most:
            break
    where = f"{source}: " if source else ""
    if not kept:
        why = f": {'; '.join(report.reasons())}" if report.skipped else ""
        raise UserError(f"{where}none of {report.masks:,} masks can be used{why}.")
    return _gathered(sorted(kept, key=lambda one: one[0].order), source), report


def _gathered(kept: list[tuple[Found, Crop]], source: str) -> MaskData:
    found = [one for one, _ in kept]
    return MaskData(
        masks=np.stack([crop.mask for _, crop in kept]),
        names=[one.name for one in found],
        centre_px=np.array([crop.centre_px for _, crop in kept], np.float32),
        scale_px=np.array([crop.scale_px for _, crop in kept], np.float32),
        category=np.array([one.category for one in found]) if any(one.category for one in found) else None,
        images=np.array([one.image for one in found]) if any(one.image for one in found) else None,
        source=source,
    )
