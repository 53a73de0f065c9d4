"""Priors on occupancy grids: smoothness, compactness and symmetry."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from uplift.priors.base import ShapeLift, ShapePrior

__all__ = ["Compactness", "ShapeSymmetry", "Smoothness"]


class Smoothness(ShapePrior):
    """The total variation of occupancy, as a mean over voxels."""

    def loss(self, lift: ShapeLift) -> Float[Tensor, ""]:
        """Return the mean absolute difference of neighbours along the three axes."""
        return sum((lift.occupancy.diff(dim=axis).abs().mean() for axis in (1, 2, 3)), lift.occupancy.new_zeros(()))


class Compactness(ShapePrior):
    """Penalises voxels that are neither full nor empty, more so towards the end of a stage, as shapes begin as haze."""

    def loss(self, lift: ShapeLift) -> Float[Tensor, ""]:
        """Return the mean of occupancy times emptiness, times the share of the stage that is over."""
        return (lift.occupancy * (1 - lift.occupancy)).mean() * lift.done


class ShapeSymmetry(ShapePrior):
    """Left is like right, for shapes that `shape.symmetric=false` leaves free."""

    def loss(self, lift: ShapeLift) -> Float[Tensor, ""]:
        """Return the mean squared difference of occupancy and its mirror image."""
        return (lift.occupancy - lift.occupancy.flip(-1)).square().mean()
