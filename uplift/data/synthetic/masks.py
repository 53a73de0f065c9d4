"""Masks with exact truth: synthetic or given shapes seen by cameras drawn from a distribution of views."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8

from uplift.config.progress import progress
from uplift.data.masks import FILL, MaskData, Placed
from uplift.data.parsers.files import refuse_more_than_memory
from uplift.data.synthetic.animals import animal
from uplift.data.synthetic.furniture import armchair, bed, bench, cabinet, chair, desk, shelf, sofa, stool, table
from uplift.data.synthetic.vehicles import bus, car, lorry, pickup, tractor, van
from uplift.errors import UserError, did_you_mean
from uplift.geometry.mesh import Mesh
from uplift.geometry.rotation import about_y, level, random_rotations
from uplift.geometry.silhouette import draw_mask, project

__all__ = [
    "FAMILIES",
    "ViewChoice",
    "draw_views",
    "frame_mesh",
    "make_shape",
    "make_shapes",
    "render_masks",
    "simulate_masks",
]

_BYTES_A_SHAPE = 30_000
"""Of a simulated mesh, about."""
_Kind = Callable[[np.random.Generator], Mesh]

_SEATS: dict[_Kind, float] = {chair: 5, armchair: 2, sofa: 2, bench: 1.5, stool: 1.5}
FAMILIES: dict[str, dict[_Kind, float]] = {
    "furniture": {**_SEATS, table: 3, desk: 1, bed: 1.5, shelf: 1, cabinet: 1.5},
    "vehicles": {car: 6, van: 1.5, pickup: 1.5, bus: 1, lorry: 2, tractor: 1},
    "animals": {animal: 1},
    "cars": {car: 1},
    "seats": _SEATS,
    "chairs": {chair: 1},
    "sofas": {sofa: 2, armchair: 1},
    "tables": {table: 3, desk: 1},
    "storage": {shelf: 1, cabinet: 1},
    "beds": {bed: 1},
}
"""Each family's kinds, and how often each is drawn against the others."""


def make_shape(family: str, rng: np.random.Generator) -> Mesh:
    """Return one synthetic shape: closed parts whose union is the solid, in its own frame and unit.

    It stands upright and faces the camera: x is its left, y down, z behind it; its box is centred and
    the longest side 2 `UNIT_HALF`. Parts may overlap. `Mesh.category` names the kind.

    Raises:
        UserError: no such family.
    """
    if family not in FAMILIES:
        raise UserError(f"No family of shapes '{family}'.{did_you_mean(family, FAMILIES)}")
    kinds = FAMILIES[family]
    weights = np.array(list(kinds.values()), float)
    return list(kinds)[int(rng.choice(len(kinds), p=weights / weights.sum()))](rng)


def make_shapes(family: str, count: int, seed: int) -> list[Mesh]:
    """Return synthetic shapes, the same for the same seed: shape i is the same however many are made.

    Raises:
        UserError: no such family, fewer than one shape.
    """
    if count < 1:
        raise UserError(f"{count} shapes of '{family}' asked for, expected 1 or more.")
    refuse_more_than_memory(f"{count:,} shapes of '{family}'", count * _BYTES_A_SHAPE, "Simulate fewer")
    shapes = [
        make_shape(family, np.random.default_rng((seed, number)))
        for number in progress(range(count), "simulating shapes")
    ]
    return [replace(shape, name=f"{family}-{seed}-{number}") for number, shape in enumerate(shapes)]


def frame_mesh(
    points: Float[np.ndarray, "vertices 3"], distance: int | float | np.floating
) -> tuple[float, Float[np.ndarray, " 2"]]:
    """Return the scale and offset that centre a shape's box in its crop, its longer half side `FILL`.

    ``points`` are in the camera's axes and the shape's units, as ``distance`` is. The camera aims at
    the middle of the box it sees, not at the shape's origin: the shape is moved sideways (``offset``) until
    the box's middle is on the optical axis, so `Placed`'s formula is exact, and no image is shifted.
    """
    weight = 1 / (1 + points[:, 2] / distance)
    flat = points[:, :2] * weight[:, None]
    moved = np.zeros(2)
    axes = np.arange(2)
    for _ in range(20):
        seen = flat + moved * weight[:, None]
        high, low = seen.argmax(0), seen.argmin(0)
        miss = seen[high, axes] + seen[low, axes]
        moved = moved - miss / (weight[high] + weight[low])
        if np.abs(miss).max() < 1e-12:
            break
    seen = flat + moved * weight[:, None]
    scale = FILL / max(float((seen.max(0) - seen.min(0)).max()) / 2, 1e-12)
    return scale, scale * moved


def render_masks(
    meshes: Sequence[Mesh],
    shape: Int[np.ndarray, " items"],
    view: Float[np.ndarray, "items 3 3"],
    distance: Float[np.ndarray, " items"],
    side: int,
) -> tuple[UInt8[np.ndarray, "items side side"], Placed]:
    """Return anti-aliased masks, cropped as `MaskData` has them, and where each shape is (`Placed`).

    ``view`` takes a shape's own frame to the camera's; the camera is ``distance`` from the shape's origin,
    in the shape's own units (infinite: parallel rays), and aims at the middle of what it sees (`frame_mesh`).
    """
    items = len(shape)
    masks = np.empty((items, side, side), np.uint8)
    scale, offset = np.empty(items), np.empty((items, 2))
    used: dict[int, np.ndarray] = {}
    for item, number in enumerate(progress(shape.tolist(), "rendering masks")):
        mesh = meshes[number]
        if number not in used:
            used[number] = np.bincount(mesh.faces.ravel(), minlength=len(mesh.vertices)) > 0
        rotated = mesh.vertices @ np.asarray(view[item], float).T
        scale[item], offset[item] = frame_mesh(rotated[used[number]], distance[item])
        placed = scale[item] * rotated
        placed[:, :2] += offset[item]
        seen = project(placed, scale[item] * distance[item])
        masks[item] = draw_mask((seen + 1) * (side / 2), mesh.faces, side)
    placement = (array.astype(np.float32) for array in (view, scale, offset, scale * distance))
    return masks, Placed(meshes, shape, *placement)


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


def draw_views(
    count: int, views: ViewChoice, seed: int
) -> tuple[Float[np.ndarray, "count 3 3"], Float[np.ndarray, " count"]]:
    """Return rotations from the shapes' frame to the cameras', and the cameras' distances in the shapes' units."""
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

    ``meshes`` are shapes in their own frame and unit, used in turn, or the name of a family to draw
    shapes from: one for every ``views_per_shape`` items.

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
    return MaskData(
        masks=masks,
        names=[f"{shapes[number].name or f'shape-{number}'}:{item}" for item, number in enumerate(shape.tolist())],
        centre_px=np.full((items, 2), side / 2, np.float32),
        scale_px=np.full(items, side / 2, np.float32),
        category=np.array([shapes[number].category for number in shape.tolist()]),
        truth=truth,
        source=meshes if isinstance(meshes, str) else "meshes",
    )
