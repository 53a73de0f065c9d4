"""Masks with exact truth: shapes seen by cameras drawn from a distribution of views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from uplift.errors import UserError
from uplift.masks.container import MaskData
from uplift.masks.render import render_masks
from uplift.meshes.mesh import Mesh
from uplift.meshes.procedural import make_shapes
from uplift.views import about_y, level, random_rotations

__all__ = ["ViewChoice", "draw_views", "simulate_masks"]


@dataclass(frozen=True)
class ViewChoice:
    """From where the cameras look: ranges in degrees, and distances in the shapes' own unit."""

    azimuth_deg: tuple[int | float, int | float] = (-180.0, 180.0)
    """Uniform; 0 is from in front."""
    elevation_deg: tuple[int | float, int | float] = (-10.0, 60.0)
    """How far down cameras look."""
    elevation_mean_deg: int | float | None = 15.0
    """Normal about this, within the range; None: uniform over the range."""
    elevation_sd_deg: int | float = 10.0
    upright: bool = True
    """Off: uniform over all rotations, and the angles above do not count."""
    distance: tuple[int | float, int | float] = (4.0, 8.0)
    """Uniform; infinite: parallel rays."""

    def __post_init__(self) -> None:
        for name in ("azimuth_deg", "elevation_deg", "distance"):
            low, high = getattr(self, name)
            if not low <= high:
                raise UserError(f"views: {name} goes from {low:g} to {high:g}, expected the lower number first.")
        if max(np.abs(self.elevation_deg)) > 90:
            raise UserError(f"views: elevation_deg is {self.elevation_deg}, expected -90 to 90.")
        if self.distance[0] < 2:
            raise UserError(
                f"views: distance starts at {self.distance[0]:g}, expected 2 or more: "
                "a shape reaches to 0.9 along each axis, and the camera must stay outside."
            )
        if self.elevation_sd_deg < 0:
            raise UserError(f"views: elevation_sd_deg is {self.elevation_sd_deg:g}, expected 0 or more.")


def draw_views(count: int, views: ViewChoice, seed: int) -> tuple[
    Float[np.ndarray, "count 3 3"], Float[np.ndarray, " count"]
]:  # fmt: skip
    """Return rotations from the own frame to the cameras', and the cameras' distances in own units."""
    rng = np.random.default_rng((seed, 1))
    low, high = views.distance
    distance = np.full(count, np.inf) if math.isinf(high) else rng.uniform(low, high, count)
    if not views.upright:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            return random_rotations(count).numpy().astype(np.float64), distance
    azimuth = np.deg2rad(rng.uniform(*views.azimuth_deg, count))
    low, high = views.elevation_deg
    if views.elevation_mean_deg is None:
        elevation = rng.uniform(low, high, count)
    else:
        elevation = np.clip(rng.normal(views.elevation_mean_deg, views.elevation_sd_deg, count), low, high)
    tilt = torch.from_numpy(np.deg2rad(elevation))
    return (level(tilt).mT @ about_y(torch.from_numpy(azimuth))).numpy(), distance


def simulate_masks(
    meshes: Sequence[Mesh] | str,
    items: int,
    *,
    seed: int,
    side: int = 64,
    views: ViewChoice | None = None,
    views_per_shape: int = 1,
) -> MaskData:
    """Return masks of shapes, with the truth beside them; the same for the same seed.

    ``meshes`` are shapes in their own frame and unit, gone through in turn, or the name of a family that
    shapes are made up from: one for every ``views_per_shape`` items.

    Raises:
        UserError: no such family, no meshes, no items, an absurd side.
    """
    if items < 1 or views_per_shape < 1:
        raise UserError(f"{items} masks of {views_per_shape} views a shape asked for, expected 1 or more of each.")
    if not 8 <= side <= 1024:
        raise UserError(f"Masks of {side} x {side} pixels asked for, expected 8 to 1024.")
    if not len(meshes):
        raise UserError("No meshes to draw masks of.")
    shapes = make_shapes(meshes, -(-items // views_per_shape), seed) if isinstance(meshes, str) else meshes
    shape = (np.arange(items) // views_per_shape) % len(shapes)
    view, distance = draw_views(items, views or ViewChoice(), seed)
    masks, truth = render_masks(shapes, shape, view, distance, side)
    names = [shapes[number].name or f"shape-{number}" for number in shape.tolist()]
    return MaskData(
        masks=masks,
        names=[f"{name}:{item}" for item, name in enumerate(names)],
        centre_px=np.full((items, 2), side / 2, np.float32),
        scale_px=np.full(items, side / 2, np.float32),
        category=np.array([shapes[number].category for number in shape.tolist()]),
        truth=truth,
        source=meshes if isinstance(meshes, str) else "meshes",
    )
