"""`ShapePrior`: a term of the objective that judges shapes or their turned silhouettes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxtyping import Float
from torch import Tensor, nn

if TYPE_CHECKING:
    from uplift.shapes.lift import ShapeLift

__all__ = ["ShapePrior"]


class ShapePrior(nn.Module):
    """Subclass this, write `loss`, and name your class in a task of masks: ``priors.ground.use=my.py:Ground``.

    The face of `uplift.priors.Prior`, for shapes: options are keyword arguments of ``__init__`` with
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
