"""Where the joints of a skeleton are on a standing human, for what is known of humans alone: their size, and which end is up."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from uplift.skeleton import Skeleton, load_skeleton

__all__ = ["standing_human"]

_USUAL = "coco17"
_FEWEST = 12
"""Joints with COCO's names that make a skeleton a human one."""


def standing_human(skeleton: Skeleton) -> Float[np.ndarray, "joints 3"]:
    """Return the joints of a standing human, x right, y down, in body heights; NaN for those that are not known as such."""
    from uplift.data.synthetic.body import is_human
    from uplift.data.synthetic.simulate import rest_pose

    if is_human(skeleton):
        return rest_pose(skeleton)
    usual = load_skeleton(_USUAL)
    known = dict(zip(usual.joints, rest_pose(usual), strict=True))
    places = np.array([known.get(joint, np.full(3, np.nan)) for joint in skeleton.joints])
    return places if np.isfinite(places).all(1).sum() >= _FEWEST else np.full_like(places, np.nan)
