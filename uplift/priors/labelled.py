"""The labelled term: distance of the lifted pose to the true one, where there is one."""

from __future__ import annotations

from torch import Tensor

from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.lift import Lift
from uplift.priors.base import Prior

__all__ = ["Labelled"]


class Labelled(Prior):
    """Mean joint distance to the labels, in units of the mean 2D radius (the semi-supervised term of 5.2)."""

    def prepare(self, data: TrainingSet) -> None:
        """Refuse data without labels."""
        if data.labels is None:
            raise UserError("The labelled prior is on, but no frame is labelled: set priors.labelled.weight=0.")

    def loss(self, lift: Lift) -> Tensor:
        """Return the mean over the joints of the labelled frames in the batch."""
        if lift.labels is None:
            raise UserError("The labelled prior is on, but no frame is labelled: set priors.labelled.weight=0.")
        known = lift.labels.isfinite().all(-1)
        difference = lift.pose - lift.labels.nan_to_num()
        distance = (difference.square().sum(-1) + 1e-12).sqrt()
        return Lift.mean(distance, known.to(distance.dtype))
