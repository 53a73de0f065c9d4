"""`lift_masks`: a shape for each mask from a mixture of shapes, carved by the mask and its mirror image."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.data.mask_tensors import moments, recrop
from uplift.data.samples import Samples
from uplift.models.mixture import Drawn, ShapeMixture
from uplift.models.projector import BASE

__all__ = ["LiftedShapes", "choose_iso_threshold", "lift_masks"]

# Inference: the expected occupancy over the likeliest shapes and views, carved by the mask.

_HYPOTHESES = 32
"""The likeliest shapes and views of each mask, which the expectation is over."""
_COVERED = 0.3
"""Share of a mask's pixel that must be covered for voxels that project to it to be kept."""
_UNCERTAIN = 0.2
"""Factor on a voxel outside the mirror image of the mask, as the view may be slightly off."""


@dataclass(frozen=True)
class LiftedShapes(Samples):
    """Occupancy in the shape frame at each mask's most likely view, and its pose in the camera frame (see `Placed`)."""

    occupancy: Float[Tensor, "items depth height width"]
    view: Float[Tensor, "items 3 3"]
    scale: Float[Tensor, " items"]
    offset: Float[Tensor, "items 2"]
    distance: Float[Tensor, " items"]


@dataclass(frozen=True)
class _Hypothesis:
    """One shape from one view for each mask, fitted to the mask's centroid and spread."""

    shape: Tensor
    view: Tensor
    stretch: Tensor
    """(items 2), half sides of the mask's crop per unit of the shape, along x and y."""
    centre: Tensor


@torch.no_grad()
def lift_masks(
    mixture: ShapeMixture, masks: Float[Tensor, "items side side"], drawn: Drawn, *, resolution: int, temperature: float
) -> LiftedShapes:
    """Return the expected occupancy of each mask's shape over the likeliest shapes and views.

    Voxels that do not project into the mask are empty; those of symmetric shapes whose mirror image does not
    are nearly so.

    Args:
        mixture: the trained shapes.
        masks: 0..1.
        drawn: silhouettes of the shapes from all views, `ShapeMixture.crops`.
        resolution: voxels along each axis of the result.
        temperature: of the likelihood of a mask.
    """
    centre, spread = moments(masks)
    crops = recrop(masks, centre, spread, mixture.settings.crop)
    likely = mixture.evidence(crops, spread, drawn, temperature).flatten(1).softmax(1)
    found = likely.topk(min(_HYPOTHESES, likely.shape[1]), 1)
    weight = found.values / found.values.sum(1, keepdim=True)
    guesses = [_hypothesis(mixture, drawn, index, centre, spread) for index in found.indices.T]
    best = guesses[0]
    scale = best.stretch.amax(1)
    distance = mixture.settings.distance * scale
    image, depth = _project_grid(resolution, best.view, scale, best.centre, distance)
    total = masks.new_zeros(depth.shape[:2])
    dilated = nn.functional.max_pool2d(masks[:, None], 3, 1, 1)
    for number, guess in enumerate(guesses):
        total += weight[:, number, None] * _occupancy_at(mixture, guess, image, depth, dilated)
    total *= (_sample(masks[:, None], image) > _COVERED).to(total.dtype)
    grid = total.view(-1, resolution, resolution, resolution)
    return LiftedShapes(grid, best.view, scale, best.centre, distance)


def _project_grid(
    resolution: int, view: Tensor, scale: Tensor, offset: Tensor, distance: Tensor
) -> tuple[Float[Tensor, "items points 2"], Float[Tensor, "items points 1"]]:
    """Return where the voxels of shapes with this pose project to, in half sides of the crop, and their depths."""
    at = ((2 * torch.arange(resolution, device=scale.device, dtype=scale.dtype) + 1) / resolution) - 1
    z, y, x = torch.meshgrid(at, at, at, indexing="ij")
    inside = (torch.stack([x, y, z], -1).reshape(1, -1, 3) @ view.mT) * scale[:, None, None]
    depth = inside[..., 2:]
    flat = inside[..., :2] + offset[:, None]
    return flat / (1 + depth / distance[:, None, None]).clamp_min(0.1), depth


def _hypothesis(mixture: ShapeMixture, drawn: Drawn, index: Tensor, centre: Tensor, spread: Tensor) -> _Hypothesis:
    """Return the shape and view of each mask's ``index`` (items,), fitted to the mask."""
    _, drawn_centre, drawn_spread = (part.flatten(0, 1) for part in drawn)
    views = len(mixture.grid.views)
    stretch = spread / drawn_spread[index] * BASE
    place = centre - drawn_centre[index] / BASE * stretch
    view = mixture.grid.views.to(spread)[index % views]
    return _Hypothesis(index // views, view, stretch, place)


def _sample(image: Tensor, points: Tensor) -> Tensor:
    return nn.functional.grid_sample(image, points[:, :, None], align_corners=False)[:, 0, :, 0]


def _occupancy_at(mixture: ShapeMixture, guess: _Hypothesis, image: Tensor, depth: Tensor, dilated: Tensor) -> Tensor:
    """Return the occupancy (items points) of a hypothesis at points that project to ``image`` with ``depth``."""
    far = mixture.settings.distance
    z = depth / guess.stretch.prod(1).sqrt()[:, None, None]
    flat = (image - guess.centre[:, None]) / guess.stretch[:, None] * (1 + z / far)
    local = torch.cat([flat, z], -1) @ guess.view
    grids = mixture.occupancy[guess.shape][:, None]
    found = nn.functional.grid_sample(grids, local[:, :, None, None], align_corners=False)[:, 0, :, 0, 0]
    if not mixture.settings.symmetric:
        return found
    mirrored = (local * local.new_tensor([-1.0, 1.0, 1.0])) @ guess.view.mT
    seen = mirrored[..., :2] / (1 + mirrored[..., 2:] / far).clamp_min(0.1) * guess.stretch[:, None]
    return found * _sample(dilated, seen + guess.centre[:, None]).clamp(_UNCERTAIN, 1)


# The iso threshold: as high as it can be while silhouettes still cover their masks.

_THRESHOLDS = (0.04, 0.06, 0.08, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2, 0.23, 0.26, 0.3, 0.35, 0.4, 0.5)
_NEARLY = 0.97
"""Of the best overlap with masks. A lower threshold thickens shapes where no mask constrains them."""


def choose_iso_threshold(lifted: LiftedShapes, masks: Float[Tensor, "items side side"]) -> float:
    """Return the occupancy above which voxels count as inside, chosen without any true shape.

    It is the highest threshold at which the silhouettes overlap with the lifted ``masks`` (0..1) nearly as well
    as at the best one.
    """
    flat = lifted.occupancy.flatten(1)
    side = masks.shape[-1] // 2
    real = nn.functional.avg_pool2d(masks[:, None], 2).flatten(1) > 0.5
    resolution = lifted.occupancy.shape[-1]
    image, _ = _project_grid(resolution, lifted.view, lifted.scale, lifted.offset, lifted.distance)
    at = ((image + 1) / 2 * side).long().clamp(0, side - 1)
    pixel = at[..., 1] * side + at[..., 0]
    overlaps = []
    for threshold in _THRESHOLDS:
        kept = (flat > threshold).to(flat.dtype)
        seen = flat.new_zeros(len(flat), side * side).scatter_reduce(1, pixel, kept, "amax") > 0.5
        overlaps.append(float(((seen & real).sum(1) / (seen | real).sum(1).clamp_min(1)).mean()))
    enough = _NEARLY * max(overlaps)
    return max(threshold for threshold, overlap in zip(_THRESHOLDS, overlaps, strict=True) if overlap >= enough)
