"""Masks as tensors on one device, cut out anew: centroid at 0, the same spread along x and along y."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from uplift.config.settings import ShapeSettings
from uplift.data.masks import MaskData
from uplift.data.samples import SHARED, Samples
from uplift.geometry.voxels import coverage

__all__ = ["SPREAD", "MaskSet", "as_tensor", "moments", "recrop", "to_mask_set"]

SPREAD = 0.4
"""Standard deviation of the pixels of a crop along x and along y, in half sides."""
_FAINT = 0.3
_LEAST = 0.03


def as_tensor(masks: np.ndarray) -> Float[Tensor, "items side side"]:
    """Return masks of 0..255 as 0..1."""
    return torch.from_numpy(masks).float() / 255


@dataclass(frozen=True)
class MaskSet(Samples):
    """Masks and, of labelled ones, which true shape is seen from which view of the grid."""

    crops: Float[Tensor, "items side side"]
    """The masks cut out anew."""
    spread: Float[Tensor, "items 2"]
    masks: UInt8[Tensor, "items pixels pixels"]
    """The masks as they are in the data, 0..255."""
    labelled: Bool[Tensor, " items"]
    view: Float[Tensor, "items 3 3"]
    """The true one; 0 where unlabelled."""
    scale: Float[Tensor, " items"]
    """True half sides of the crop per unit of the shape; 0 where unlabelled."""
    offset: Float[Tensor, "items 2"]
    """True place of the shape's origin; 0 where unlabelled."""
    shape: Int[Tensor, " items"]
    """Row of `shapes`; 0 where unlabelled."""
    shapes: Float[Tensor, "known depth height width"] = field(metadata=SHARED)
    """True occupancy of labelled shapes, on a grid of ``detail``."""


def to_mask_set(data: MaskData, settings: ShapeSettings, detail: int) -> MaskSet:
    """Return ``data`` as a lifter trains on it; true shapes are looked at for labelled items alone, at ``detail``."""
    crops, spreads = [], []
    for start in range(0, len(data), 1000):
        part = as_tensor(data.masks[start : start + 1000])
        centre, spread = moments(part)
        crops.append(recrop(part, centre, spread, settings.crop))
        spreads.append(spread)
    count = len(data)
    labelled = np.zeros(count, bool) if data.labelled is None or data.truth is None else data.labelled
    view, shape = torch.zeros(count, 3, 3), torch.zeros(count, dtype=torch.long)
    scale, offset = torch.zeros(count), torch.zeros(count, 2)
    shapes = torch.zeros(1, *(detail,) * 3)
    if labelled.any():
        rows = np.flatnonzero(labelled)
        used, which = np.unique(data.truth.shape[rows], return_inverse=True)  # type: ignore[union-attr]
        meshes = [data.truth.meshes[number] for number in used]  # type: ignore[union-attr]
        shapes = torch.from_numpy(np.stack([coverage(mesh, detail) for mesh in meshes])).float()
        view[rows] = torch.from_numpy(np.asarray(data.truth.view[rows], np.float32))  # type: ignore[union-attr]
        scale[rows] = torch.from_numpy(np.asarray(data.truth.scale[rows], np.float32))  # type: ignore[union-attr]
        offset[rows] = torch.from_numpy(np.asarray(data.truth.offset[rows], np.float32))  # type: ignore[union-attr]
        shape[rows] = torch.from_numpy(which)
    known = torch.from_numpy(labelled.copy())
    masks = torch.from_numpy(data.masks)
    return MaskSet(torch.cat(crops), torch.cat(spreads), masks, known, view, scale, offset, shape, shapes)


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
