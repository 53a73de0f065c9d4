"""Priors of shapes: `build_shape_priors` makes those that a task of masks names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import nn

from uplift.errors import UserError
from uplift.plugins import build
from uplift.priors.shape_base import ShapePrior

__all__ = ["SHAPE_PRIORS", "build_shape_priors"]

SHAPE_PRIORS = {
    "compactness": "uplift.priors.shape_grids:Compactness",
    "mask_critic": "uplift.priors.mask_critic:MaskCritic",
    "shape_symmetry": "uplift.priors.shape_grids:ShapeSymmetry",
    "smoothness": "uplift.priors.shape_grids:Smoothness",
}


def build_shape_priors(specs: Mapping[str, Mapping[str, Any]]) -> tuple[dict[str, ShapePrior], dict[str, float]]:
    """Return the priors that ``specs`` names, and their weights; weight 0 leaves one out.

    Raises:
        UserError: an unknown prior or option, a weight that is no number, a class that is no ShapePrior.
    """
    priors: dict[str, ShapePrior] = {}
    weights: dict[str, float] = {}
    for name, spec in specs.items():
        where = f"priors.{name}"
        if not name.isidentifier() or hasattr(nn.ModuleDict, name):
            raise UserError(f"{where}: '{name}' cannot be a prior's name. Choose another word: letters, digits and _.")
        options = dict(spec)
        use, weight = str(options.pop("use", name)), options.pop("weight", 1.0)
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 <= weight < float("inf"):
            raise UserError(f"{where}.weight={weight!r}: expected a number of at least 0.")
        if weight > 0:
            prior = build(use, SHAPE_PRIORS, options, where, ShapePrior)
            if "_parameters" not in vars(prior):
                raise UserError(f"{where}: {type(prior).__name__}.__init__ must call super().__init__() first.")
            priors[name] = prior
            weights[name] = float(weight)
    return priors, weights
