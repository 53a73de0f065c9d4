"""What a prior of shapes sees of one training step: the shapes, their turned silhouettes, the masks."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

__all__ = ["ShapeLift"]


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
