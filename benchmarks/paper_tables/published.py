"""The published figures: Tables 1 and 2 of Kudo et al. 2018, and the figure in its supplement.

Kudo, Ogaki, Matsui, Odagiri: "Unsupervised Adversarial Learning of 3D Human Pose from 2D Joint Locations",
arXiv 1803.08244. Its Table 1 spells Tung et al. "Tang et al."; this is corrected here.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["COLUMNS", "KUDO_3DHP", "MEHTA_3DHP", "PUBLISHED", "Published"]

COLUMNS = (
    "Direct.", "Discuss", "Eating", "Greet", "Phone", "Photo", "Pose", "Purch.",
    "Sitting", "SittingD", "Smoke", "Wait", "WalkD", "Walk", "WalkT",
)  # fmt: skip
"""The actions of both tables, in the paper's order."""


@dataclass(frozen=True)
class Published:
    """One row: mm for each of `COLUMNS`, None for a dash, and the average as printed."""

    method: str
    sees: str
    """The input."""
    uses: str
    """The training signal."""
    errors: tuple[float | None, ...]
    average: float


def _row(method: str, sees: str, figures: str, uses: str = "3D") -> Published:
    errors = [None if figure == "-" else float(figure) for figure in figures.split()]
    assert len(errors) == len(COLUMNS) + 1 and errors[-1] is not None
    return Published(method, sees, uses, tuple(errors[:-1]), errors[-1])


PUBLISHED: dict[str, tuple[Published, ...]] = {
    "table1": (
        _row("Tung et al. 2017", "GT",
             "53.7 71.5 82.3 58.6 86.9 98.4 57.6 104.2 100.0 112.5 83.3 68.9 - 57.0 - 79.0"),
        _row("Martinez et al. 2017", "GT",
             "37.7 44.4 40.3 42.1 48.2 54.9 44.4 42.1 54.6 58.0 45.1 46.4 47.6 36.4 40.4 45.5"),
        _row("Kudo et al. 2018", "GT",
             "125.0 137.9 107.2 130.8 115.1 127.3 147.7 128.7 134.7 139.8 114.5 147.1 130.8 125.6 151.1 130.9",
             "2D"),
    ),
    "table2": (
        _row("Ionescu et al. 2014", "image",
             "132.7 183.6 132.3 164.4 162.1 205.9 150.6 171.3 151.6 243.0 162.1 170.7 177.1 96.6 127.9 162.1"),
        _row("Tung et al. 2017", "image",
             "77.6 91.4 89.9 88.0 107.3 110.1 75.9 107.5 124.2 137.8 102.2 90.3 - 78.6 - 97.2"),
        _row("Tome et al. 2017", "image",
             "65.0 73.5 76.8 86.4 86.3 110.7 68.9 74.8 110.2 173.9 85.0 85.8 86.3 71.4 73.1 88.4"),
        _row("Pavlakos et al. 2017", "image",
             "67.4 72.0 66.7 69.1 72.0 77.0 65.0 68.3 83.7 96.5 71.7 65.8 74.9 59.1 63.2 71.9"),
        _row("Martinez et al. 2017", "SH",
             "51.8 56.2 58.1 59.0 69.5 78.4 55.2 58.1 74.0 94.6 62.3 59.1 65.1 49.5 52.4 62.9"),
        _row("Zhou et al. 2017", "image",
             "54.8 60.7 58.2 71.4 62.0 65.5 53.8 55.6 75.2 111.6 64.2 66.1 51.4 63.2 55.3 64.9"),
        _row("Kudo et al. 2018", "SH",
             "161.3 174.3 143.1 169.2 161.7 174.1 180.7 178.0 170.6 191.4 157.4 182.3 180.7 180.3 193.4 173.2",
             "2D"),
    ),
}  # fmt: skip

KUDO_3DHP = 89.3
"""Percent, called PCK at 150 mm in the supplement. The authors' script (bin/eval_pck.py of
github.com/DwangoMediaVillage/3dpose_gan) measures only the z error, on training data."""

MEHTA_3DHP = 84.1
"""Percent, PCK at 150 mm of Mehta et al. 2017 with green screen, from images: what the supplement compares with."""
