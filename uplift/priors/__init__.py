"""Priors, one per file; `build_priors` makes those that a task names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import nn

from uplift.config.plugins import build, find_class
from uplift.config.settings import PRIOR_SETTINGS
from uplift.errors import NotForThisSkeleton, UserError
from uplift.priors.base import Prior, ShapePrior
from uplift.skeleton import Skeleton

__all__ = ["PRIORS", "Prior", "ShapePrior", "build_priors"]

PRIORS = {
    "bones": "uplift.priors.bones:Bones",
    "compactness": "uplift.priors.shape_grids:Compactness",
    "consistency": "uplift.priors.consistency:Consistency",
    "critic": "uplift.priors.critic:Critic",
    "fill": "uplift.priors.fill:Fill",
    "flow": "uplift.priors.flow:Flow",
    "handedness": "uplift.priors.handedness:Handedness",
    "labelled": "uplift.priors.labelled:Labelled",
    "mask": "uplift.priors.mask:Mask",
    "mask_critic": "uplift.priors.mask_critic:MaskCritic",
    "pairwise": "uplift.priors.pairwise:Pairwise",
    "shape_symmetry": "uplift.priors.shape_grids:ShapeSymmetry",
    "smoothness": "uplift.priors.shape_grids:Smoothness",
    "symmetry": "uplift.priors.symmetry:Symmetry",
}


def build_priors(
    specs: Mapping[str, Mapping[str, Any]], skeleton: Skeleton | None = None
) -> tuple[dict[str, Prior], dict[str, float], list[str]]:
    """Return the priors that ``specs`` names, their weights, and a note for each that was left out.

    Weight 0 leaves a prior out; so does ``if_possible: true`` where the skeleton lacks what the prior needs.

    Args:
        specs: for each prior ``use``, ``weight``, ``if_possible`` and the options of its class.
        skeleton: of the poses that are judged; None for priors of shapes.

    Raises:
        UserError: an unknown prior or option, an invalid weight, a class that is not a Prior or judges the other kind.
    """
    priors: dict[str, Prior] = {}
    weights: dict[str, float] = {}
    notes: list[str] = []
    for name, spec in specs.items():
        where = f"priors.{name}"
        if not name.isidentifier() or hasattr(nn.ModuleDict, name):
            raise UserError(f"{where}: '{name}' cannot be a prior's name. Choose another word: letters, digits and _.")
        options = dict(spec)
        use = str(options.pop("use", name))
        weight, if_possible = (options.pop(key, PRIOR_SETTINGS[key].default) for key in ("weight", "if_possible"))
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 <= weight < float("inf"):
            raise UserError(f"{where}.weight={weight!r}: expected {PRIOR_SETTINGS['weight'].accepts}.")
        if weight == 0:
            continue
        try:
            prior = _build(use, options, where, skeleton)
        except NotForThisSkeleton as error:
            if not if_possible:
                raise
            notes.append(f"without the {name} prior: {error}")
            continue
        priors[name], weights[name] = prior, float(weight)
    return priors, weights, notes


def _build(use: str, options: Mapping[str, Any], where: str, skeleton: Skeleton | None) -> Prior:
    wanted, source = ("shapes", "masks") if skeleton is None else ("poses", "keypoints")
    found = find_class(use, PRIORS, f"{where}.use")
    judges = getattr(found, "judges", wanted)
    if hasattr(found, "own_loss"):
        raise UserError(f"{where}: '{use}' has a method own_loss, which is now called critic_loss: rename it.")
    if judges != wanted:
        raise UserError(f"{where}: '{use}' judges {judges}, and this task lifts {source} to {wanted}.")
    if skeleton is None:
        prior = build(use, PRIORS, options, where, ShapePrior)
    else:
        prior = build(use, PRIORS, options, where, Prior, skeleton=skeleton)
    if "_parameters" not in vars(prior) or (skeleton is not None and not hasattr(prior, "skeleton")):
        call = "super().__init__()" if skeleton is None else "super().__init__(skeleton)"
        raise UserError(f"{where}: {type(prior).__name__}.__init__ must call {call} first.")
    return prior
