"""Which side of shapes is the front: masks alone leave it open, a few labels or an angle fix it."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from uplift.config.settings import ShapeSettings
from uplift.errors import UserError
from uplift.geometry.rotation import about_x, about_y, nearest_rotation

__all__ = ["front_at", "front_of_views", "turned_grids"]

_HALF_TURN = 180


def front_at(degrees: int | float, settings: ShapeSettings) -> Float[Tensor, "3 3"]:
    """Return the rotation after which the side of shapes that was seen at azimuth ``degrees`` is their front.

    Raises UserError for an angle at which shapes that are their own mirror image would not be that any more.
    """
    if not math.isfinite(degrees) or (settings.symmetric and degrees % _HALF_TURN):
        raise UserError(
            f"front={degrees:g}: shapes of this lifter are their own mirror image, left and right: expected 0 or 180, "
            "which swaps front and back."
            if math.isfinite(degrees)
            else f"front={degrees}: expected degrees."
        )
    return _exact(about_y(torch.tensor([math.radians(degrees)], dtype=torch.float64))[0])


def front_of_views(
    found: Float[Tensor, "items 3 3"], known: Float[Tensor, "items 3 3"], settings: ShapeSettings
) -> Float[Tensor, "3 3"]:
    """Return the rotation that brings views that were found nearest to those that are known, by least squares.

    It keeps what the settings say of shapes: a turn about gravity, and a half turn where they are their own mirror
    image; without gravity any rotation, or any that keeps the plane of symmetry.
    """
    wanted = (known.mT @ found).double().sum(0)
    if not (settings.gravity or settings.symmetric):
        return nearest_rotation(wanted[None])[0].float()
    half = about_y(torch.tensor([math.pi], dtype=torch.float64))[0]
    identity = torch.eye(3, dtype=torch.float64)
    if settings.gravity and settings.symmetric:
        candidates = [identity, half]
    elif settings.gravity:
        candidates = [_nearest_about(wanted, about_y)]
    else:
        candidates = [_nearest_about(wanted @ other.mT, about_x) @ other for other in (identity, half)]
    return _exact(max(candidates, key=lambda one: float((one * wanted).sum())))


def _nearest_about(wanted: Tensor, about: Callable[[Tensor], Tensor]) -> Tensor:
    """Return the rotation about an axis that is nearest to ``wanted``: trace(R' W) = c + a cos + b sin of its angle."""
    none, quarter, half = about(torch.tensor([0.0, math.pi / 2, math.pi], dtype=torch.float64))
    low, middle, high = ((turn * wanted).sum() for turn in (half, quarter, none))
    return about(torch.atan2(middle - (low + high) / 2, (high - low) / 2)[None])[0]


def _exact(rotation: Tensor) -> Float[Tensor, "3 3"]:
    """Return a rotation whose entries that are -1, 0 or 1 but for rounding are exactly that."""
    whole = rotation.round()
    return torch.where((rotation - whole).abs() < 1e-12, whole, rotation).float()


def turned_grids(
    logits: Float[Tensor, "items depth height width"], rotation: Float[Tensor, "3 3"]
) -> Float[Tensor, "items depth height width"]:
    """Return grids in the frame that ``rotation`` leads to; a half turn about gravity moves voxels, others resample."""
    if torch.equal(rotation, torch.eye(3).to(rotation)):
        return logits
    if torch.equal(rotation, torch.diag(torch.tensor([-1.0, 1, -1])).to(rotation)):
        return logits.flip(-1, -3)
    back = torch.nn.functional.pad(rotation.mT, (0, 1))[None].expand(len(logits), -1, -1)
    places = affine_grid(back, [len(logits), 1, *logits.shape[1:]], align_corners=False)
    return grid_sample(logits[:, None], places, padding_mode="border", align_corners=False)[:, 0]
