"""A canvas for the pictures of a film: smooth lines, dots and text in a few colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

__all__ = ["CARD", "FAINT", "FLOOR", "INK", "PAPER", "SHADOW", "SIDES", "SOFT", "Canvas", "film_palette", "mixed"]

PAPER, CARD, INK, SOFT, FAINT = (246, 245, 241), (255, 254, 251), (34, 38, 43), (107, 113, 120), (220, 218, 210)
FLOOR, SHADOW = (207, 204, 194), (228, 226, 221)
SIDES = ((0x4A, 0x50, 0x58), (0x1F, 0x77, 0xB8), (0xD9, 0x63, 0x0F))
"""Colours of the centre, the left and the right."""
_SHARPEN = 2

Number = int | float
Colour = tuple[int, ...]
Point = Sequence[Number] | np.ndarray


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """Return ``colour`` with so much of ``other`` in it."""
    return tuple(round(a + (b - a) * share) for a, b in zip(colour, other, strict=True))


def film_palette() -> Image.Image:
    """Return an image with a palette of what the drawings blend."""
    ramps = [[mixed(side, CARD, step / 24) for step in range(24)] for side in SIDES]
    ramps += [[mixed(grey, CARD, step / 8) for step in range(8)] for grey in (SOFT, INK, FLOOR, SHADOW, FAINT)]
    ramps += [[mixed(grey, PAPER, step / 10) for step in range(10)] for grey in (INK, SOFT, FAINT, *SIDES)]
    ramps += [[mixed(side, SHADOW, 0.5) for side in SIDES], [CARD, PAPER]]
    colours = dict.fromkeys(colour for ramp in ramps for colour in ramp)
    # Pillow finds a near colour, not always the nearest: nothing else may be near the two large areas.
    colours = [one for one in colours if one in (CARD, PAPER) or min(_gap(one, CARD), _gap(one, PAPER)) > 8]
    image = Image.new("P", (1, 1))
    image.putpalette([part for colour in colours for part in colour])
    return image


def _gap(one: Colour, other: Colour) -> int:
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


class Canvas:
    """A picture so many units wide and high, ``scale`` pixels to a unit, drawn finer and then shrunk."""

    def __init__(self, wide: Number, high: Number, scale: Number, back: Colour):
        self.wide, self.high = wide, high
        self._unit = scale * _SHARPEN
        self._image = Image.new("RGB", (round(wide * scale) * _SHARPEN, round(high * scale) * _SHARPEN), back)
        self._draw = ImageDraw.Draw(self._image)

    def line(self, start: Point, end: Point, width: Number, colour: Colour) -> None:
        """Draw a line with flat ends."""
        ends = [(float(point[0]) * self._unit, float(point[1]) * self._unit) for point in (start, end)]
        self._draw.line(ends, fill=colour, width=max(1, round(width * self._unit)))

    def dot(self, at: Point, radius: Number, colour: Colour, rim: Colour | None = None) -> None:
        """Draw a disc, in a thin rim where that has a colour."""
        x, y = float(at[0]) * self._unit, float(at[1]) * self._unit
        for size, fill in ((radius + 1.2, rim), (radius, colour)):
            if fill is not None:
                r = size * self._unit
                self._draw.ellipse([x - r, y - r, x + r, y + r], fill=fill)

    def box(self, corners: Sequence[Number], round_by: Number, fill: Colour | None, edge: Colour | None = None) -> None:
        """Draw a box from left, top, right, bottom."""
        places = [part * self._unit for part in corners]
        width = max(1, round(1.2 * self._unit))
        self._draw.rounded_rectangle(places, round_by * self._unit, fill=fill, outline=edge, width=width)

    def text(self, at: Point, words: str, size: Number, colour: Colour, anchor: str) -> None:
        """Write words, anchored as Pillow names it."""
        font = ImageFont.load_default(size=round(size * self._unit))
        place = float(at[0]) * self._unit, float(at[1]) * self._unit
        self._draw.text(place, words, fill=colour, font=font, anchor=anchor)

    def finished(self) -> Image.Image:
        """Return the picture in its own size."""
        return self._image.reduce(_SHARPEN)
