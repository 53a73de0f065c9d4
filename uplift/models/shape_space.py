"""`ShapeSpace`: a latent space of shapes: an encoder of masks seen from known views, and a decoder to occupancy grids."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from uplift.config.settings import ShapeSettings
from uplift.models.lifter import networks_precision
from uplift.models.mixture import view_grid
from uplift.models.silhouettes import DENSITY, ObjectPose, angles_of, silhouettes

__all__ = ["MASK_SIDE", "ShapeSpace"]

MASK_SIDE = 64
"""Pixels along the masks that the encoder sees."""
_CHANNELS = (24, 48, 96, 128)
_TRUNK = 256
_ANGLES = 24
_LOG_VARIANCE = (-8.0, 3.0)
_LEAST_DEVIATION = math.radians(2)
_SPAN = 0.7
"""Usual scale of a shape: half a crop's side per unit."""


class ShapeSpace(nn.Module):
    """Codes of shapes, with a prior N(0, 1), as a variational autoencoder of masks has them (Kingma and Welling 2014).

    The encoder is told from where a mask was taken, so a code says what is seen and not from where. A second head says
    from which of a grid of views a mask is likely to be, and a third where its shape then stands. The decoder is a
    perceptron whose last layer is interpolated to finer grids as the training goes on (`refine_grid`).

    Args:
        settings: symmetry, gravity, elevation, distance and the resolution ``detail`` of grids.
        detail: voxels along a grid at first; ``settings.detail`` if None.
    """

    def __init__(self, settings: ShapeSettings, detail: int | None = None):
        super().__init__()
        self.settings = settings
        steps: list[nn.Module] = []
        for before, after in zip((1, *_CHANNELS), _CHANNELS, strict=False):
            steps += [nn.Conv2d(before, after, 5 if before == 1 else 3, 2, 2 if before == 1 else 1), nn.LeakyReLU(0.1)]
        self.trunk = nn.Sequential(*steps, nn.Flatten(), nn.Linear(16 * _CHANNELS[-1], _TRUNK), nn.LeakyReLU(0.1))
        self.code_head = nn.Sequential(
            nn.Linear(_TRUNK + 9, _TRUNK), nn.LeakyReLU(0.1), nn.Linear(_TRUNK, 2 * settings.code)
        )
        self.register_buffer("views", torch.stack(_view_angles(settings), 1))
        self.view_head = nn.Sequential(nn.Linear(_TRUNK, _TRUNK), nn.LeakyReLU(0.1), nn.Linear(_TRUNK, len(self.views)))
        self.place_head = nn.Sequential(nn.Linear(_TRUNK + 9, _TRUNK), nn.LeakyReLU(0.1), nn.Linear(_TRUNK, 4))
        hidden = settings.hidden
        self.decoder = nn.Sequential(
            nn.Linear(settings.code, hidden), nn.LeakyReLU(0.1), nn.Linear(hidden, hidden), nn.LeakyReLU(0.1)
        )
        self.last = _last_layer(hidden, detail or settings.detail, settings.symmetric)
        self.register_buffer("level", torch.tensor(0.3))
        self.register_buffer("front", torch.eye(3))

    views: Tensor
    """(views, 3): azimuth, elevation and roll of the views that `view_head` chooses among."""
    level: Tensor
    """Iso threshold: the occupancy at which the surface of lifted shapes is."""
    front: Tensor
    """(3, 3): rotation from the frame that shapes are learned in to that of lifted shapes (`uplift.models.front`)."""

    @property
    def detail(self) -> int:
        """Voxels along a grid."""
        half = 1 if not self.settings.symmetric else 2
        return round((self.last.out_features * half) ** (1 / 3))

    @property
    def rolls(self) -> bool:
        """Whether views lean."""
        return not self.settings.gravity

    @property
    def view_matrices(self) -> Float[Tensor, "views 3 3"]:
        """`views` as rotations."""
        azimuth, elevation, roll = self.views.unbind(1)
        return ObjectPose(azimuth, elevation, roll, *self._unplaced(len(self.views))).view

    @property
    def view_spacing(self) -> float:
        """Radians between neighbours of `views`, about."""
        return (
            2 * math.pi / len(self.views)
            if self.settings.gravity
            else 0.8 * (8 * math.pi**2 / len(self.views)) ** (1 / 3)
        )

    def usual_elevation(self, elevation: Float[Tensor, " items"]) -> Float[Tensor, " items"]:
        """Return the elevation of `views` that is nearest: their only one with gravity."""
        return (
            torch.full_like(elevation, math.radians(self.settings.elevation_deg[0]))
            if self.settings.gravity
            else elevation
        )

    def _unplaced(self, count: int) -> tuple[Tensor, Tensor]:
        one = torch.ones(count, device=self.views.device)
        return one, one[:, None].expand(-1, 2) * 0

    def elevation_cost(self, elevation: Float[Tensor, " items"]) -> Float[Tensor, " items"]:
        """Return minus the log probability of elevations, as the settings have them; 0 without gravity."""
        if not self.settings.gravity:
            return torch.zeros_like(elevation)
        mean, deviation = (math.radians(angle) for angle in self.settings.elevation_deg)
        return 0.5 * ((elevation - mean) / max(deviation, _LEAST_DEVIATION)).square()

    def features(self, masks: Float[Tensor, "items side side"]) -> Float[Tensor, "items features"]:
        """Return what all heads are computed from; ``masks`` are 0..1."""
        if masks.shape[-1] != MASK_SIDE:
            masks = nn.functional.interpolate(masks[:, None], (MASK_SIDE, MASK_SIDE), mode="area")[:, 0]
        with networks_precision(masks.device):
            return self.trunk(masks[:, None] * 2 - 1).float()

    def encode(
        self, features: Float[Tensor, "items features"], pose: ObjectPose
    ) -> tuple[Float[Tensor, "items code"], Float[Tensor, "items code"]]:
        """Return mean and log variance of the code of masks seen from ``pose``."""
        with networks_precision(features.device):
            found = self.code_head(torch.cat([features, pose.view.flatten(1)], 1)).float()
        mean, log_variance = found.chunk(2, 1)
        return mean, log_variance.clamp(*_LOG_VARIANCE)

    def view_logits(self, features: Float[Tensor, "items features"]) -> Float[Tensor, "items views"]:
        """Return how likely each of `views` is."""
        with networks_precision(features.device):
            return self.view_head(features).float()

    def placed(
        self, features: Float[Tensor, "items features"], azimuth: Tensor, elevation: Tensor, roll: Tensor
    ) -> ObjectPose:
        """Return the pose at views of these angles: the elevation as corrected, where there is gravity, scale and offset."""
        guess = ObjectPose(azimuth, elevation, roll, *self._unplaced(len(features)))
        with networks_precision(features.device):
            found = self.place_head(torch.cat([features, guess.view.flatten(1)], 1)).float()
        raised = elevation + found[:, 0] * 0.3 if self.settings.gravity else elevation
        return guess._replace(
            elevation=raised, scale=_SPAN * found[:, 1].clamp(-1.5, 2).exp(), offset=0.3 * found[:, 2:]
        )

    def logits(self, code: Float[Tensor, "items code"]) -> Float[Tensor, "items depth height width"]:
        """Return grids of logits of occupancy, both halves of shapes that are their own mirror image."""
        with networks_precision(code.device):
            flat = self.last(self.decoder(code)).float()
        n = self.detail
        grid = flat.view(len(code), n, n, -1)
        return torch.cat([grid.flip(-1), grid], -1) if self.settings.symmetric else grid

    def seen(
        self, logits: Float[Tensor, "items depth height width"], pose: ObjectPose, side: int
    ) -> Float[Tensor, "items side side"]:
        """Return the silhouettes of grids of logits in their poses."""
        density = nn.functional.softplus(logits) * DENSITY
        return silhouettes(density, pose, side, self.settings.distance, rolls=self.rolls)

    @torch.no_grad()
    def refine_grid(self, detail: int) -> None:
        """Interpolate the decoder's last layer to a grid of ``detail`` voxels: the same shapes, finer."""
        if detail == self.detail:
            return
        n, last = self.detail, self.last
        both = torch.cat([last.weight, last.bias[:, None]], 1).view(n, n, -1, last.in_features + 1).permute(3, 0, 1, 2)
        if self.settings.symmetric:
            both = torch.cat([both.flip(-1), both], -1)
        finer = nn.functional.interpolate(both[None], (detail,) * 3, mode="trilinear")[0]
        finer = finer[..., detail // 2 :] if self.settings.symmetric else finer
        finer = finer.permute(1, 2, 3, 0).reshape(-1, last.in_features + 1)
        self.last = nn.Linear(last.in_features, len(finer)).to(finer)
        self.last.weight.copy_(finer[:, :-1])
        self.last.bias.copy_(finer[:, -1])


def _view_angles(settings: ShapeSettings) -> tuple[Tensor, Tensor, Tensor]:
    """Return the angles of the views that a mask is first thought to be from: one elevation with gravity, else SO(3)."""
    grid = view_grid(settings, _ANGLES)
    azimuth, elevation, roll = angles_of(grid.views)
    middle = grid.log_prior == grid.log_prior.max() if settings.gravity else slice(None)
    return azimuth[middle], elevation[middle], roll[middle]


def _last_layer(hidden: int, detail: int, symmetric: bool) -> nn.Linear:
    """Return a layer whose first shapes are soft balls, all nearly the same."""
    last = nn.Linear(hidden, detail**3 // (2 if symmetric else 1))
    nn.init.normal_(last.weight, std=0.02)
    at = (2 * torch.arange(detail) + 1) / detail - 1
    z, y, x = torch.meshgrid(at, at, at[detail // 2 :] if symmetric else at, indexing="ij")
    with torch.no_grad():
        last.bias.copy_((1 - 3 * (x**2 + y**2 + z**2).sqrt()).flatten())
    return last
