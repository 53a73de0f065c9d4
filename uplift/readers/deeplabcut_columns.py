"""What DeepLabCut's columns mean: a scorer, an individual, a body part and a coordinate each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uplift.data.container import PoseData
from uplift.errors import UserError, did_you_mean
from uplift.readers.table_rows import frame_numbers, rows_of

__all__ = ["LEVELS", "Layout", "layout_of", "pose_data"]

LEVELS = (("scorer", "bodyparts", "coords"), ("scorer", "individuals", "bodyparts", "coords"))
_LOCATION = {"x": 0, "y": 1, "likelihood": 2}
_VIDEO = re.compile(r"(.+?)(DLC_|DeepCut_).*")


@dataclass(frozen=True)
class Layout:
    """Where the numbers of each body part are."""

    bodyparts: tuple[str, ...]
    individuals: tuple[str, ...]
    columns: np.ndarray
    """The columns that hold them, in order."""
    places: np.ndarray
    """(individuals bodyparts 3) place in ``columns`` of x, y and likelihood; -1 where there is none."""
    notes: tuple[str, ...]


def layout_of(path: Path, columns: Sequence[tuple[str, ...]]) -> Layout:
    """Return what ``columns``, a tuple of `LEVELS` each, hold.

    Raises:
        UserError: several scorers, 3D, a coordinate twice, or x without y.
    """
    others = tuple(dict.fromkeys(c[-1] or c[0] for c in columns if c[-1] not in _LOCATION))
    columns = [column if len(column) == 4 else (column[0], "", *column[1:]) for column in columns]
    known = [column for column in columns if column[3] in _LOCATION]
    if any(column[3] == "z" for column in columns):
        raise UserError(f"{path} has x, y and z: 3D poses, no 2D keypoints; it can be no input of a lifter.")
    if not known:
        near = did_you_mean(others[0], _LOCATION) if others else ""
        raise UserError(f"{path}: no coords x and y in it (found {', '.join(others) or 'nothing'}).{near}")
    scorers = tuple(dict.fromkeys(column[0] for column in known))
    if len(scorers) > 1:
        raise UserError(f"{path}: columns of {len(scorers)} scorers ({', '.join(scorers[:4])}), expected one.")
    individuals = tuple(dict.fromkeys(column[1] for column in known))
    bodyparts = tuple(dict.fromkeys(column[2] for column in known))
    if not all(bodyparts):
        raise UserError(f"{path}: a column without the name of a body part.")
    who = {name: place for place, name in enumerate(individuals)}
    what = {name: place for place, name in enumerate(bodyparts)}
    places = np.full((len(who), len(what), 3), -1)
    for place, column in enumerate(columns):
        if column[3] in _LOCATION:
            at = who[column[1]], what[column[2]], _LOCATION[column[3]]
            if places[at] >= 0:
                raise UserError(f"{path}: '{column[2]}' has '{column[3]}' twice; body parts must differ.")
            places[at] = place
    half = (places[..., :2] >= 0).sum(-1) == 1
    if half.any():
        raise UserError(f"{path}: '{bodyparts[int(np.argwhere(half)[0, 1])]}' has x or y and not the other.")
    notes = (f"left out: {', '.join(others[:6])}{', ...' if len(others) > 6 else ''}",) if others else ()
    used = np.unique(places[places >= 0])
    places = np.where(places >= 0, np.searchsorted(used, places), -1)
    return Layout(bodyparts, individuals, used, places, notes)


def pose_data(
    path: Path, layout: Layout, numbers: np.ndarray, index: np.ndarray, lines: np.ndarray | None = None
) -> PoseData:
    """Return the rows of a table: the numbers of `Layout.columns`, and (rows,) frame numbers or names of images.

    Raises:
        UserError: no frame numbers, one twice, or numbers that are no keypoints.
    """
    values = _per_bodypart(layout, numbers)
    scores = values[..., 2] if (layout.places[..., 2] >= 0).any() else None
    if scores is not None and np.isnan(scores).all():  # a column that labels by hand have and do not fill
        scores = None
    if index.dtype.kind == "U":
        identity = {"image": index}
    else:
        video = _VIDEO.fullmatch(path.stem)
        frame = frame_numbers(path, index, lines, once=True)
        identity = {"sequence": np.full(len(frame), video[1] if video else path.stem), "frame": frame}
    bodies = layout.individuals if layout.individuals != ("",) else ()
    return rows_of(
        path, np.ascontiguousarray(values[..., :2]), scores, layout.bodyparts, identity, bodies, notes=layout.notes
    )


def _per_bodypart(layout: Layout, numbers: np.ndarray) -> np.ndarray:
    """Return (rows individuals bodyparts 3); NaN where there is no column."""
    if np.array_equal(layout.places.ravel(), np.arange(numbers.shape[1])):
        return numbers.reshape(-1, *layout.places.shape)
    if (layout.places >= 0).all():
        return numbers[:, layout.places]
    padded = np.concatenate([numbers, np.full((len(numbers), 1), np.nan, numbers.dtype)], 1)
    return padded[:, layout.places]
