"""Choose frames or masks: by subject, action, sequence, camera or category, or a fraction of the clips or shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from uplift.config.settings import ChoiceSettings
from uplift.data.masks import MaskData
from uplift.data.poses import PoseData
from uplift.errors import UserError, did_you_mean

__all__ = ["CHOOSE_BY", "chosen_clips", "chosen_masks", "chosen_rows", "wanted_masks"]

# Choose frames by subject, action, sequence, camera, or a fraction of the clips.

CHOOSE_BY = {"subjects": "subject", "actions": "action", "sequences": "sequence", "cameras": "camera"}
"""What frames are chosen by, and the identity it is compared with."""


def chosen_rows(data: PoseData, choice: Mapping[str, Sequence[str] | float | None], seed: int = 0) -> np.ndarray:
    """Return a (frames,) mask of the frames that ``choice`` names.

    ``choice`` maps any of subjects, actions, sequences, cameras to the values wanted (compared as
    text; all given keys must hold), and ``fraction`` to a share of the frames that are left,
    taken as whole clips in seeded order.

    Raises:
        UserError: the file has no such key, or no frame has such a value.
    """
    where = data.source or "the data"
    mask = np.ones(len(data), bool)
    for name, key in CHOOSE_BY.items():
        wanted = choice.get(name)
        if not wanted:
            continue
        if key not in data.identity:
            have = ", ".join(sorted(data.identity)) or "none"
            raise UserError(f"{where}: cannot choose by {key}: the file has no '{key}' (identity keys: {have}).")
        values = data.identity[key].astype(str)
        for value in wanted:  # type: ignore[union-attr]
            if not (values == str(value)).any():
                raise UserError(f"{where}: no frame with {key} '{value}'.{did_you_mean(str(value), np.unique(values))}")
        mask &= np.isin(values, [str(value) for value in wanted])  # type: ignore[union-attr]
    fraction = choice.get("fraction")
    if fraction is not None and fraction != 1:
        rows = np.flatnonzero(mask)
        mask[:] = False
        try:
            mask[rows[chosen_clips(data.clips()[rows], float(fraction), seed)]] = True  # type: ignore[arg-type]
        except UserError as error:
            raise UserError(f"{where}: {error}") from None
    if not mask.any():
        shown = ", ".join(f"{key}={value}" for key, value in choice.items())
        raise UserError(f"{where}: no frame is left after choosing {shown}.")
    return mask


def chosen_clips(clip: np.ndarray, fraction: float, seed: int) -> np.ndarray:
    """Return a (frames,) mask of whole clips in seeded order, the last cut to reach ``fraction``.

    The same clips and seed always give the same mask, and a larger fraction contains a smaller
    one.

    Raises:
        UserError: a fraction outside (0, 1], or one that leaves no frame.
    """
    if not 0 < fraction <= 1:
        raise UserError(f"A fraction of {fraction} was asked for, expected more than 0 and at most 1.")
    wanted = round(fraction * len(clip))
    if wanted == 0:
        raise UserError(f"A fraction of {fraction} of {len(clip):,} frames is less than one frame.")
    names, code = np.unique(clip, return_inverse=True)
    rank = np.random.default_rng(seed).permutation(len(names))[code]
    order = np.argsort(rank, kind="stable")
    mask = np.zeros(len(clip), bool)
    mask[order[:wanted]] = True
    return mask


# Choose masks by category, or a fraction of the shapes.


def wanted_masks(choice: ChoiceSettings) -> dict[str, Sequence[str] | float]:
    """Return those of ``categories`` and ``fraction`` that are set."""
    found: dict[str, Sequence[str] | float] = {"categories": choice.categories} if choice.categories else {}
    return found if choice.fraction is None else {**found, "fraction": choice.fraction}


def chosen_masks(
    data: MaskData, choice: Mapping[str, Sequence[str] | float], seed: int = 0
) -> Bool[np.ndarray, " items"]:
    """Return which masks ``choice`` names: those of its ``categories``, and of these a ``fraction`` of the shapes.

    All masks of a shape are taken or none; where shapes are not known, each mask counts as one. The same
    data and seed always give the same, and a larger fraction contains a smaller one.

    Raises:
        UserError: no such category, a fraction outside (0, 1] or of less than one shape.
    """
    where = data.source or "the masks"
    rows = np.ones(len(data), bool)
    categories = choice.get("categories")
    if categories:
        if data.category is None:
            raise UserError(
                f"{where}: cannot choose by category: the masks have none (sub-folders, or names in COCO's JSON)."
            )
        known = {str(name).casefold(): str(name) for name in np.unique(data.category)}
        for name in categories:  # type: ignore[union-attr]
            if str(name).casefold() not in known:
                raise UserError(f"{where}: no mask of category '{name}'.{did_you_mean(str(name), known.values())}")
        taken = [known[str(name).casefold()] for name in categories]  # type: ignore[union-attr]
        rows = np.isin(data.category.astype(str), taken)
    fraction = choice.get("fraction")
    return rows if fraction is None else _share(data, rows, float(fraction), seed, where)  # type: ignore[arg-type]


def _share(data: MaskData, rows: np.ndarray, fraction: float, seed: int, where: str) -> np.ndarray:
    if not 0 < fraction <= 1:
        raise UserError(f"{where}: a fraction of {fraction} was asked for, expected more than 0 and at most 1.")
    shape = np.arange(len(data)) if data.truth is None else data.truth.shape
    shapes = np.unique(shape[rows])
    count = round(fraction * len(shapes))
    if count == 0:
        raise UserError(f"{where}: a fraction of {fraction} of {len(shapes):,} shapes is less than one.")
    return rows & np.isin(shape, np.random.default_rng(seed).permutation(shapes)[:count])
