"""What became of each mask: counts, reasons and a few names."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

__all__ = ["MENDED", "MIN_SIDE_PX", "REASONS", "MaskReport"]

MIN_SIDE_PX = 12
"""The longer side of the box of the smallest mask that is taken."""

REASONS = {
    "empty": "empty",
    "full": "the whole image is covered",
    "border": "the object touches the border of the image, so it is cut off (border=keep takes these)",
    "pieces": "several pieces of similar size (pieces=largest takes the largest of each)",
    "small": f"smaller than {MIN_SIDE_PX} px",
    "thin": "thinner than a pixel",
    "crowd": "a crowd, not one object",
    "score": "a score below 0.5",
    "no_outline": "no segmentation",
    "damaged": "the segmentation is damaged",
    "no_image": "an image that the file does not have",
    "unreadable": "no picture, or a damaged one",
    "huge": "more than 100 million pixels",
    "photo": "a photo or drawing of many shades, not a mask",
    "labels": "several labels in one picture (format=labels takes each as an object)",
    "no_background": "no pixel is 0, the background of a label image",
}
"""Why a mask is skipped: key -> in words."""

MENDED = {
    "specks": "specks left out",
    "holes": "holes of a few pixels filled",
    "cut": "taken though cut off at the border (border=keep)",
    "largest": "the largest of several pieces taken (pieces=largest)",
}
"""What is mended: key -> in words."""

_SHOWN = 3


@dataclass
class MaskReport:
    """What `clean` found, in counts."""

    kept: int = 0
    skipped: Counter[str] = field(default_factory=Counter)
    """Reason, a key of `REASONS` -> how many."""
    names: dict[str, list[str]] = field(default_factory=dict)
    """Reason -> the first few that were skipped for it."""
    mended: Counter[str] = field(default_factory=Counter)
    """Key of `MENDED` -> how many masks."""

    @property
    def masks(self) -> int:
        """How many came in."""
        return self.kept + self.skipped.total()

    def skip(self, name: str, reason: str) -> None:
        """Count one that is not taken."""
        self.skipped[reason] += 1
        shown = self.names.setdefault(reason, [])
        if len(shown) < _SHOWN:
            shown.append(name)

    def reasons(self) -> list[str]:
        """Return what was skipped, the most frequent reason first, as ``3: empty (a.png, b.png, ...)``."""
        return [f"{count:,}: {REASONS[key]} ({self._named(key)})" for key, count in self.skipped.most_common()]

    def lines(self) -> list[str]:
        """Return the findings worth telling, one sentence each; none when all masks were whole."""
        found = [
            f"{count:,} of {self.masks:,} masks skipped: {REASONS[key]} ({self._named(key)})"
            for key, count in self.skipped.most_common()
        ]
        return found + [f"{count:,} of {self.kept:,} masks: {MENDED[key]}" for key, count in self.mended.most_common()]

    def _named(self, reason: str) -> str:
        more = ", ..." if self.skipped[reason] > len(self.names[reason]) else ""
        return ", ".join(name if len(name) < 80 else f"...{name[-76:]}" for name in self.names[reason]) + more
