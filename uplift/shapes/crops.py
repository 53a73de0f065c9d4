"""Masks and silhouettes brought to the same place and size: centroid at 0, the same spread along x and along y."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["SPREAD", "moments", "recrop"]

SPREAD = 0.4
"""Standard deviation of the pixels of a crop along x and along y, in half sides."""
_FAINT = 0.3
_LEAST = 0.03


def moments(image: Float[Tensor, "items side side"]) -> tuple[Float[Tensor, "items 2"], Float[Tensor, "items 2"]]:
    """Return the centroids (x, y) of masks or silhouettes and their spreads along x and y, in half sides of the image.

    Faint pixels do not count, so that the haze of an unfinished shape moves nothing.
    """
    weight = (image - _FAINT).clamp_min(0) + 1e-6
    weight = weight / weight.sum((1, 2), keepdim=True)
    side = image.shape[-1]
    at = (2 * torch.arange(side, device=image.device, dtype=image.dtype) + 1) / side - 1
    columns, rows = weight.sum(1), weight.sum(2)
    centre = torch.stack([columns @ at, rows @ at], -1)
    spread = torch.stack([(columns * (at - centre[:, :1]) ** 2).sum(1), (rows * (at - centre[:, 1:]) ** 2).sum(1)], -1)
    return centre, spread.sqrt().clamp_min(_LEAST)


def recrop(
    image: Float[Tensor, "items side side"],
    centre: Float[Tensor, "items 2"],
    spread: Float[Tensor, "items 2"],
    side: int,
) -> Float[Tensor, "items new new"]:
    """Return images cut out anew: ``centre`` in the middle, ``spread`` brought to `SPREAD` along each axis."""
    at = (2 * torch.arange(side, device=image.device, dtype=image.dtype) + 1) / side - 1
    x = at * (spread[:, :1] / SPREAD) + centre[:, :1]
    y = at * (spread[:, 1:] / SPREAD) + centre[:, 1:]
    points = torch.stack([x[:, None, :].expand(-1, side, -1), y[:, :, None].expand(-1, -1, side)], -1)
    return torch.nn.functional.grid_sample(image[:, None], points, align_corners=False)[:, 0]
