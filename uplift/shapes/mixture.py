"""`ShapeMixture`: a few shapes of one kind of object that explain masks, each from every view."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.config import ShapeSettings
from uplift.shapes.crops import moments, recrop
from uplift.shapes.rays import Projector
from uplift.shapes.view_grid import AZIMUTHS, ViewGrid, view_grid

__all__ = ["LEAST", "MOST", "Drawn", "ShapeMixture", "temperature_at"]

_DENSITY = 1.3
"""Density of a voxel for each nat of its logit: one that is full hides nearly all light."""
LEAST, MOST = 0.01, 0.99
"""Bounds of what a pixel of a silhouette is held to cover, so that no pixel is impossible."""
_SIZE = 0.36
"""Spread of a shape's silhouettes at the scale they are drawn, in half sides: it fills its grid but for a margin."""


class Drawn(NamedTuple):
    """Silhouettes of shapes from views, cut out as masks are."""

    cut: Float[Tensor, "shapes views side side"]
    centre: Float[Tensor, "shapes views 2"]
    spread: Float[Tensor, "shapes views 2"]
    """Both before they were cut out, in half sides at the scale of `uplift.shapes.rays.BASE`."""


class ShapeMixture(nn.Module):
    """Occupancy grids of shapes, and how well each explains a mask from each view.

    A mask and a silhouette are compared as crops of the same centroid and the same spread along x and y
    (`uplift.shapes.crops`), so that a shape explains others of other proportions; how the two spreads
    compare is a term of its own. The likelihood of a mask sums over shapes and views: which view it is
    need never be decided while it is not known.
    """

    def __init__(self, settings: ShapeSettings, parts: int | None = None, azimuths: int = AZIMUTHS):
        super().__init__()
        self.settings = settings
        self.grid: ViewGrid = view_grid(settings, azimuths)
        n, parts = settings.detail, parts or settings.parts
        half = n // 2 if settings.symmetric else n
        self.logits = nn.Parameter(_first_shapes(parts, n)[..., -half:].clone())
        self.register_buffer("azimuth_bias", torch.zeros(parts, self.grid.azimuths))
        self.register_buffer("part_bias", torch.zeros(parts))
        self.register_buffer("level", torch.tensor(0.2))
        self.projector: Projector | None = None

    azimuth_bias: Tensor
    part_bias: Tensor
    level: Tensor
    """Of occupancy, where the surface of lifted shapes is."""

    @property
    def full_logits(self) -> Float[Tensor, "shapes depth height width"]:
        """The grids; of shapes that are their own mirror image, both halves."""
        return torch.cat([self.logits.flip(-1), self.logits], -1) if self.settings.symmetric else self.logits

    @property
    def occupancy(self) -> Float[Tensor, "shapes depth height width"]:
        """0..1 for each voxel."""
        return torch.sigmoid(self.full_logits)

    def silhouettes(self, rows: Sequence[int] | None = None) -> Float[Tensor, "shapes drawn side side"]:
        """Return every shape's silhouette from the grid's drawn views, or ``rows`` of them, at the scale of `BASE`."""
        device = self.logits.device
        if self.projector is None:
            s = self.settings
            views = self.grid.views[self.grid.drawn]
            self.projector = Projector(views, resolution=s.detail, side=s.crop, distance=s.distance)
        if self.projector.device != device:
            self.projector.to(device)
        return self.projector(nn.functional.softplus(self.full_logits) * _DENSITY, rows)

    def cut_out(self, rows: Sequence[int] | None = None) -> Drawn:
        """Return `silhouettes` cut out as masks are, and their centroids and spreads."""
        drawn = self.silhouettes(rows)
        flat = drawn.flatten(0, 1)
        centre, spread = moments(flat)
        cut = recrop(flat, centre.detach(), spread.detach(), self.settings.crop)
        shape = drawn.shape[:2]
        return Drawn(cut.view_as(drawn), centre.view(*shape, 2), spread.view(*shape, 2))

    def crops(self) -> Drawn:
        """Return `cut_out` for every view of the grid, the mirror images among them."""
        cut, centre, spread = self.cut_out()
        whole = self.grid.whole
        mirror = centre.new_tensor([-1.0, 1.0])
        return Drawn(whole(cut, cut.flip(-1)), whole(centre, centre * mirror), whole(spread))

    def evidence(
        self,
        masks: Float[Tensor, "items side side"],
        spread: Float[Tensor, "items 2"],
        drawn: Drawn,
        temperature: float,
    ) -> Float[Tensor, "items shapes views"]:
        """Return the log likelihood, up to a constant, of masks for each shape and view, given `crops` of the shapes."""
        pixels = drawn.cut.flatten(2).flatten(0, 1).clamp(LEAST, MOST)
        empty = (1 - pixels).log()
        flat = masks.flatten(1)
        error = -(flat @ (pixels.log() - empty).T + empty.sum(1)) / flat.shape[1]
        wide = (drawn.spread[..., 0] / drawn.spread[..., 1]).log().flatten()
        ratio = (spread[:, 0] / spread[:, 1]).log()
        unlike = 0.5 * ((ratio[:, None] - wide[None]) / self.settings.proportions) ** 2
        before = (self.grid.log_prior.to(flat) - self.azimuth_bias[:, self.grid.azimuth]).sub(self.part_bias[:, None])
        return (before.flatten() - error / temperature - unlike).view(len(masks), *drawn.cut.shape[:2])

    @staticmethod
    def size_loss(drawn: Drawn) -> Float[Tensor, ""]:
        """Return how far shapes are from the size and the place they are to have in their grids.

        Crops do not tell how large a shape is, nor where: without this shapes shrink to a few voxels.
        """
        size = drawn.spread.square().sum(-1).mean(1).sqrt()
        return (size / _SIZE).log().square().mean() + drawn.centre.square().sum(-1).mean()

    @torch.no_grad()
    def balance(self, used: Float[Tensor, "shapes views"], azimuths: float, parts: float) -> None:
        """Keep azimuths equally used by each shape, and shapes alive: what is used more than its share costs more.

        ``used`` is the share of the masks that each shape and view explains; ``azimuths`` and ``parts``
        are how fast the two are corrected.
        """
        turned = used.new_zeros(len(used), self.grid.azimuths)
        turned.index_add_(1, self.grid.azimuth.to(used.device), used)
        share = turned.sum(1)
        even = turned / share[:, None].clamp_min(1e-6) * self.grid.azimuths
        bias = (self.azimuth_bias + azimuths * even.clamp_min(0.05).log()).clamp(-5, 5)
        self.azimuth_bias.copy_(bias - bias.mean(1, keepdim=True))
        self.part_bias.add_(parts * (share * len(share)).clamp_min(0.05).log()).clamp_(-3, 3)


def _first_shapes(parts: int, resolution: int) -> Tensor:
    """Return logits of soft ellipsoids with a little noise: nothing is known of the shapes."""
    at = (2 * torch.arange(resolution) + 1) / resolution - 1
    z, y, x = torch.meshgrid(at, at, at, indexing="ij")
    shapes = []
    for _ in range(parts):
        radius = 0.35 + 0.35 * torch.rand(3)
        far = ((x / radius[0]) ** 2 + (y / radius[1]) ** 2 + (z / radius[2]) ** 2).sqrt()
        noise = nn.functional.interpolate(torch.randn(1, 1, 5, 5, 5), (resolution,) * 3, mode="trilinear")[0, 0]
        shapes.append(((1 - far) * 3 + noise - 0.5).clamp(-3, 1.5))
    return torch.stack(shapes)


def temperature_at(done: float, hot: float, cold: float) -> float:
    """Return the temperature after a share ``done`` of the stage: it falls to ``cold`` over four fifths of it."""
    return hot * math.exp(math.log(cold / hot) * min(1.0, done / 0.8))
