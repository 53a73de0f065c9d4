"""The views a mask may have been taken from: azimuths times elevations, or rotations spread over SO(3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from uplift.config import ShapeSettings
from uplift.views import random_rotations, views_about_gravity

__all__ = ["ViewGrid", "view_grid"]

_AZIMUTHS = 24
_ROTATIONS = 192
_ELEVATION_STEPS = (-1.25, 0.0, 1.25)
"""Elevations, in standard deviations from their mean."""


@dataclass(frozen=True)
class ViewGrid:
    """Views and how likely each is before a mask was looked at."""

    views: Float[Tensor, "views 3 3"]
    """Rotations from the shape's own frame to the camera's."""
    log_prior: Float[Tensor, " views"]
    azimuth: Int[Tensor, " views"]
    """Which azimuth a view has: all are as likely."""
    tilt: Float[Tensor, " views"]
    """How far down the camera looks, radians."""

    @property
    def azimuths(self) -> int:
        """How many azimuths there are."""
        return int(self.azimuth.max()) + 1


def view_grid(settings: ShapeSettings) -> ViewGrid:
    """Return the grid of views: about gravity with the elevations that cameras are said to have, or any."""
    if not settings.gravity:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            views = _spread_out(random_rotations(8 * _ROTATIONS), _ROTATIONS)
        return ViewGrid(views, torch.zeros(len(views)), torch.arange(len(views)), torch.zeros(len(views)))
    mean, sd = (math.radians(angle) for angle in settings.elevation_deg)
    steps = torch.tensor(_ELEVATION_STEPS if sd > math.radians(2) else (0.0,))
    turns = (torch.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS * 2 * math.pi - math.pi
    azimuth = torch.arange(_AZIMUTHS).repeat_interleave(len(steps))
    step = steps.repeat(_AZIMUTHS)
    tilt = mean + sd * step
    views = views_about_gravity(torch.zeros_like(tilt), turns[azimuth], tilt)
    return ViewGrid(views, -0.18 * step**2, azimuth, tilt)


def _spread_out(rotations: Tensor, count: int) -> Tensor:
    """Return ``count`` of ``rotations``, each as far as can be from those before it."""
    flat = rotations.flatten(1)
    chosen = [0]
    nearest = flat @ flat[0]
    for _ in range(count - 1):
        chosen.append(int(nearest.argmin()))
        nearest = torch.maximum(nearest, flat @ flat[chosen[-1]])
    return rotations[chosen]
