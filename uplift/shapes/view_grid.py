"""The views a mask may have been taken from: azimuths times elevations, or rotations spread over SO(3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from uplift.config import ShapeSettings
from uplift.views import random_rotations, views_about_gravity

__all__ = ["AZIMUTHS", "ViewGrid", "view_grid"]

AZIMUTHS = 24
"""Of the first shapes; later ones are seen from twice as many."""
_ROTATIONS = 192
_ELEVATION_STEPS = (-1.25, 0.0, 1.25)
"""Elevations, in standard deviations from their mean."""


@dataclass(frozen=True)
class ViewGrid:
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

    def whole(self, drawn: Tensor, other: Tensor | None = None) -> Tensor:
        """Return for every view (shapes views ...) what is known of those drawn (shapes drawn ...).

        ``other`` is what their mirror images have, where that is not the same.
        """
        if self.mirrored is None:
            return drawn
        every = drawn.new_empty(len(drawn), len(self.views), *drawn.shape[2:])
        every[:, self.mirrored] = drawn if other is None else other
        every[:, self.drawn] = drawn
        return every


def view_grid(settings: ShapeSettings, azimuths: int = AZIMUTHS) -> ViewGrid:
    """Return the grid of views: about gravity with the elevations that cameras are said to have, or any."""
    if not settings.gravity:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            views = _spread_out(random_rotations(8 * _ROTATIONS), _ROTATIONS)
        count = torch.arange(len(views))
        return ViewGrid(views, torch.zeros(len(views)), count, count, None)
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
    return ViewGrid(views, -0.18 * step**2, azimuth, drawn, mirrored)


def _spread_out(rotations: Tensor, count: int) -> Tensor:
    """Return ``count`` of ``rotations``, each as far as can be from those before it."""
    flat = rotations.flatten(1)
    chosen = [0]
    nearest = flat @ flat[0]
    for _ in range(count - 1):
        chosen.append(int(nearest.argmin()))
        nearest = torch.maximum(nearest, flat @ flat[chosen[-1]])
    return rotations[chosen]
