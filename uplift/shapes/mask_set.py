"""`MaskSet`: the masks of a training set as tensors, cut out as silhouettes are."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from uplift.config import ShapeSettings
from uplift.masks.container import MaskData
from uplift.meshes.voxels import coverage
from uplift.shapes.crops import moments, recrop

__all__ = ["MaskSet", "as_tensor", "mask_set"]


def as_tensor(masks: np.ndarray) -> Float[Tensor, "items side side"]:
    """Return masks of 0..255 as 0..1."""
    return torch.from_numpy(masks).float() / 255


@dataclass(frozen=True)
class MaskSet:
    """Masks and, of labelled ones, which true shape is seen from which view of the grid."""

    crops: Float[Tensor, "items side side"]
    spread: Float[Tensor, "items 2"]
    labelled: Bool[Tensor, " items"]
    view: Float[Tensor, "items 3 3"]
    """The true one; 0 where unlabelled."""
    shape: Int[Tensor, " items"]
    """Row of `shapes`; 0 where unlabelled."""
    shapes: Float[Tensor, "known depth height width"]
    """True occupancy of labelled shapes, at the mixture's detail."""

    def __len__(self) -> int:
        return len(self.crops)

    def to(self, device: Any) -> MaskSet:
        """Return the set on another device."""
        return MaskSet(*(getattr(self, part.name).to(device) for part in fields(self)))


def mask_set(data: MaskData, settings: ShapeSettings) -> MaskSet:
    """Return ``data`` as a mixture trains on it; true shapes are looked at for labelled items alone."""
    crops, spreads = [], []
    for start in range(0, len(data), 1000):
        part = as_tensor(data.masks[start : start + 1000])
        centre, spread = moments(part)
        crops.append(recrop(part, centre, spread, settings.crop))
        spreads.append(spread)
    count = len(data)
    labelled = np.zeros(count, bool) if data.labelled is None or data.truth is None else data.labelled
    view, shape = torch.zeros(count, 3, 3), torch.zeros(count, dtype=torch.long)
    shapes = torch.zeros(1, *(settings.detail,) * 3)
    if labelled.any():
        rows = np.flatnonzero(labelled)
        used, which = np.unique(data.truth.shape[rows], return_inverse=True)  # type: ignore[union-attr]
        meshes = [data.truth.meshes[number] for number in used]  # type: ignore[union-attr]
        shapes = torch.from_numpy(np.stack([coverage(mesh, settings.detail) for mesh in meshes])).float()
        view[rows] = torch.from_numpy(np.asarray(data.truth.view[rows], np.float32))  # type: ignore[union-attr]
        shape[rows] = torch.from_numpy(which)
    return MaskSet(torch.cat(crops), torch.cat(spreads), torch.from_numpy(labelled.copy()), view, shape, shapes)
