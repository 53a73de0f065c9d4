"""How far points of an image are from a body's mask: a signed distance that has a slope wherever a point is."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, grid_sample

__all__ = ["MOST", "into_crop", "sample_field", "signed_distances", "unit_of"]

MOST = 64
"""Pixels along a field: finer masks are averaged down."""
_CHUNK = 1024
_EMPTY = 2.0


def signed_distances(masks: UInt8[Tensor, "frames side side"]) -> Float[Tensor, "frames side side"]:
    """Return the distance of each pixel to the edge of the mask, above 0 outside and below it inside; half a crop is 1.

    What lies beyond the crop is outside. Half precision, of exact Euclidean distances.
    """
    from scipy.ndimage import distance_transform_edt

    side = min(masks.shape[1], MOST)
    found = torch.empty((len(masks), side, side), dtype=torch.float16)
    for start in range(0, len(masks), _CHUNK):
        some = masks[start : start + _CHUNK].float().cpu()
        if some.shape[1] > side:
            some = adaptive_avg_pool2d(some.unsqueeze(1), side).squeeze(1)
        for place, inside in enumerate(some.numpy() > 127):
            if not inside.any():
                found[start + place] = _EMPTY
                continue
            framed = np.pad(inside, 1)
            out = distance_transform_edt(~framed)[1:-1, 1:-1]  # type: ignore[index]
            within = distance_transform_edt(framed)[1:-1, 1:-1]  # type: ignore[index]
            # The edge is half a pixel from the centres on either side of it.
            signed = np.where(inside, 0.5 - within, out - 0.5) * (2 / side)
            found[start + place] = torch.from_numpy(signed.astype(np.float16))
    return found.to(masks.device)


def into_crop(
    points: Float[Tensor, "frames points 2"], mask_map: Float[Tensor, "frames 3 3"]
) -> Float[Tensor, "frames points 2"]:
    """Return where points are in their frame's crop, -1 to 1 over it (`uplift.data.body_masks.mask_maps`)."""
    mapped = torch.baddbmm(mask_map[:, None, :, 2], points, mask_map[..., :2].mT)
    return mapped[..., :2] / mapped[..., 2:].clamp_min(1e-6)


def sample_field(
    field: Float[Tensor, "frames side side"], points: Float[Tensor, "frames points 2"]
) -> Float[Tensor, "frames points"]:
    """Return the signed distance at points of the crop, between pixels by interpolation, outside the crop by the way to it."""
    edge = 1 - 1 / field.shape[1]  # the outermost pixels' centres
    within = points.clamp(-edge, edge)
    beyond = ((points - within).square().sum(-1) + 1e-12).sqrt() - 1e-6
    value = grid_sample(field.unsqueeze(1).to(points.dtype), within.unsqueeze(2), align_corners=False)
    return value[:, 0, :, 0] + beyond


def unit_of(mask_map: Float[Tensor, "frames 3 3"]) -> Float[Tensor, " frames"]:
    """Return how long half a crop is in the units of the keypoints, at the root."""
    last = mask_map[:, 2, 2, None, None]
    way = mask_map[:, :2, :2] / last - mask_map[:, :2, 2:] / last**2 * mask_map[:, 2:, :2]
    return torch.linalg.det(way).abs().clamp_min(1e-12).rsqrt()
