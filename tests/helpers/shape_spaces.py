"""Small spaces of shapes that are known: simulated chairs in the decoder, and an encoder that compares templates."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from shape_mixtures import chair
from torch import Tensor
from torch.nn.functional import interpolate

from uplift.config.settings import ShapeSettings
from uplift.data.masks import FILL
from uplift.geometry.voxels import coverage
from uplift.models.shape_space import ShapeSpace
from uplift.models.silhouettes import ObjectPose, silhouettes

__all__ = ["SPACE", "KnownShapes", "grids_of", "known_space", "smooth_density", "tiny_space"]

SPACE: dict[str, Any] = {
    "detail": 16, "code": 1, "hidden": 2, "pixels": 16, "resolution": 16, "elevation_deg": (20.0, 4.0)
}  # fmt: skip


def tiny_space(seed: int = 0, detail: int | None = None, **more: Any) -> ShapeSpace:
    """Return an untrained space whose shapes differ much from code to code."""
    torch.manual_seed(seed)
    space = ShapeSpace(ShapeSettings(**{**SPACE, "detail": 8, "code": 3, "hidden": 8, **more}), detail)
    torch.nn.init.normal_(space.last.weight, std=2.0)
    return space.eval().requires_grad_(False)


def smooth_density(resolution: int, seed: int = 0, *, dtype: torch.dtype = torch.float32) -> Tensor:
    """Return a density (1 depth height width) of a few wide blobs, not symmetric, well inside of the grid."""
    stream = np.random.default_rng(seed)
    at = (2 * np.arange(resolution) + 1) / resolution - 1
    z, y, x = np.meshgrid(at, at, at, indexing="ij")
    total = np.zeros_like(x)
    for _ in range(4):
        cx, cy, cz = stream.uniform(-0.3, 0.3, 3)
        total += stream.uniform(1, 3) * np.exp(-((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2) / (2 * 0.17**2))
    return torch.from_numpy(total)[None].to(dtype)


def grids_of(seeds: tuple[int, ...], detail: int) -> Tensor:
    """Return logits (shapes depth height width) of chairs."""
    covered = [torch.from_numpy(np.ascontiguousarray(coverage(chair(seed), detail))) for seed in seeds]
    return ((torch.stack(covered).float() - 0.3) * 14).clamp(-6, 3)


class KnownShapes(ShapeSpace):
    """Two known shapes at the codes -1 and 1; views are found by comparing masks with silhouettes, scale by their boxes.

    Nothing is trained: what is lifted with it is as good as the lifting.
    """

    _SCALE = 0.55

    def __init__(self, settings: ShapeSettings, seeds: tuple[int, int] = (0, 4)):
        super().__init__(settings)
        grids = grids_of(seeds, settings.detail)
        half = grids[..., settings.detail // 2 :] if settings.symmetric else grids
        low, high = half.flatten(1)
        mean = (low + high) / 2
        with torch.no_grad():
            for layer, weight in ((self.decoder[0], [[1.0], [-1.0]]), (self.decoder[2], [[1.0, 0.0], [0.0, 1.0]])):
                layer.weight.copy_(torch.tensor(weight))  # type: ignore[union-attr, operator]
                layer.bias.zero_()  # type: ignore[union-attr, operator]
            self.last.weight.copy_(torch.stack([high - mean, low - mean], 1))
            self.last.bias.copy_(mean)
        self.eval().requires_grad_(False)
        count = len(self.views)
        scale = torch.full((count,), self._SCALE)
        pose = ObjectPose(*self.views.unbind(1), scale, torch.zeros(count, 2))
        density = torch.nn.functional.softplus(grids) * 1.3
        drawn = [
            silhouettes(one[None].expand(count, -1, -1, -1), pose, 32, settings.distance, rolls=self.rolls)
            for one in density
        ]
        boxes = [_boxed(one) for one in drawn]
        self.templates = torch.stack([image for image, _, _ in boxes], 1).flatten(2)
        self.factor = torch.stack([factor for _, factor, _ in boxes], 1).mean(1)
        self.middle = torch.stack([middle for _, _, middle in boxes], 1).mean(1)

    def features(self, masks: Tensor) -> Tensor:
        """Return the pixels."""
        return interpolate(masks[:, None], (32, 32), mode="area")[:, 0].flatten(1)

    def view_logits(self, features: Tensor) -> Tensor:
        """Return how like the mask the better template of each view is."""
        unlike = (features[:, None, None] - self.templates[None]).square().mean(-1)
        return (-unlike / 0.01).amax(2)

    def placed(self, features: Tensor, azimuth: Tensor, elevation: Tensor, roll: Tensor) -> ObjectPose:
        """Return where the templates stand once they are cut out as masks are."""
        count = len(azimuth)
        guess = ObjectPose(azimuth, elevation, roll, torch.ones(count), torch.zeros(count, 2))
        nearest = (guess.view.flatten(1) @ self.view_matrices.flatten(1).T).argmax(1)
        factor = self.factor[nearest]
        return guess._replace(scale=self._SCALE * factor, offset=-self.middle[nearest] * factor[:, None])

    def encode(self, features: Tensor, pose: ObjectPose) -> tuple[Tensor, Tensor]:
        """Return that nothing is known of the code."""
        code = torch.zeros(len(features), 1)
        return code, code - 3


def _boxed(image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return silhouettes cut out as masks are, how much larger they are then, and where their middle was."""
    side, cut, factors, middles = image.shape[-1], [], [], []
    at = (2 * torch.arange(side) + 1) / side - 1
    for one in image:
        low, high = zip(
            *((at[rows][0], at[rows][-1]) for rows in ((one > 0.4).any(0), (one > 0.4).any(1))), strict=True
        )
        low, high = torch.stack(low), torch.stack(high)
        half, middle = (high - low).max() / 2 / FILL, (low + high) / 2
        y, x = torch.meshgrid(at * half + middle[1], at * half + middle[0], indexing="ij")
        cut.append(torch.nn.functional.grid_sample(one[None, None], torch.stack([x, y], -1)[None], align_corners=False))
        factors.append(1 / half)
        middles.append(middle)
    return torch.cat(cut)[:, 0], torch.stack(factors), torch.stack(middles)


def known_space(**more: Any) -> KnownShapes:
    """Return a space of two known chairs."""
    return KnownShapes(ShapeSettings(**{**SPACE, **more}))
