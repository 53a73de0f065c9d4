"""`ShapeMixture`: a few shapes of one kind of object that explain masks, each from every view."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from torch import Tensor, nn

from uplift.config.settings import ShapeSettings
from uplift.data.mask_tensors import moments, recrop
from uplift.geometry.rotation import random_rotations, views_about_gravity

__all__ = [
    "AZIMUTHS",
    "BASE",
    "LEAST",
    "MOST",
    "Drawn",
    "Projector",
    "ShapeMixture",
    "split",
    "temperature_at",
    "view_grid",
]

# The views a mask may have been taken from: azimuths times elevations, or rotations spread over SO(3).

AZIMUTHS = 24
"""Of the first shapes; later ones are seen from twice as many."""
_ROTATIONS = 192
_ELEVATION_STEPS = (-1.25, 0.0, 1.25)
"""Elevations, in standard deviations from their mean."""


@dataclass(frozen=True)
class _ViewGrid:
    """Views, how likely each is before a mask was looked at, and which of them need be drawn.

    Of shapes that are their own mirror image half the silhouettes are the other half's mirror images.
    """

    views: Float[Tensor, "views 3 3"]
    """Rotations from the shape's own frame to the camera's."""
    log_prior: Float[Tensor, " views"]
    azimuth: Int[Tensor, " views"]
    """Which azimuth a view has: all are as likely."""
    drawn: Int[Tensor, " drawn"]
    """The views that are drawn."""
    mirrored: Int[Tensor, " drawn"] | None
    """For each of those the view that sees its mirror image; None: all views are drawn."""

    @property
    def azimuths(self) -> int:
        """How many azimuths there are."""
        return int(self.azimuth.max()) + 1

    def for_all_views(self, drawn: Tensor, other: Tensor | None = None) -> Tensor:
        """Return for every view (shapes views ...) what is known of those drawn (shapes drawn ...).

        ``other`` is what their mirror images have, where that is not the same.
        """
        if self.mirrored is None:
            return drawn
        every = drawn.new_empty(len(drawn), len(self.views), *drawn.shape[2:])
        every[:, self.mirrored] = drawn if other is None else other
        every[:, self.drawn] = drawn
        return every


def view_grid(settings: ShapeSettings, azimuths: int = AZIMUTHS) -> _ViewGrid:
    """Return the grid of views: about gravity with the elevations that cameras are said to have, or any."""
    if not settings.gravity:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            views = _spread_out(random_rotations(8 * _ROTATIONS), _ROTATIONS)
        count = torch.arange(len(views))
        return _ViewGrid(views, torch.zeros(len(views)), count, count, None)
    mean, sd = (math.radians(angle) for angle in settings.elevation_deg)
    steps = torch.tensor(_ELEVATION_STEPS if sd > math.radians(2) else (0.0,))
    turns = (torch.arange(azimuths) + 0.5) / azimuths * 2 * math.pi - math.pi
    azimuth = torch.arange(azimuths).repeat_interleave(len(steps))
    step = steps.repeat(azimuths)
    tilt = mean + sd * step
    views = views_about_gravity(torch.zeros_like(tilt), turns[azimuth], tilt)
    every = torch.arange(len(views))
    drawn, mirrored = every, None
    if settings.symmetric and azimuths % 2 == 0:
        drawn = every[: len(every) // 2]
        mirrored = every.view(azimuths, len(steps)).flip(0).flatten()[: len(drawn)]
    return _ViewGrid(views, -0.18 * step**2, azimuth, drawn, mirrored)


def _spread_out(rotations: Tensor, count: int) -> Tensor:
    """Return ``count`` of ``rotations``, each as far as can be from those before it."""
    flat = rotations.flatten(1)
    chosen = [0]
    nearest = flat @ flat[0]
    for _ in range(count - 1):
        chosen.append(int(nearest.argmin()))
        nearest = torch.maximum(nearest, flat @ flat[chosen[-1]])
    return rotations[chosen]


# From density grids to silhouettes: points along the rays of a camera, and the sparse matrix that sums along them.

BASE = 0.62
"""Scale at which silhouettes are drawn: the whole cube of a shape stays inside the image."""
_DEEP = 1.45
"""Half the depth that is looked through, in units of the own frame."""


def _rays(side: int, steps: int, distance: float) -> Tensor:
    """Return points (steps * side * side, 3) of the camera's frame along the rays of an image, in own units."""
    at = (2 * torch.arange(side) + 1) / side - 1
    z = ((2 * torch.arange(steps) + 1) / steps - 1) * _DEEP
    z, y, x = torch.meshgrid(z, at / BASE, at / BASE, indexing="ij")
    return torch.stack([x * (1 + z / distance), y * (1 + z / distance), z], -1).reshape(-1, 3)


def _corner_weights(points: Tensor, resolution: int) -> tuple[Tensor, Tensor]:
    """Return voxels (points 8) and weights (points 8) of trilinear sampling; weight 0 outside the grid."""
    place = ((points + 1) * resolution - 1) / 2
    low = place.floor()
    part = place - low
    voxels, weights = [], []
    for corner in range(8):
        step = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2 & 1], dtype=points.dtype)
        at = low + step
        weight = torch.where(step > 0, part, 1 - part).prod(-1)
        inside = ((at >= 0) & (at < resolution)).all(-1)
        x, y, z = at.clamp(0, resolution - 1).long().unbind(-1)
        voxels.append((z * resolution + y) * resolution + x)
        weights.append(weight * inside)
    return torch.stack(voxels, -1), torch.stack(weights, -1)


class _Sum(torch.autograd.Function):
    """A sparse matrix times a dense one; its gradient by the transposed matrix, made once."""

    @staticmethod
    def forward(context, dense, matrix, transposed):
        """Return the product."""
        context.transposed = transposed
        return torch.sparse.mm(matrix, dense)

    @staticmethod
    def backward(context, gradient):
        """Return the gradient of the dense factor."""
        return torch.sparse.mm(context.transposed, gradient.contiguous()), None, None


class Projector:
    """Silhouettes of many shapes from fixed views, each view one sparse product.

    What hides the light is the root of the summed squares of density along a ray: four voxels of haze hide
    twice what one does, not four times, so that haze is no cheap way to be opaque. A sum over voxels and one
    function of it is all a silhouette is, so that the matrix of a fixed view is made once.
    """

    def __init__(self, views: Float[Tensor, "views 3 3"], *, resolution: int, side: int, distance: float):
        self.resolution, self.side, self.device = resolution, side, views.device
        camera = _rays(side, side, distance)
        pixel = torch.arange(side * side).repeat(side)
        # Steps of depth count as their length in voxels.
        length = (2 * _DEEP / side) / (2 / resolution)
        self._views = [self._matrices(camera @ view.cpu(), pixel, length) for view in views]
        self.to(views.device)

    def _matrices(self, points: Tensor, pixel: Tensor, length: float) -> tuple[Tensor, Tensor]:
        """Return the matrix from voxels to pixels and its transpose, with small indices."""
        voxel, weight = _corner_weights(points, self.resolution)
        kept = weight > 1e-3
        index = (pixel[:, None].expand_as(voxel)[kept].numpy(), voxel[kept].numpy())
        size = (self.side**2, self.resolution**3)
        matrix = coo_array(((weight[kept] * length).numpy(), index), shape=size).tocsr()
        return _compressed(matrix), _compressed(matrix.T.tocsr())

    def __len__(self) -> int:
        return len(self._views)

    def to(self, device: torch.device | str) -> Projector:
        """Move the matrices."""
        self.device = torch.device(device)
        self._views = [(matrix.to(device), turned.to(device)) for matrix, turned in self._views]
        return self

    def __deepcopy__(self, memo: object) -> Projector:
        """Return itself: nothing trains the matrices, and copies of a mixture see the same views."""
        return self

    def __call__(
        self, density: Float[Tensor, "shapes depth height width"], rows: Sequence[int] | None = None
    ) -> Float[Tensor, "shapes views side side"]:
        """Return how much light each pixel loses, 0..1, from every view or those of ``rows``; ``density`` is per voxel."""
        flat = density.reshape(len(density), -1).T.contiguous().square()
        chosen = self._views if rows is None else [self._views[row] for row in rows]
        passed = torch.stack([_Sum.apply(flat, *matrices).T for matrices in chosen], 1)
        return 1 - torch.exp(-passed.clamp_min(1e-12).sqrt().unflatten(-1, (self.side, self.side)))


def _compressed(matrix: csr_array) -> Tensor:
    """Return a torch tensor with small indices: they take less memory than the weights."""
    parts = [torch.from_numpy(np.asarray(part)) for part in (matrix.indptr, matrix.indices, matrix.data)]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(parts[0].int(), parts[1].int(), parts[2], matrix.shape, check_invariants=False)


# `ShapeMixture`: a few shapes of one kind of object that explain masks, each from every view.

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
    """Both before they were cut out, in half sides at the scale of `uplift.models.mixture.BASE`."""


class ShapeMixture(nn.Module):
    """Occupancy grids of shapes, and how well each explains a mask from each view.

    A mask and a silhouette are compared as crops of the same centroid and the same spread along x and y
    (`uplift.data.tensors`), so that a shape explains others of other proportions; how the two spreads
    compare is a term of its own. The likelihood of a mask sums over shapes and views: which view it is
    need never be decided while it is not known.
    """

    def __init__(self, settings: ShapeSettings, parts: int | None = None, azimuths: int = AZIMUTHS):
        super().__init__()
        self.settings = settings
        self.grid: _ViewGrid = view_grid(settings, azimuths)
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


def temperature_at(done: float, start: float, end: float) -> float:
    """Return the temperature after a share ``done`` of the stage: it falls to ``end`` over four fifths of it."""
    return start * math.exp(math.log(end / start) * min(1.0, done / 0.8))


# Finer mixtures: every shape becomes several that begin nearly alike and grow apart.

_NOISE = 0.7
"""Standard deviation of what is added to the logits: enough for two copies to explain other masks."""
_COARSE = 8


def split(mixture: ShapeMixture, times: int, azimuths: int) -> ShapeMixture:
    """Return a mixture of ``times`` as many shapes, each one of ``mixture`` with some smooth noise.

    Views are known by then, so a shape of few masks is found at once. ``azimuths`` is how many views there are
    around the finer shapes, a multiple of those so far; shapes that are seen from anywhere keep theirs.
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
