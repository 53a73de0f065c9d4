"""Segmentations as COCO's JSON holds them: what is kept of each annotation, and its mask."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uplift.masks.polygon import window_of_polygons
from uplift.masks.rle import window_of_runs

__all__ = ["SLACK_PX", "Outline", "RecordError", "outline_of", "window_of"]

SLACK_PX = 2.0
"""Outlines by hand that stop as near as that to the border of the image go on beyond it."""
_FARTHEST_PX = 1e7


class RecordError(Exception):
    """Why an annotation cannot be used: a key of `uplift.masks.report.REASONS`."""


@dataclass(frozen=True)
class Outline:
    """A segmentation, small enough to keep many of."""

    polygons: tuple[np.ndarray, ...] = ()
    """(corners 2) px each."""
    counts: Any = None
    """Run lengths, as a list or as text."""
    size: Any = None
    """[height, width] of the run lengths."""


def outline_of(record: dict[str, Any]) -> Outline:
    """Return an annotation's segmentation.

    Raises:
        RecordError: a crowd, of low score, or without a segmentation that is one.
    """
    if record.get("iscrowd") in (1, True):
        raise RecordError("crowd")
    score = record.get("score")
    if isinstance(score, int | float) and not score >= 0.5:
        raise RecordError("score")
    found = record.get("segmentation")
    if not found:
        raise RecordError("no_outline")
    if isinstance(found, dict):
        counts, size = found.get("counts"), found.get("size")
        if not isinstance(counts, str | list):
            raise RecordError("damaged")
        return Outline(counts=counts, size=size)
    if isinstance(found, list) and not isinstance(found[0], list):
        found = [found]  # one polygon without its list, as some tools write it
    if not isinstance(found, list):
        raise RecordError("damaged")
    return Outline(polygons=tuple(_polygon(one) for one in found))


def _polygon(numbers: Any) -> np.ndarray:
    if not isinstance(numbers, list) or len(numbers) < 6 or len(numbers) % 2:
        raise RecordError("damaged")
    if not all(type(one) in (int, float) and abs(one) < _FARTHEST_PX for one in numbers):
        raise RecordError("damaged")
    return np.array(numbers, np.float32).reshape(-1, 2)


def window_of(
    outline: Outline, image_size: tuple[int, int] | None
) -> tuple[np.ndarray, tuple[int, int], tuple[int, int] | None]:
    """Return a segmentation's mask in a window, the window's corner (x, y) and the size of the image, px.

    Raises:
        RecordError: nothing covered, damaged, or too large.
    """
    try:
        if outline.polygons:
            found = window_of_polygons([one.astype(np.float64) for one in outline.polygons], image_size)
            if found is not None:
                return *found, image_size
        else:
            runs = window_of_runs(outline.counts, outline.size)
            if runs is not None:
                return runs
    except OverflowError:
        raise RecordError("huge") from None
    except ValueError:
        raise RecordError("damaged") from None
    raise RecordError("empty")
