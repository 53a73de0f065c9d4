"""Choose masks by category, or a fraction of the shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from uplift.config import ChoiceSettings
from uplift.errors import UserError, did_you_mean
from uplift.masks.container import MaskData

__all__ = ["chosen_masks", "wanted_masks"]


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
