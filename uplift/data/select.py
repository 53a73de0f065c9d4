"""Choose frames or masks: by subject, action, sequence, camera or category, or a fraction of the clips or shapes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Int, Shaped

from uplift.config.settings import ChoiceSettings
from uplift.data.masks import MaskData
from uplift.data.names import codes_of
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean

__all__ = ["choice_of", "chosen_clips", "chosen_rows", "chosen_shapes", "chosen_windows"]

_CHOOSE_BY = {
    "subjects": "subject", "actions": "action", "sequences": "sequence", "cameras": "camera", "categories": "category",
}  # fmt: skip
"""What rows are chosen by, and the column it is compared with."""

Choice = Mapping[str, Sequence[str] | float | bool | None]


def choice_of(settings: ChoiceSettings) -> Choice:
    """Return what is set of ``settings``: the values of each column to choose, and a fraction."""
    found = {name: getattr(settings, name) for name in (*_CHOOSE_BY, "fraction", "of_each_clip")}
    return {name: value for name, value in found.items() if value not in (None, [], False)}


def chosen_rows(data: PoseData | MaskData, choice: Choice, seed: int = 0) -> Bool[np.ndarray, " rows"]:
    """Return which frames or masks ``choice`` names.

    ``choice`` maps any of subjects, actions, sequences, cameras (of frames), categories (of masks) to the
    values wanted, compared as text; all given columns must hold. Its ``fraction`` is the share to take of the
    rows that are left: see `chosen_clips` and `chosen_shapes`, or `chosen_windows` with ``of_each_clip``. The same
    data and seed always give the same rows, and a larger fraction contains a smaller one.

    Raises UserError: the file has no such column, no row has such a value, a fraction that leaves none.
    """
    where = data.source or "the data"
    chosen = np.ones(len(data), bool)
    for name, key in _CHOOSE_BY.items():
        values = choice.get(name)
        if values:
            chosen &= _with_values(data, key, [str(value) for value in values], where)  # type: ignore[union-attr]
    fraction, each = choice.get("fraction"), bool(choice.get("of_each_clip"))
    if each and fraction is None:
        raise UserError("of_each_clip=true needs a fraction: how much of each clip?")
    if fraction is not None and fraction != 1 and chosen.any():
        rows = np.flatnonzero(chosen)
        try:
            chosen[rows] = _share(data, rows, float(fraction), seed, each)  # type: ignore[arg-type]
        except UserError as error:
            raise UserError(f"{where}: {error}") from None
    if not chosen.any():
        shown = ", ".join(f"{key}={value}" for key, value in choice.items())
        raise UserError(f"{where}: no {_row(data)} is left after choosing {shown}.")
    return chosen


def _row(data: PoseData | MaskData) -> str:
    return "mask" if isinstance(data, MaskData) else "frame"


def _with_values(data: PoseData | MaskData, key: str, wanted: list[str], where: str) -> Bool[np.ndarray, " rows"]:
    """Return which rows have one of the ``wanted`` values; the case of categories does not count."""
    column = data.category if isinstance(data, MaskData) else data.identity.get(key)
    if column is None:
        keys = None if isinstance(data, MaskData) else ", ".join(sorted(data.identity)) or "none"
        hint = f"identity keys: {keys}" if keys else "categories are sub-folders, or names in COCO's JSON"
        raise UserError(f"{where}: cannot choose by {key}: the file has no '{key}' ({hint}).")
    fold = str.casefold if isinstance(data, MaskData) else str
    names, code = codes_of(column)
    known = [fold(str(name)) for name in names]
    for value in wanted:
        if fold(value) not in known:
            raise UserError(f"{where}: no {_row(data)} with {key} '{value}'.{did_you_mean(value, map(str, names))}")
    return np.isin(known, [fold(value) for value in wanted])[code]


def _share(
    data: PoseData | MaskData, rows: np.ndarray, fraction: float, seed: int, each: bool
) -> Bool[np.ndarray, " rows"]:
    if isinstance(data, PoseData) and each:
        return chosen_windows(
            data.clips()[rows], data.identity.get("frame", np.arange(len(data)))[rows], fraction, seed
        )
    if isinstance(data, PoseData):
        return chosen_clips(data.clips()[rows], fraction, seed)
    shape = np.arange(len(data)) if data.truth is None else data.truth.shape
    return chosen_shapes(shape[rows], fraction, seed)


def chosen_clips(clip: Shaped[np.ndarray, " frames"], fraction: float, seed: int) -> Bool[np.ndarray, " frames"]:
    """Return a ``fraction`` of the frames: complete clips in seeded order, the last cut to reach it.

    Raises UserError: a fraction outside (0, 1], or one that leaves no frame.
    """
    count = _count(fraction, len(clip), "frame")
    names, code = np.unique(clip, return_inverse=True)
    rank = np.random.default_rng(seed).permutation(len(names))[code]
    mask = np.zeros(len(clip), bool)
    mask[np.argsort(rank, kind="stable")[:count]] = True
    return mask


def chosen_windows(
    clip: Shaped[np.ndarray, " frames"], frame: Shaped[np.ndarray, " frames"], fraction: float, seed: int
) -> Bool[np.ndarray, " frames"]:
    """Return a ``fraction`` of every clip, frames in a row, whose place is drawn from the clip's length and the seed.

    So the cameras of one take share their frames. With seed 0 they are those of VideoPose3D's ``--subset``, which
    hashes the length of a video too (Pavllo et al. 2019, github.com/facebookresearch/VideoPose3D).

    Raises UserError: a fraction outside (0, 1], or one that leaves no frame of any clip.
    """
    _count(fraction, len(clip), "frame")
    mask = np.zeros(len(clip), bool)
    order = np.lexsort((frame, clip))
    for rows in np.split(order, np.flatnonzero(np.diff(clip[order])) + 1):
        count = round(fraction * len(rows))
        key = f"{len(rows)}" if seed == 0 else f"{len(rows)} {seed}"
        place = int.from_bytes(hashlib.sha256(key.encode()).digest()[:4], "little") / (2**32 - 1)
        start = min(int(place * (len(rows) - count + 1)), len(rows) - count)
        mask[rows[start : start + count]] = True
    if not mask.any():
        raise UserError(f"a fraction of {fraction} is less than half a frame of every clip.")
    return mask


def chosen_shapes(shape: Int[np.ndarray, " masks"], fraction: float, seed: int) -> Bool[np.ndarray, " masks"]:
    """Return the masks of a ``fraction`` of the shapes: all masks of a shape or none.

    Raises UserError: a fraction outside (0, 1], or one that leaves no shape.
    """
    shapes = np.unique(shape)
    count = _count(fraction, len(shapes), "shape")
    return np.isin(shape, np.random.default_rng(seed).permutation(shapes)[:count])


def _count(fraction: float, total: int, item: str) -> int:
    """Return how many ``fraction`` of ``total`` are; raises UserError for less than one."""
    if not 0 < fraction <= 1:
        raise UserError(f"a fraction of {fraction} was asked for, expected more than 0 and at most 1.")
    count = round(fraction * total)
    if count == 0:
        raise UserError(f"a fraction of {fraction} of {total:,} {item}s is less than one {item}.")
    return count
