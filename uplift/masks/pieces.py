"""The pieces and holes of a mask: which is the object, and which are noise."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool
from skimage.measure import label

__all__ = ["HOLE", "PIECE", "fill_noise", "largest_piece"]

PIECE = 0.1
"""Of the largest piece's area: a smaller one is a speck, a larger one a part of something."""
HOLE = 0.001
"""Of the object's area: a smaller hole is noise; one pixel always is."""


def largest_piece(
    mask: Bool[np.ndarray, "height width"],
) -> tuple[Bool[np.ndarray, "height width"], float]:
    """Return the piece of most pixels (joined by sides or corners), and the second one's share of its area: 0 where it is alone."""
    numbers = np.asarray(label(mask, connectivity=2))
    if numbers.max(initial=0) < 2:
        return mask, 0.0
    areas = np.bincount(numbers.reshape(-1))[1:]
    second, first = np.sort(areas)[-2:]
    return numbers == 1 + int(np.argmax(areas)), float(second / first)


def fill_noise(mask: Bool[np.ndarray, "height width"]) -> tuple[Bool[np.ndarray, "height width"], int]:
    """Return a mask without holes that are too small to be real, and how many there were.

    A hole is joined by sides alone, and does not reach the mask's edge: what lies between the legs of a chair
    is no hole, or a large one, and stays.
    """
    numbers = np.asarray(label(~mask, connectivity=1))
    rim = np.concatenate([numbers[0], numbers[-1], numbers[:, 0], numbers[:, -1]])
    areas = np.bincount(numbers.reshape(-1))
    noise = areas <= max(1.0, HOLE * areas[0])
    noise[0] = noise[rim] = False  # the object itself, and what is around it
    if not noise.any():
        return mask, 0
    return mask | noise[numbers], int(noise.sum())
