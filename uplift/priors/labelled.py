"""The labelled term: distance of the lifted pose to the true one, where it is known."""

from __future__ import annotations

import torch
from torch import Tensor

from uplift.data.tensors import TrainingSet
from uplift.errors import UserError
from uplift.priors.base import Lift, Prior, joint_distance
from uplift.skeleton import Skeleton

__all__ = ["Labelled"]


class Labelled(Prior):
    """Mean joint distance to the labels (the semi-supervised term of Kudo et al. 2018, 5.2).

    Errors are in the labels' unit (mm where it is known), so that small and large bodies in the image count the
    same, divided by the average length of one unit of the model, so that the weight means the same for every
    skeleton. The mean is over the full batch, unlabelled frames counting as 0, so that a labelled frame weighs
    the same among few and among many.

    Args:
        skeleton: of the poses.
        elevation: weight of the camera's tilt, in radians, where it is labelled; 0 leaves it to the other priors.
    """

    usual_unit: Tensor

    def __init__(self, skeleton: Skeleton, *, elevation: float = 1.0):
        super().__init__(skeleton)
        self.elevation = elevation
        self.register_buffer("usual_unit", torch.ones(()))

    def prepare(self, data: TrainingSet) -> None:
        """Measure the average length of one unit in mm; reject data without labels."""
        if not bool(data.labelled.any()):
            raise UserError(_NO_LABELS)
        if data.label_unit is not None:
            self.usual_unit = data.label_unit[data.labelled].mean()

    def distances(self, lift: Lift) -> tuple[Tensor, Tensor]:
        """Return each joint's distance to its label in the label's unit (0 without), and whether it has one."""
        if lift.labels is None:
            raise UserError(_NO_LABELS)
        known = lift.labels.isfinite().all(-1)
        distance = joint_distance(lift.pose, lift.labels.nan_to_num())
        if lift.label_unit is not None:
            distance = distance * lift.label_unit.nan_to_num().unsqueeze(-1)
        return distance, known

    def loss(self, lift: Lift) -> Tensor:
        """Return each frame's mean over its labelled joints, and its tilt's error; 0 where it has no label."""
        distance, known = self.distances(lift)
        weight = known.to(distance.dtype)
        loss = (distance * weight).sum(1) / weight.sum(1).clamp_min(1) / self.usual_unit
        if self.elevation and lift.label_tilt is not None:
            has_tilt = lift.label_tilt.isfinite()
            loss = loss + self.elevation * (lift.tilt - lift.label_tilt.nan_to_num()).abs() * has_tilt
        return loss

    def metrics(self, lift: Lift) -> dict[str, float]:
        """Return the mean error of the labelled frames in the labels' unit, before any alignment."""
        distance, known = self.distances(lift)
        return {"labelled_error": float(Lift.mean(distance.detach(), known.to(distance.dtype)))}


_NO_LABELS = (
    "The labelled prior is on, but no frame is labelled: choose some (data.labelled.fraction=0.1), or set "
    "priors.labelled.weight=0."
)
