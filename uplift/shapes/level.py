"""Where the surface of lifted shapes is: the level that is expected to overlap best with the shapes as believed."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

__all__ = ["choose_level"]

_LEVELS = (0.04, 0.06, 0.08, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2, 0.23, 0.26, 0.3, 0.35, 0.4, 0.5)


def choose_level(occupancy: Float[Tensor, "items depth height width"]) -> float:
    """Return the level of occupancy above which voxels should count as inside.

    If occupancy is the chance that a voxel is full, what a level keeps can be expected to overlap with the
    shape by kept chance over (kept voxels + all chance - kept chance), the expected intersection over
    union. The level with the largest mean is chosen: no true shape is looked at. It lies below 0.5 wherever
    shapes are unsure (Lipton et al. 2014 have the same for F1).
    """
    flat = occupancy.flatten(1)
    all_of_it = flat.sum(1)
    expected = []
    for level in _LEVELS:
        kept = flat > level
        chance = (flat * kept).sum(1)
        expected.append(float((chance / (kept.sum(1) + all_of_it - chance).clamp_min(1e-9)).mean()))
    return _LEVELS[max(range(len(_LEVELS)), key=expected.__getitem__)]
