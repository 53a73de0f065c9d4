"""`ShapeMixture`: a few shapes of one kind of object that explain masks, each from every view."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.config import ShapeSettings
from uplift.shapes.crops import moments, recrop
from uplift.shapes.rays import Projector
from uplift.shapes.view_grid import ViewGrid, view_grid

__all__ = ["ShapeMixture", "temperature_at"]

_DENSITY = 1.3
"""Density of a voxel for each nat of its logit: one that is full hides nearly all light."""
_LEAST, _MOST = 0.01, 0.99
_SIZE = 0.36
"""Spread of a shape's silhouettes at the scale they are drawn, in half sides: it fills its grid but for a margin."""


class ShapeMixture(nn.Module):
    """Occupancy grids of ``settings.parts`` shapes, and how well each explains a mask from each view.

    A mask and a silhouette are compared as crops of the same centroid and the same spread along x and y
    (`uplift.shapes.crops`), so that a shape explains others of other proportions; how the two spreads
    compare is a term of its own. The likelihood of a mask sums over shapes and views: which view it is
    need never be decided while it is not known.
    """

    def __init__(self, settings: ShapeSettings):
        super().__init__()
        self.settings = settings
        self.grid: ViewGrid = view_grid(settings)
        n, parts = settings.detail, settings.parts
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

    def silhouettes(self) -> Float[Tensor, "shapes views side side"]:
        """Return every shape's silhouette from every view, at the scale of `uplift.shapes.rays.BASE`."""
        if self.projector is None or self.projector.matrix.device != self.logits.device:
            s = self.settings
            projector = Projector(self.grid.views, resolution=s.detail, side=s.crop, distance=s.distance)
            self.projector = projector.to(self.logits.device)
        density = nn.functional.softplus(self.full_logits) * _DENSITY
        return self.projector(density)

    def crops(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the silhouettes cut out as masks are (shapes views side side), and their centroids and spreads."""
        drawn = self.silhouettes()
        flat = drawn.flatten(0, 1)
        centre, spread = moments(flat)
        cut = recrop(flat, centre.detach(), spread.detach(), self.settings.crop)
        return cut.view_as(drawn), centre.view(*drawn.shape[:2], 2), spread.view(*drawn.shape[:2], 2)

    def evidence(
        self,
        masks: Float[Tensor, "items side side"],
        spread: Float[Tensor, "items 2"],
        drawn: tuple[Tensor, Tensor, Tensor],
        temperature: float,
    ) -> Float[Tensor, "items shapes views"]:
        """Return the log likelihood, up to a constant, of masks for each shape and view, given `crops` of the shapes."""
        cut, _, drawn_spread = drawn
        pixels = cut.flatten(2).flatten(0, 1).clamp(_LEAST, _MOST)
        flat = masks.flatten(1)
        error = -(flat @ pixels.log().T + (1 - flat) @ (1 - pixels).log().T) / flat.shape[1]
        wide = (drawn_spread[..., 0] / drawn_spread[..., 1]).log().flatten()
        ratio = (spread[:, 0] / spread[:, 1]).log()
        unlike = 0.5 * ((ratio[:, None] - wide[None]) / self.settings.proportions) ** 2
        before = (self.grid.log_prior.to(flat) - self.azimuth_bias[:, self.grid.azimuth]).sub(self.part_bias[:, None])
        return (before.flatten() - error / temperature - unlike).view(len(masks), *cut.shape[:2])

    @staticmethod
    def size_loss(drawn: tuple[Tensor, Tensor, Tensor]) -> Float[Tensor, ""]:
        """Return how far shapes are from the size and the place they are to have in their grids.

        Crops do not tell how large a shape is, nor where: without this shapes shrink to a few voxels.
        """
        _, centre, spread = drawn
        size = spread.square().sum(-1).mean(1).sqrt()
        return (size / _SIZE).log().square().mean() + centre.square().sum(-1).mean()

    @torch.no_grad()
    def balance(self, responsibility: Float[Tensor, "items shapes views"]) -> None:
        """Keep azimuths equally used by each shape, and shapes alive: what is used more than its share costs more."""
        used = responsibility.new_zeros(responsibility.shape[1], self.grid.azimuths)
        used.index_add_(1, self.grid.azimuth.to(used.device), responsibility.mean(0))
        share = used.sum(1)
        even = used / share[:, None].clamp_min(1e-6) * self.grid.azimuths
        bias = (self.azimuth_bias + 0.1 * even.clamp_min(0.05).log()).clamp(-5, 5)
        self.azimuth_bias.copy_(bias - bias.mean(1, keepdim=True))
        self.part_bias.add_(0.03 * (share * len(share)).clamp_min(0.05).log()).clamp_(-3, 3)


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
