"""`ShapePrior`, what it sees of a training step (`ShapeLift`), and those that a task of masks names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

from uplift.config.plugins import build
from uplift.errors import UserError

__all__ = ["SHAPE_PRIORS", "ShapeLift", "ShapePrior", "build_shape_priors"]

# What a prior of shapes sees of one training step: the shapes, their turned silhouettes, the masks.


@dataclass(frozen=True)
class ShapeLift:
    """A batch of masks and the shapes that explain them. `logits`, `occupancy` and `seen` carry gradients."""

    logits: Float[Tensor, "shapes depth height width"]
    """Of occupancy, in the shapes' own frame: indices run along z, y, x; y is down, the front is -z."""
    occupancy: Float[Tensor, "shapes depth height width"]
    """0..1."""
    seen: Float[Tensor, "turned side side"]
    """Silhouettes of the shapes from views drawn at random, cut out as masks are."""
    masks: Float[Tensor, "items side side"]
    """The real masks of this step, cut out the same way."""
    used: Float[Tensor, "shapes views"]
    """Share of all masks that each shape explains from each view; sums to 1; no gradient."""
    views: Float[Tensor, "views 3 3"]
    """From the own frame to the camera's."""
    done: float
    """Share of the stage that is over."""


# `ShapePrior`: a term of the objective that judges shapes or their turned silhouettes.


class ShapePrior(nn.Module):
    """Subclass this, write `loss`, and name your class in a task of masks: ``priors.ground.use=my.py:Ground``.

    The face of `uplift.priors.base.Prior`, for shapes: options are keyword arguments of ``__init__`` with
    defaults; trainable parameters are trained with the shapes.
    """

    def loss(self, lift: ShapeLift) -> Float[Tensor, ""]:
        """Return the penalty, one number; lower is better."""
        raise NotImplementedError(f"{type(self).__name__} has no loss(self, lift)")

    def own_loss(
        self, real: Float[Tensor, "items side side"], seen: Float[Tensor, "turned side side"]
    ) -> Float[Tensor, ""] | None:
        """Return what the prior's own parameters are trained on, or None; ``seen`` is detached.

        The parameters of a prior with an `own_loss` are held still while `loss` trains the shapes.
        """
        return None


# Priors of shapes: `build_shape_priors` makes those that a task of masks names.

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
