"""Small mixtures of shapes: simulated chairs instead of learned shapes."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uplift.config.settings import ShapeSettings
from uplift.data.mask_tensors import as_tensor, moments, recrop
from uplift.data.masks import MaskData
from uplift.data.synthetic.masks import ViewChoice, make_shapes, simulate_masks
from uplift.geometry.mesh import Mesh
from uplift.geometry.voxels import coverage
from uplift.models.mixture import ShapeMixture

__all__ = ["SMALL", "chair", "crops_of", "masks_of", "mixture_of", "small"]

SMALL: dict[str, Any] = {"coarse": 12, "crop": 16, "parts": 2, "elevation_deg": (20.0, 1.0)}


def small(**more: Any) -> ShapeSettings:
    """Return small settings with a single elevation."""
    return ShapeSettings(**{**SMALL, **more})


@lru_cache
def chair(seed: int = 0) -> Mesh:
    """Return a simulated chair."""
    return make_shapes("chairs", 1, seed)[0]


def masks_of(mesh: Mesh, items: int, seed: int = 0, side: int = 48) -> MaskData:
    """Return masks of one shape from all azimuths, at about the elevation of `small`."""
    views = ViewChoice(elevation_mean_deg=20, elevation_sd_deg=4)
    return simulate_masks([mesh], items, seed=seed, side=side, views=views)


@lru_cache
def _covered(mesh_seed: int, detail: int) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(coverage(chair(mesh_seed), detail)))


def mixture_of(seeds: tuple[int, ...], settings: ShapeSettings) -> ShapeMixture:
    """Return a mixture whose shapes are the chairs of these seeds."""
    torch.manual_seed(0)
    mixture = ShapeMixture(settings)
    for part, seed in enumerate(seeds):
        logits = (_covered(seed, settings.coarse) - 0.5) * 10
        half = mixture.logits.shape[-1]
        mixture.logits.data[part] = logits.clamp(-6, 2)[..., -half:]
    return mixture.eval()


def crops_of(data: MaskData, mixture: ShapeMixture) -> tuple[Tensor, Tensor]:
    """Return masks cropped for the mixture, and their spreads."""
    masks = as_tensor(data.masks)
    centre, spread = moments(masks)
    return recrop(masks, centre, spread, mixture.settings.crop), spread
