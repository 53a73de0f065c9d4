"""`ShapeMixture`: a few shapes of one kind of object that explain masks, each from every view."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from uplift.config.settings import ShapeSettings
from uplift.data.mask_tensors import moments, recrop
from uplift.geometry.rotation import random_rotations, views_about_gravity
from uplift.models.projector import Projector

__all__ = [
    "AZIMUTHS", "LEAST", "MOST", "Drawn", "ShapeMixture", "agree_on_front", "split", "temperature_at", "view_grid",
]  # fmt: skip

AZIMUTHS = 24
"""Of the first stage; later ones have twice as many."""
_DENSITY = 1.3
"""Density of a voxel per nat of its logit: a full one is nearly opaque."""
LEAST, MOST = 0.01, 0.99
"""Bounds of the opacity of a pixel in likelihoods, so that no mask is impossible."""
_SIZE = 0.36
"""Target spread of a shape's silhouettes as rendered, in half sides: the shape fills its grid up to a margin."""


class Drawn(NamedTuple):
    """Silhouettes of shapes, cropped as masks are."""

    cut: Float[Tensor, "shapes views side side"]
    centre: Float[Tensor, "shapes views 2"]
    spread: Float[Tensor, "shapes views 2"]
    """Centroid and spread before cropping, in half sides at the scale of `uplift.models.projector.BASE`."""


class ShapeMixture(nn.Module):
    """Occupancy grids of shapes, and the likelihood of a mask under each from each view.

    A mask and a silhouette are compared as crops with the same centroid and the same spread along x and y
    (`uplift.data.tensors`), so that a shape explains objects of other proportions; the ratio of the two spreads
    is a separate term. The likelihood of a mask sums over shapes and views, so that the view need not be
    decided while it is uncertain.

    Args:
        settings: resolution, symmetry and cameras.
        parts: how many shapes; `ShapeSettings.parts` by default.
        azimuths: how many azimuths there are views from.
    """

    def __init__(self, settings: ShapeSettings, parts: int | None = None, azimuths: int = AZIMUTHS):
        super().__init__()
        self.settings = settings
        self.grid: _ViewGrid = view_grid(settings, azimuths)
        n, parts = settings.coarse, parts or settings.parts
        first = _first_shapes(parts, n)
        self.logits = nn.Parameter(first[..., n - n // 2 :].clone() if settings.symmetric else first)
        self.register_buffer("azimuth_bias", torch.zeros(parts, self.grid.azimuths))
        self.register_buffer("part_bias", torch.zeros(parts))
        self.register_buffer("level", torch.tensor(0.2))
        self.projector: Projector | None = None

    azimuth_bias: Tensor
    part_bias: Tensor
    level: Tensor
    """Iso threshold: the occupancy at which the surface of lifted shapes is."""

    @property
    def full_logits(self) -> Float[Tensor, "shapes depth height width"]:
        """The complete grids: both halves of shapes that are their own mirror image."""
        return torch.cat([self.logits.flip(-1), self.logits], -1) if self.settings.symmetric else self.logits

    @property
    def occupancy(self) -> Float[Tensor, "shapes depth height width"]:
        """0..1 for each voxel."""
        return torch.sigmoid(self.full_logits)

    def silhouettes(self, rows: Sequence[int] | None = None) -> Float[Tensor, "shapes drawn side side"]:
        """Return every shape's silhouette from the rendered views, or ``rows`` of them, at the scale of `BASE`."""
        if self.projector is None:
            s, views = self.settings, self.grid.views[self.grid.drawn]
            self.projector = Projector(views, resolution=s.coarse, side=s.crop, distance=s.distance)
        if self.projector.device != self.logits.device:
            self.projector.to(self.logits.device)
        return self.projector(nn.functional.softplus(self.full_logits) * _DENSITY, rows)

    def cut_out(self, rows: Sequence[int] | None = None) -> Drawn:
        """Return `silhouettes` cropped as masks are, and their centroids and spreads."""
        drawn = self.silhouettes(rows)
        flat = drawn.flatten(0, 1)
        centre, spread = moments(flat)
        cut = recrop(flat, centre.detach(), spread.detach(), self.settings.crop)
        shape = drawn.shape[:2]
        return Drawn(cut.view_as(drawn), centre.view(*shape, 2), spread.view(*shape, 2))

    def crops(self) -> Drawn:
        """Return `cut_out` for every view of the grid, mirror images included."""
        cut, centre, spread = self.cut_out()
        every = self.grid.for_all_views
        mirror = centre.new_tensor([-1.0, 1.0])
        return Drawn(every(cut, cut.flip(-1)), every(centre, centre * mirror), every(spread))

    def evidence(
        self,
        masks: Float[Tensor, "items side side"],
        spread: Float[Tensor, "items 2"],
        drawn: Drawn,
        temperature: float,
    ) -> Float[Tensor, "items shapes views"]:
        """Return the log likelihood of each mask and view under each shape, up to a constant.

        ``masks`` are crops, 0..1, ``spread`` is that of each mask along x and y, ``drawn`` are `crops` of the
        shapes; pixel errors are divided by ``temperature``.
        """
        pixels = drawn.cut.flatten(2).flatten(0, 1).clamp(LEAST, MOST)
        empty = (1 - pixels).log()
        flat = masks.flatten(1)
        error = -(flat @ (pixels.log() - empty).T + empty.sum(1)) / flat.shape[1]
        log_ratio = (drawn.spread[..., 0] / drawn.spread[..., 1]).log().flatten()
        ratio = (spread[:, 0] / spread[:, 1]).log()
        proportions = 0.5 * ((ratio[:, None] - log_ratio[None]) / self.settings.proportions) ** 2
        log_prior = self.grid.log_prior.to(flat) - self.azimuth_bias[:, self.grid.azimuth] - self.part_bias[:, None]
        return (log_prior.flatten() - error / temperature - proportions).view(len(masks), *drawn.cut.shape[:2])

    @staticmethod
    def size_loss(drawn: Drawn) -> Float[Tensor, ""]:
        """Return how far shapes are from their target size and from the centre of their grids.

        Crops do not show the size and position of a shape: without this, shapes shrink to a few voxels.
        """
        size = drawn.spread.square().sum(-1).mean(1).sqrt()
        return (size / _SIZE).log().square().mean() + drawn.centre.square().sum(-1).mean()

    @torch.no_grad()
    def balance(self, used: Float[Tensor, "shapes views"], azimuths: float, parts: float) -> None:
        """Make azimuths and shapes that explain more than their share of masks less likely.

        ``used`` is the share of the masks that each shape and view explains; ``azimuths`` and ``parts`` are the
        rates at which azimuths of each shape, and shapes, are corrected.
        """
        by_azimuth = used.new_zeros(len(used), self.grid.azimuths)
        by_azimuth.index_add_(1, self.grid.azimuth.to(used.device), used)
        share = by_azimuth.sum(1)
        even = by_azimuth / share[:, None].clamp_min(1e-6) * self.grid.azimuths
        bias = (self.azimuth_bias + azimuths * even.clamp_min(0.05).log()).clamp(-5, 5)
        self.azimuth_bias.copy_(bias - bias.mean(1, keepdim=True))
        self.part_bias.add_(parts * (share * len(share)).clamp_min(0.05).log()).clamp_(-3, 3)


_LONG = (0.25, 0.38, 0.75)
"""Radii of the first shapes along x, y and z: a round start lets the mirror plane settle across a long body."""


def _first_shapes(parts: int, resolution: int) -> Tensor:
    """Return logits of random soft ellipsoids, long from front to back, with a little noise."""
    at = (2 * torch.arange(resolution) + 1) / resolution - 1
    z, y, x = torch.meshgrid(at, at, at, indexing="ij")
    shapes = []
    for _ in range(parts):
        radius = torch.tensor(_LONG) * (1 + 0.2 * torch.randn(3)).clamp(0.6, 1.4)
        far = ((x / radius[0]) ** 2 + (y / radius[1]) ** 2 + (z / radius[2]) ** 2).sqrt()
        noise = nn.functional.interpolate(torch.randn(1, 1, 5, 5, 5), (resolution,) * 3, mode="trilinear")[0, 0]
        shapes.append(((1 - far) * 3 + noise - 0.5).clamp(-3, 1.5))
    return torch.stack(shapes)


def temperature_at(done: float, start: float, end: float) -> float:
    """Return the temperature after a share ``done`` of the stage: it falls to ``end`` over four fifths of it."""
    return start * math.exp(math.log(end / start) * min(1.0, done / 0.8))


# The views that a mask may have been taken from: azimuths times elevations, or rotations spread over SO(3).

_ROTATIONS = 192
_ELEVATION_STEPS = (-1.25, 0.0, 1.25)
"""Elevations, in standard deviations from their mean."""


@dataclass(frozen=True)
class _ViewGrid:
    """Views, the prior probability of each, and which of them need to be rendered.

    Of shapes that are their own mirror image, half the silhouettes are mirror images of the other half.
    """

    views: Float[Tensor, "views 3 3"]
    """Rotations from the shape frame to the camera frame."""
    log_prior: Float[Tensor, " views"]
    azimuth: Int[Tensor, " views"]
    """Index of each view's azimuth; all are equally likely."""
    drawn: Int[Tensor, " drawn"]
    """The views that are rendered."""
    mirrored: Int[Tensor, " drawn"] | None
    """For each of those, the view that sees its mirror image; None if all views are rendered."""

    @property
    def azimuths(self) -> int:
        """How many azimuths there are."""
        return int(self.azimuth.max()) + 1

    def for_all_views(self, drawn: Tensor, other: Tensor | None = None) -> Tensor:
        """Return values for all views (shapes views ...) from those of rendered views (shapes drawn ...).

        ``other`` are the values of their mirror images, if they differ.
        """
        if self.mirrored is None:
            return drawn
        every = drawn.new_empty(len(drawn), len(self.views), *drawn.shape[2:])
        every[:, self.mirrored] = drawn if other is None else other
        every[:, self.drawn] = drawn
        return every


def view_grid(settings: ShapeSettings, azimuths: int = AZIMUTHS) -> _ViewGrid:
    """Return the grid of views: about gravity at the elevations of the settings, or over SO(3) without gravity."""
    if not settings.gravity:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            views = _spread_out(random_rotations(8 * _ROTATIONS), _ROTATIONS)
        count = torch.arange(len(views))
        return _ViewGrid(views, torch.zeros(len(views)), count, count, None)
    mean, sd = (math.radians(angle) for angle in settings.elevation_deg)
    steps = torch.tensor(_ELEVATION_STEPS if sd > math.radians(2) else (0.0,))
    angles = (torch.arange(azimuths) + 0.5) / azimuths * 2 * math.pi - math.pi
    azimuth = torch.arange(azimuths).repeat_interleave(len(steps))
    step = steps.repeat(azimuths)
    tilt = mean + sd * step
    views = views_about_gravity(torch.zeros_like(tilt), angles[azimuth], tilt)
    drawn = every = torch.arange(len(views))
    mirrored = None
    if settings.symmetric and azimuths % 2 == 0:
        drawn = every[: len(every) // 2]
        mirrored = every.view(azimuths, len(steps)).flip(0).flatten()[: len(drawn)]
    return _ViewGrid(views, -0.18 * step**2, azimuth, drawn, mirrored)


def _spread_out(rotations: Tensor, count: int) -> Tensor:
    """Return ``count`` of ``rotations``, each as far as possible from those before it."""
    flat, chosen = rotations.flatten(1), [0]
    nearest = flat @ flat[0]
    while len(chosen) < count:
        chosen.append(int(nearest.argmin()))
        nearest = torch.maximum(nearest, flat @ flat[chosen[-1]])
    return rotations[chosen]


# Splitting: every shape becomes several that start nearly equal and diverge.

_NOISE = 0.7
"""Standard deviation of the noise on logits: enough for two copies to explain different masks."""
_COARSE = 8
"""Resolution of that noise, which is interpolated to be smooth."""


@torch.no_grad()
def agree_on_front(mixture: ShapeMixture) -> int:
    """Turn shapes by half a turn about gravity where that makes them more alike, and return how many were turned.

    Each shape of a mixture finds its own front, as masks do not tell it. Signs are those of the leading eigenvector of
    how much more each pair is alike as it is than with one of them turned (spectral synchronisation, Singer 2011).
    """
    grids = nn.functional.avg_pool3d(mixture.occupancy[:, None], 2)[:, 0]
    turned = grids.flip(1) if mixture.settings.symmetric else grids.flip(1, 3)
    here, there = (
        nn.functional.normalize(one.flatten(1) - one.flatten(1).mean(1, keepdim=True)) for one in (grids, turned)
    )
    alike = here @ here.T - here @ there.T
    alike.fill_diagonal_(0)
    leading = torch.linalg.eigh((alike + alike.T) / 2).eigenvectors[:, -1]
    leading = leading * torch.where(leading.sum() < 0, -1.0, 1.0)
    rows = (leading < 0).nonzero()[:, 0]
    axes = (1,) if mixture.settings.symmetric else (1, 3)
    mixture.logits[rows] = mixture.logits[rows].flip(axes)
    mixture.azimuth_bias[rows] = mixture.azimuth_bias[rows].roll(mixture.grid.azimuths // 2, 1)
    return len(rows)


def split(mixture: ShapeMixture, times: int, azimuths: int) -> ShapeMixture:
    """Return a mixture of ``times`` as many shapes, copies of those of ``mixture`` with smooth noise.

    ``azimuths`` is the new number of azimuths, a multiple of the old; views over SO(3) stay as they are.
    """
    before = mixture.grid.azimuths
    finer = azimuths // before if mixture.settings.gravity else 1
    made = ShapeMixture(mixture.settings, len(mixture.logits) * times, before * finer)
    if finer == 1:
        made.projector = mixture.projector
    with torch.no_grad():
        logits = mixture.logits.repeat_interleave(times, 0)
        coarse = torch.randn(len(logits), 1, _COARSE, _COARSE, _COARSE // 2 if mixture.settings.symmetric else _COARSE)
        noise = nn.functional.interpolate(coarse, logits.shape[1:], mode="trilinear")[:, 0]
        made.logits.copy_(logits + _NOISE * noise.to(logits) * (times > 1))
        made.azimuth_bias.copy_(mixture.azimuth_bias.repeat_interleave(times, 0).repeat_interleave(finer, 1))
        made.part_bias.copy_(mixture.part_bias.repeat_interleave(times, 0))
        made.level.copy_(mixture.level)
    return made
