"""`Views`, how lifted poses are turned before priors judge them: the cameras of `views`, or a user's own class."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.config.plugins import blame, build
from uplift.config.ranks import drawn, gathered, own_numbers
from uplift.config.settings import ViewSettings
from uplift.errors import UserError
from uplift.geometry.rotation import random_rotations, views_about_gravity
from uplift.models.lifter import Lifted
from uplift.skeleton import Skeleton

__all__ = ["RandomViews", "ViewFunction", "Views", "build_views", "checked_view"]

ViewFunction = Callable[[Lifted], Float[Tensor, "batch 3 3"]]
"""Returns for each lifted pose the rotation from its camera frame to that of a new camera."""


class Views:
    """New cameras for lifted poses: subclass it, write ``__call__``, and name the class as ``views.use=my.py:MyViews``.

    Options are keyword arguments of ``__init__``, set below ``views.options``.

    Example::

        class Opposite(uplift.Views):
            def __call__(self, lifted):
                turn = torch.pi + 0.1 * torch.randn(len(lifted.tilt))
                return views_about_gravity(lifted.tilt, turn, lifted.tilt)
    """

    def __init__(self, skeleton: Skeleton):
        self.skeleton = skeleton

    def __call__(self, lifted: Lifted) -> Float[Tensor, "batch 3 3"]:
        """Return for each pose the rotation from its camera frame (x right, y down, z away) to that of a new camera."""
        raise NotImplementedError(f"{type(self).__name__} has no __call__(self, lifted)")


class RandomViews(Views):
    """Random azimuths about gravity with the tilts of `ViewSettings.elevation`; uniform on SO(3) without gravity."""

    def __init__(self, skeleton: Skeleton, settings: ViewSettings):
        super().__init__(skeleton)
        self.settings = settings

    def __call__(self, lifted: Lifted) -> Float[Tensor, "batch 3 3"]:
        """Return a random rotation for each pose, with torch's global random numbers."""
        count, device = len(lifted.tilt), lifted.tilt.device
        if not self.skeleton.gravity:
            return random_rotations(count, device)
        low, high = (torch.pi / 180 * angle for angle in self.settings.azimuth_deg)
        azimuth = low + (high - low) * drawn(count, partial(torch.rand, device=device))
        new_tilt = lifted.tilt
        if self.settings.elevation == "batch":
            # the tilts of the batch (ElePose, Wandt et al. 2022), with gradients to both
            new_tilt = gathered(lifted.tilt)[drawn(count, partial(torch.randperm, device=device))]
        elif self.settings.elevation == "normal":
            tilts = gathered(lifted.tilt)
            new_tilt = tilts.mean() + tilts.std() * drawn(count, partial(torch.randn, device=device))
        return views_about_gravity(lifted.tilt, azimuth, new_tilt)


def build_views(settings: ViewSettings, skeleton: Skeleton) -> ViewFunction:
    """Return the views that ``settings`` name; raises UserError for an unknown class or option."""
    if settings.use is None:
        if settings.options:
            raise UserError("views.options are those of a class of your own: set views.use=file.py:Class.")
        return RandomViews(skeleton, settings)
    return build(settings.use, {}, settings.options, "views.options", Views, setting="views.use", skeleton=skeleton)


def checked_view(views: ViewFunction, lifted: Lifted) -> Float[Tensor, "batch 3 3"]:
    """Return the views of a batch; raises UserError where a user's function fails or gives no rotations."""
    if isinstance(views, RandomViews):
        return views(lifted)
    with blame("views: __call__", type(views)), own_numbers():
        found = views(lifted)
    expected = (len(lifted.tilt), 3, 3)
    if not isinstance(found, Tensor) or found.shape != expected:
        shape = f"shape {tuple(found.shape)}" if isinstance(found, Tensor) else type(found).__name__
        raise UserError(f"views: found {shape}, expected rotations of shape {expected}, one for each pose.")
    with torch.no_grad():
        off = (found @ found.mT - torch.eye(3).to(found)).abs().amax()
        if not math.isfinite(float(off)) or off > 1e-3 or bool((torch.linalg.det(found.float()) < 0).any()):
            raise UserError("views: found matrices that are not rotations (R R^T = 1, determinant 1).")
    return found
