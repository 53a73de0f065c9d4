"""Differentiable silhouettes of density grids from any view, each grid from its own."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import grid_sample

from uplift.geometry.rotation import about_y, about_z, level

__all__ = ["DENSITY", "ObjectPose", "angles_of", "silhouettes", "view_of"]

DENSITY = 1.3
"""Density of a voxel per nat of its logit: a full one is nearly opaque."""
_REACH = 1.1
"""Half the depth that rays are sampled over, in units of the shape frame."""
_LENGTH = 16.0
"""Lengths along a ray count in voxels of a grid of 32, so that opacity does not depend on the resolution."""


class ObjectPose(NamedTuple):
    """Where shapes stand before the camera, as `uplift.data.masks.Placed` has it, with its angles in radians.

    The view is a turn about gravity (azimuth), then a camera that looks down (elevation) and leans (roll).
    """

    azimuth: Float[Tensor, " items"]
    elevation: Float[Tensor, " items"]
    roll: Float[Tensor, " items"]
    scale: Float[Tensor, " items"]
    """Half sides of the crop per unit of the shape."""
    offset: Float[Tensor, "items 2"]

    @property
    def view(self) -> Float[Tensor, "items 3 3"]:
        """Rotations from the shape frame to the camera's."""
        return view_of(self.azimuth, self.elevation, self.roll)

    @property
    def mirrored(self) -> ObjectPose:
        """The pose at which a shape that is its own mirror image has the mirror image of this silhouette."""
        flip = self.offset.new_tensor([-1.0, 1.0])
        return self._replace(azimuth=-self.azimuth, roll=-self.roll, offset=self.offset * flip)

    def pick(self, rows: Tensor | slice) -> ObjectPose:
        """Return some of the items."""
        return ObjectPose(*(part[rows] for part in self))

    @classmethod
    def of(
        cls, view: Float[Tensor, "items 3 3"], scale: Float[Tensor, " items"], offset: Float[Tensor, "items 2"]
    ) -> ObjectPose:
        """Return the pose of rotations."""
        return cls(*angles_of(view), scale, offset)

    @classmethod
    def where(cls, rows: Bool[Tensor, " items"], one: ObjectPose, other: ObjectPose) -> ObjectPose:
        """Return ``one`` for some of the items, ``other`` for the rest."""
        pairs = zip(one, other, strict=True)
        return cls(*(torch.where(rows if a.ndim == 1 else rows[:, None], a, b) for a, b in pairs))

    def detached(self) -> ObjectPose:
        """Return the same pose without gradient."""
        return ObjectPose(*(part.detach() for part in self))


def view_of(
    azimuth: Float[Tensor, " items"], elevation: Float[Tensor, " items"], roll: Float[Tensor, " items"]
) -> Float[Tensor, "items 3 3"]:
    """Return rotations from the shape frame to the camera's: the inverse of `angles_of`."""
    return about_z(roll) @ level(elevation).mT @ about_y(azimuth)


def angles_of(view: Float[Tensor, "items 3 3"]) -> tuple[Tensor, Tensor, Tensor]:
    """Return azimuth, elevation and roll of views; the inverse of `ObjectPose.view`, elevation within a quarter turn."""
    elevation = torch.asin(view[:, 2, 1].clamp(-1, 1))
    azimuth = torch.atan2(-view[:, 2, 0], view[:, 2, 2])
    roll = torch.atan2(-view[:, 0, 1], view[:, 1, 1])
    return azimuth, elevation, roll


def silhouettes(
    density: Float[Tensor, "items depth height width"], pose: ObjectPose, side: int, distance: float, *, rolls: bool
) -> Float[Tensor, "items side side"]:
    """Return the opacity of each pixel, 0..1, of grids in their poses, in exact perspective.

    A rotation and a perspective are three resamplings of planes: slices turn about gravity, then columns are cut along
    tilted, converging lines, then rows; bilinear each, which costs a quarter of sampling along rays in 3D. The opacity
    of a ray is 1 - exp(-d), d the root of the sum of squared densities along it (`uplift.models.projector.Projector`).

    Args:
        density: of voxels, in the shape frame; 0 outside of the grid.
        pose: of each.
        side: pixels along the crop; rays have a tenth more samples.
        distance: of the camera, in units of the shape frame.
        rolls: whether any pose leans; the image then turns about the crop's middle at the end.
    """
    steps = math.ceil(_REACH * side)
    turned = _about_gravity(density, pose.azimuth)
    offset = pose.offset
    if rolls:
        offset = (about_z(-pose.roll)[:, :2, :2] @ offset[..., None])[..., 0]
    # Depths along rays in units of the shape; the image's half sides are those units times the scale.
    depth = _axis(steps, offset) * _REACH
    widen = (1 + depth / distance)[None, :, None]
    rows, columns = (
        (_axis(side, offset)[None, None] * widen - offset[:, axis, None, None]) / pose.scale[:, None, None]
        for axis in (1, 0)
    )
    seen = _along_columns(turned, pose.elevation, rows, depth)
    places = torch.stack([columns, _axis(steps, offset)[None, :, None].expand_as(columns)], -1)
    rays = grid_sample(seen.permute(0, 3, 2, 1), places, align_corners=False)  # (items, rows, steps, columns)
    thickness = rays.square().sum(2) * (2 * _REACH / steps * _LENGTH)
    image = 1 - torch.exp(-thickness.clamp_min(1e-12).sqrt())
    return _leaning(image, pose.roll) if rolls else image


def _axis(count: int, like: Tensor) -> Tensor:
    return (2 * torch.arange(count, device=like.device, dtype=like.dtype) + 1) / count - 1


def _about_gravity(density: Tensor, azimuth: Tensor) -> Float[Tensor, "items height depth width"]:
    """Return grids turned about gravity."""
    at = _axis(density.shape[-1], density)
    cos, sin = azimuth.cos()[:, None, None], azimuth.sin()[:, None, None]
    z, x = torch.meshgrid(at, at, indexing="ij")
    return grid_sample(
        density.transpose(1, 2), torch.stack([x * cos - z * sin, x * sin + z * cos], -1), align_corners=False
    )


def _along_columns(
    turned: Tensor, elevation: Tensor, rows: Float[Tensor, "items steps side"], depth: Float[Tensor, " steps"]
) -> Float[Tensor, "items width steps side"]:
    """Return densities where the rays of the image's rows are, at each depth, still in all of the grid's columns."""
    cos, sin = elevation.cos()[:, None, None], elevation.sin()[:, None, None]
    far = depth[None, :, None]
    places = torch.stack([far * cos - rows * sin, rows * cos + far * sin], -1)
    return grid_sample(turned.permute(0, 3, 1, 2), places, align_corners=False)


def _leaning(image: Tensor, roll: Tensor) -> Tensor:
    """Return images turned by ``roll`` about their middle."""
    zero = torch.zeros_like(roll)
    cos, sin = roll.cos(), roll.sin()
    turn = torch.stack([torch.stack([cos, sin, zero], -1), torch.stack([-sin, cos, zero], -1)], 1)
    places = torch.nn.functional.affine_grid(turn, [len(image), 1, *image.shape[1:]], align_corners=False)
    return grid_sample(image[:, None], places, align_corners=False)[:, 0]
