"""What enters training and prediction: one complete object a mask, centred, at one scale."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, UInt8

from uplift.config.settings import MAX_SIDE, MIN_SIDE
from uplift.data.masks import FILL, Found, MaskData, Skipped
from uplift.errors import UserError, nearest

__all__ = ["CHANGES", "REASONS", "CleanOptions", "Crop", "MaskOptions", "clean", "clean_mask", "covered", "resample"]


@dataclass(frozen=True)
class CleanOptions:
    """How masks are cut out, and which are refused."""

    side: int = 64
    """Pixels along a crop."""
    border: str = "skip"
    """Objects that touch the border of the image: skip or keep."""
    pieces: str = "skip"
    """Objects in several pieces of similar size: skip, or take the largest."""

    def __post_init__(self) -> None:
        if isinstance(self.side, bool) or not isinstance(self.side, int) or not MIN_SIDE <= self.side <= MAX_SIDE:
            raise UserError(f"side={self.side}: expected a whole number of pixels from {MIN_SIDE} to {MAX_SIDE}.")
        for name, valid in (("border", ("skip", "keep")), ("pieces", ("skip", "largest"))):
            value = getattr(self, name)
            if value not in valid:
                raise UserError(f"{name}={value}: expected {' or '.join(valid)}.{nearest(value, valid)}")


@dataclass(frozen=True)
class MaskOptions(CleanOptions):
    """How the masks of a file are read, and which are taken."""

    format: str | None = None
    """Name of the format; unset: guessed."""
    category: tuple[str, ...] = ()
    """Which categories are taken; none named: all."""
    most: int | None = None
    """How many masks are taken at most, spread over the file."""
    images: str | None = None
    """Folder of the photos that the masks belong to."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.most is not None and (isinstance(self.most, bool) or not isinstance(self.most, int) or self.most < 1):
            raise UserError(f"most={self.most}: expected a whole number of masks from 1 up.")


_MIN_SIDE_PX = 12
"""The longer side of the box of the smallest mask that is taken."""

REASONS = {
    "empty": "empty",
    "full": "the whole image is covered",
    "border": "the object touches the border of the image, so it is cut off (border=keep takes these)",
    "pieces": "several pieces of similar size (pieces=largest takes the largest of each)",
    "small": f"smaller than {_MIN_SIDE_PX} px",
    "thin": "thinner than a pixel",
    "crowd": "a crowd, not one object",
    "score": "a score below 0.5",
    "no_outline": "no segmentation",
    "damaged": "the segmentation is damaged",
    "no_image": "an image that the file does not have",
    "unreadable": "no picture, or a damaged one",
    "huge": "more than 100 million pixels",
    "wide": "more than 50 million pixels in colours or of 32 bits",
    "scattered": "labels that are scattered over all of the picture, not objects",
    "photo": "a photo or drawing of many shades, not a mask",
    "labels": "several labels in one picture (format=labels takes each as an object)",
    "no_background": "no pixel is 0, the background of a label image",
}
"""Why a mask is skipped: key -> in words."""

CHANGES = {
    "specks": "specks left out",
    "holes": "holes of a few pixels filled",
    "cut": "taken though cut off at the border (border=keep)",
    "largest": "the largest of several pieces taken (pieces=largest)",
}
"""What is changed in a mask: key -> in words."""

_SHOWN = 3


@dataclass
class _MaskReport:
    """What `clean` found, in counts."""

    kept: int = 0
    skipped: Counter[str] = field(default_factory=Counter)
    """Reason, a key of `REASONS` -> how many."""
    names: dict[str, list[str]] = field(default_factory=dict)
    """Reason -> the first few that were skipped for it."""
    changes: Counter[str] = field(default_factory=Counter)
    """Key of `CHANGES` -> how many masks."""

    def lines(self) -> list[str]:
        """Return the findings worth reporting, one sentence each; none when all masks were complete."""
        masks = self.kept + self.skipped.total()
        found = [f"{self.skipped[key]:,} of {masks:,} masks skipped: {why}" for key, why in self.reasons()]
        return found + [
            f"{count:,} of {self.kept:,} masks: {CHANGES[key]}" for key, count in self.changes.most_common()
        ]

    def reasons(self) -> Iterator[tuple[str, str]]:
        """Yield why masks were skipped, the most frequent first: key and text, as ``empty (a.png, b.png, ...)``."""
        for key, count in self.skipped.most_common():
            more = ", ..." if count > len(self.names[key]) else ""
            names = (name if len(name) < 80 else f"...{name[-76:]}" for name in self.names[key])
            yield key, f"{REASONS[key]} ({', '.join(names)}{more})"


def covered(mask: np.ndarray) -> np.ndarray:
    """Return (height width) bool of a mask of any type: true or false, 0 and 1, 0 to 255, a coverage from 0 to 1.

    An array of two numbers is covered where it has the larger one. Others are cut at half of 1, 255 or 65535,
    whichever is the first that they do not pass. NaN is not covered.

    Raises UserError: no array of height and width, or none of numbers.
    """
    if mask.ndim != 2 or mask.dtype.kind not in "buif":
        raise UserError(f"A mask is {mask.dtype} of shape {mask.shape}, expected numbers of shape (height, width).")
    if mask.dtype == bool or mask.size == 0:
        return mask.astype(bool)
    if mask.dtype.kind == "f":
        mask = np.nan_to_num(mask, nan=0.0, posinf=0.0, neginf=0.0)
    low, high = mask.min(), mask.max()
    if low < high and ((mask == low) | (mask == high)).all():
        return mask == high
    full = next((most for most in (1, 255, 65535) if high <= most), high)
    return mask >= full / 2


# The pieces and holes of a mask: which is the object, and which are noise.

_PIECE = 0.1
"""Of the largest piece's area: a smaller one is a speck, a larger one a part of something."""
_HOLE = 0.001
"""Of the object's area: a smaller hole is noise; one pixel always is."""


def _largest_piece(mask: Bool[np.ndarray, "height width"]) -> tuple[Bool[np.ndarray, "height width"], float]:
    """Return the piece of most pixels (joined by sides or corners), and the second one's share of its area: 0 where it is alone."""
    from skimage.measure import label  # takes half a second to import, and those who only look at files need none

    numbers = np.asarray(label(mask, connectivity=2))
    if numbers.max(initial=0) < 2:
        return mask, 0.0
    areas = np.bincount(numbers.reshape(-1))[1:]
    second, first = np.sort(areas)[-2:]
    return numbers == 1 + int(np.argmax(areas)), float(second / first)


def _fill_noise(mask: Bool[np.ndarray, "height width"]) -> tuple[Bool[np.ndarray, "height width"], int]:
    """Return a mask without holes that are too small to be real, and how many there were.

    A hole is joined by sides alone, and does not reach the mask's edge: what lies between the legs of a chair
    is not a hole, or a large one, and stays.
    """
    from skimage.measure import label

    numbers = np.asarray(label(~mask, connectivity=1))
    rim = np.concatenate([numbers[0], numbers[-1], numbers[:, 0], numbers[:, -1]])
    areas = np.bincount(numbers.reshape(-1))
    noise = areas <= max(1.0, _HOLE * areas[0])
    noise[0] = noise[rim] = False  # the object itself, and what is around it
    if not noise.any():
        return mask, 0
    return mask | noise[numbers], int(noise.sum())


# A mask at another scale, with anti-aliasing: how much of each pixel of the crop the object covers.

_EVEN = 1e-6
"""Above a half: what is exactly between two numbers goes up, whatever the last bits of a sum say."""


def resample(
    cover: Bool[np.ndarray, "height width"] | UInt8[np.ndarray, "height width"],
    centre_px: tuple[float, float],
    scale_px: float,
    side: int,
) -> UInt8[np.ndarray, "side side"]:
    """Return a square crop of a mask: `centre_px` is its middle, `scale_px` half its side, 0 beyond the mask.

    The mask's top left corner is (0, 0), and its first pixel reaches to (1, 1). A crop pixel is the mean of what
    it sees. Where the crop is finer than the mask, the mask is interpolated, and its edges made as sharp as the
    crop allows: about half way between a pixel that is covered and one that is not.
    """
    down, first, last = _weights(cover.shape[0], centre_px[1], scale_px, side)
    across, _, _ = _weights(cover.shape[1], centre_px[0], scale_px, side)
    seen = np.zeros((side, cover.shape[1]))
    for row, (start, stop) in enumerate(zip(first, last, strict=True)):
        if start < stop:  # the mask's rows are many, those that one row of the crop sees are few
            seen[row] = down[row, start:stop] @ cover[start:stop]
    value = seen @ across.T / (1 if cover.dtype == bool else 255)
    finer = max(1.0, side / (2 * scale_px))
    value = np.clip((value - 0.5) * finer + 0.5, 0, 1)
    return np.floor(value * 255 + 0.5 + _EVEN).astype(np.uint8)


def _weights(
    length: int, centre_px: float, scale_px: float, side: int
) -> tuple[Float[np.ndarray, "side length"], np.ndarray, np.ndarray]:
    """Return the share of each of a mask's pixels in each of the crop's along one axis, and the first and the end of those it sees."""
    middle = centre_px + (2 * np.arange(side) + 1 - side) / side * scale_px
    width = max(1.0, 2 * scale_px / side)
    low, high = (middle - width / 2)[:, None], (middle + width / 2)[:, None]
    pixel = np.arange(length)
    weights = np.maximum(np.minimum(high, pixel + 1) - np.maximum(low, pixel), 0) / width
    first = np.clip(np.floor(low[:, 0]), 0, length).astype(int)
    last = np.clip(np.ceil(high[:, 0]), 0, length).astype(int)
    return weights, first, last


_FULL = 0.995
_THIN_PX = 2
_MOST_PX = 1 << 24
"""Pixels in the box of an object: of a larger one every second or third along each axis is as good for a small crop."""


@dataclass(frozen=True)
class Crop:
    """One mask cut out."""

    mask: UInt8[np.ndarray, "side side"]
    """How much of each pixel the object covers, 0..255; row 0 is the top."""
    centre_px: tuple[float, float]
    """The crop's centre in the image: x right, y down from its top left corner."""
    scale_px: float
    """Pixels of the image in half the crop's side."""
    changes: frozenset[str] = frozenset()
    """Keys of `uplift.data.clean_masks.CHANGES`."""


def clean_mask(mask: np.ndarray | Found, options: CleanOptions | None = None) -> Crop | str:
    """Return a mask's largest piece as a crop, or why it is refused: a key of `uplift.data.clean_masks.REASONS`.

    Specks are left out, and holes of a few pixels filled; the longer side of what is left is `FILL` of the crop,
    and the middle of its box the crop's middle. ``mask`` is (height width) of any type that `covered` knows.

    Raises UserError: no array of height and width, or none of numbers.
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
    bottom, right = top + object_.shape[0], left + object_.shape[1]
    step = math.isqrt((object_.size - 1) // _MOST_PX) + 1
    object_, second = _largest_piece(object_[::step, ::step])
    changes = set()
    if second > 0:
        object_, left, top = _boxed(object_, left, top, step)
        changes.add("largest" if second >= _PIECE else "specks")
    tall = min(object_.shape[0] * step, bottom - top)
    wide = min(object_.shape[1] * step, right - left)
    if max(tall, wide) < _MIN_SIDE_PX:
        return "small"
    slack = found.slack_px
    if left <= slack or top <= slack or left + wide >= width - slack or top + tall >= height - slack:
        changes.add("cut")
    if "cut" in changes and options.border == "skip":
        return "border"
    if "largest" in changes and options.pieces == "skip":
        return "pieces"
    if min(tall, wide) < _THIN_PX:
        return "thin"
    object_, holes = _fill_noise(object_)
    changes |= {"holes"} if holes else set()
    scale_px = max(tall, wide) / 2 / FILL
    crop = resample(object_, (wide / 2 / step, tall / 2 / step), scale_px / step, options.side)
    if crop.max() < 128:
        return "thin"
    return Crop(crop, (left + wide / 2, top + tall / 2), scale_px, frozenset(changes))


def _boxed(mask: np.ndarray, left: int, top: int, step: int = 1) -> tuple[np.ndarray, int, int]:
    """Return the part of a mask inside its box, and where that is if the mask's corner is at (left, top).

    ``step`` says how many pixels of the image are one of the mask's.
    """
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    inside = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return inside, left + step * int(columns[0]), top + step * int(rows[0])


def clean(
    items: Iterable[Found | Skipped], options: CleanOptions | None = None, *, most: int | None = None, source: str = ""
) -> tuple[MaskData, _MaskReport]:
    """Return the masks that are one complete object each, cut out by `clean_mask`, and what became of the others.

    One mask is in memory at a time. With ``most`` no more are looked at once that many are found.

    Raises UserError: none is left: what was wrong with them.
    """
    options, report = options or CleanOptions(), _MaskReport()
    kept: list[tuple[Found, Crop]] = []
    for item in items:
        result = item.reason if isinstance(item, Skipped) else clean_mask(item, options)
        if isinstance(result, str):
            report.skipped[result] += 1
            if report.skipped[result] <= _SHOWN:
                report.names.setdefault(result, []).append(item.name)
            continue
        assert isinstance(item, Found)
        item.mask = result.mask  # the picture itself is let go
        kept.append((item, result))
        report.kept += 1
        report.changes.update(result.changes)
        if most is not None and len(kept) >= most:
            break
    where = f"{source}: " if source else ""
    if not kept:
        why = "; ".join(f"{report.skipped[key]:,}: {text}" for key, text in report.reasons())
        masks = report.skipped.total()
        raise UserError(f"{where}none of {masks:,} masks can be used{why and ': '}{why}.")
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
