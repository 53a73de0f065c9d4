"""`ViewHypotheses`: the few views that each mask is likely to be from, as a mixture of shapes finds them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from uplift.data.mask_tensors import MaskSet, moments, recrop
from uplift.data.samples import Samples
from uplift.geometry.rotation import nearest_rotation
from uplift.models.mixture import Drawn, ShapeMixture
from uplift.models.projector import BASE
from uplift.models.silhouettes import ObjectPose, angles_of

__all__ = ["ViewHypotheses", "likely_views"]

_APART = 0.45
"""Radians between two hypotheses, at least."""
_NEAR = 0.35
"""Radians about a hypothesis that belong to it."""
_CHUNK = 250
_WITHIN = 1.2
"""Half the extent that nearly all shapes have: what perspective makes of a shape that fills its grid."""
_NEARLY_ALL = 0.97


@dataclass(frozen=True)
class ViewHypotheses(Samples):
    """Poses of masks: some for each, the likeliest first."""

    azimuth: Float[Tensor, "items hypotheses"]
    elevation: Float[Tensor, "items hypotheses"]
    roll: Float[Tensor, "items hypotheses"]
    scale: Float[Tensor, "items hypotheses"]
    offset: Float[Tensor, "items hypotheses 2"]
    weight: Float[Tensor, "items hypotheses"]
    """Probability of each; they need not sum to 1."""

    @property
    def poses(self) -> ObjectPose:
        """All of them, (items, hypotheses, ...)."""
        return ObjectPose(self.azimuth, self.elevation, self.roll, self.scale, self.offset)

    @classmethod
    def empty(cls, items: int, hypotheses: int, device: torch.device) -> ViewHypotheses:
        """Return places for the hypotheses of so many masks."""
        one = torch.zeros(items, hypotheses, device=device)
        azimuth, elevation, roll, scale = (one.clone() for _ in range(4))
        return cls(azimuth, elevation, roll, scale, one.new_zeros(items, hypotheses, 2), one)

    def scaled_to(self, data: MaskSet) -> ViewHypotheses:
        """Return the same views at the scale that labelled masks are known to have."""
        known = data.labelled
        factor = (data.scale[known] / self.scale[known, 0]).median()
        return replace(self, scale=self.scale * factor)


_LIKELY = 0.75
"""Of the temperature that the mixture ends with: that at which views are told apart."""


@torch.no_grad()
def likely_views(mixture: ShapeMixture, masks: UInt8[Tensor, "items side side"], most: int = 3) -> ViewHypotheses:
    """Return the ``most`` likeliest views of each mask that are apart, and where the likeliest shape then stands.

    The scale is that at which nearly all shapes fill the grid, from masks and their likeliest views alone.
    """
    drawn, temperature = mixture.crops(), _LIKELY * mixture.settings.temperature_end
    parts = [_of_chunk(mixture, drawn, part.float() / 255, temperature, most) for part in masks.split(_CHUNK)]
    found = ViewHypotheses.concat(parts)
    extent = _extent(masks, found.offset[:, 0]) / found.scale[:, 0]
    factor = float(extent.quantile(_NEARLY_ALL)) / _WITHIN
    return ViewHypotheses(**{**vars(found), "scale": found.scale * factor})


def _of_chunk(mixture: ShapeMixture, drawn: Drawn, masks: Tensor, temperature: float, most: int) -> ViewHypotheses:
    centre, spread = moments(masks)
    crops = recrop(masks, centre, spread, mixture.settings.crop)
    evidence = mixture.evidence(crops, spread, drawn, temperature)
    likely = evidence.flatten(1).softmax(1).view_as(evidence)
    views = mixture.grid.views.to(masks)
    cosine = ((views.flatten(1) @ views.flatten(1).T - 1) / 2).clamp(-1, 1)
    near, apart = (cosine > torch.cos(torch.tensor(_NEAR))).to(masks), cosine < torch.cos(torch.tensor(_APART))
    by_view = left = likely.sum(1)
    rows, found = torch.arange(len(masks), device=masks.device), []
    for _ in range(most):
        best = left.argmax(1)
        part = likely[rows, :, best].argmax(1)
        share = by_view * near[best]
        mean = nearest_rotation(
            (share @ views.flatten(1)).view(-1, 3, 3) / share.sum(1)[:, None, None].clamp_min(1e-20)
        )
        stretch, offset = _fitted(drawn, part * len(views) + best, centre, spread)
        scale = stretch.prod(1).sqrt()
        found.append((*angles_of(mean), scale, offset, share.sum(1)))
        left = left.where(apart[best], -1.0)
    return ViewHypotheses(*(torch.stack(one, 1) for one in zip(*found, strict=True)))


def _fitted(drawn: Drawn, index: Tensor, centre: Tensor, spread: Tensor) -> tuple[Tensor, Tensor]:
    """Return scales along x and y, and offsets, at which silhouettes have the masks' centroids and spreads."""
    _, drawn_centre, drawn_spread = (part.flatten(0, 1) for part in drawn)
    stretch = spread / drawn_spread[index] * BASE
    return stretch, centre - drawn_centre[index] / BASE * stretch


def _extent(masks: Tensor, offset: Tensor) -> Float[Tensor, " items"]:
    """Return how far masks reach from ``offset`` along an axis, in half sides."""
    side = masks.shape[-1]
    at = (2 * torch.arange(side, device=masks.device) + 1) / side - 1
    reach = []
    for axis in (1, 2):
        covered, middle = (masks > 127).any(axis), offset[:, axis - 1, None]
        reach.append(((at - middle).abs() * covered).amax(1))
    return torch.maximum(*reach)
