"""`Prior`: a term of the objective that judges lifted poses or their turned views."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxtyping import Float
from torch import Tensor, nn

from uplift.skeleton import Skeleton

if TYPE_CHECKING:
    from uplift.data.tensors import TrainingSet
    from uplift.lift import Lift

__all__ = ["Prior"]


class Prior(nn.Module):
    """Subclass this, write `loss`, and name your class in a task: ``priors.ground.use=my.py:FlatGround``.

    Options of your own are keyword arguments of ``__init__`` with defaults; they are set beside
    ``use`` and ``weight``. Trainable parameters are ordinary ``nn.Parameter`` and are trained with
    the lifter.
    """

    gate_itself: bool = False
    """Set by a prior that trains itself: its own parameters stay as they are in this step."""
    gate_lifter: bool = False
    """Set by a prior that trains itself: the lifter stays as it is in this step."""

    def __init__(self, skeleton: Skeleton):
        super().__init__()
        self.skeleton = skeleton

    def prepare(self, data: TrainingSet) -> None:
        """Look at the training data (2D only) once, before the first step: fit a flow, measure ratios."""

    def loss(self, lift: Lift) -> Float[Tensor, " batch"] | Float[Tensor, ""]:
        """Return the penalty, a number for each frame or one for all; lower is better."""
        raise NotImplementedError(f"{type(self).__name__} has no loss(self, lift)")

    def own_loss(
        self, real: Float[Tensor, "batch joints 2"], seen: Float[Tensor, "batch joints 2"]
    ) -> Float[Tensor, ""] | None:
        """Return what the prior's own parameters are trained on, or None.

        ``real`` are keypoints of the data and ``seen`` the turned views, detached; joints missing in
        the data are 0 in both. A prior with an `own_loss` is adversarial: its parameters are held
        still while `loss` trains the lifter.
        """
        return None

    def metrics(self, lift: Lift) -> dict[str, float]:
        """Return numbers worth logging, by name."""
        return {}
