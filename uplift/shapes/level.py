"""Where the surface of lifted shapes is: chosen so that their turned silhouettes cover as much as real masks do."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.shapes.crops import moments, recrop
from uplift.shapes.mixture import ShapeMixture

__all__ = ["choose_level"]

_LEVELS = (0.06, 0.08, 0.1, 0.12, 0.15, 0.18, 0.22, 0.26, 0.3, 0.35, 0.4, 0.45, 0.5)


@torch.no_grad()
def choose_level(mixture: ShapeMixture, occupancy: Float[Tensor, "items depth height width"], real: Tensor) -> float:
    """Return the level of occupancy at which silhouettes from new views cover the share of a crop that masks cover.

    ``occupancy`` are lifted shapes in their own frames and ``real`` masks, cut out (items side side).
    Only masks are looked at; a level that is too low gives swollen shapes, one too high thin ones.
    """
    small = torch.nn.functional.interpolate(occupancy[:, None], (mixture.settings.detail,) * 3, mode="trilinear")[:, 0]
    projector = mixture.projector
    assert projector is not None, "silhouettes were drawn before"
    # The longest side of a shape and its crop: a cut of the same spread makes sizes comparable.
    wanted = float((real > 0.5).float().mean())
    views = mixture.grid
    best, nearest = 0.2, float("inf")
    for level in _LEVELS:
        # A steep, almost opaque grid: what counts is whether a ray meets the inside.
        density = torch.sigmoid((small - level) * 60) * 20
        drawn = projector(density)[:, torch.randperm(len(views.views))[:6]].flatten(0, 1)
        centre, spread = moments(drawn)
        covered = float((recrop(drawn, centre, spread, mixture.settings.crop) > 0.5).float().mean())
        if abs(covered - wanted) < nearest:
            best, nearest = level, abs(covered - wanted)
    return best
