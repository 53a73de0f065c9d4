"""The closed parts of synthetic shapes (blocks, beams, lofts, balls; y is up) and the `Builder` that collects them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import trimesh

from uplift.geometry.mesh import Mesh

__all__ = ["Builder", "Number", "Part", "ball", "beam", "block", "lathe", "loft", "rod", "rounded", "slab", "tube"]

Number = int | float
_Point = Sequence[Number] | np.ndarray


class Part(NamedTuple):
    """One closed surface, wound outwards; while a shape is built x is its left, y UP and its front +z."""

    vertices: np.ndarray
    """(vertices, 3)"""
    faces: np.ndarray
    """(faces, 3)"""

    def rotated(self, angle: Number, axis: str = "y", about: _Point = (0, 0, 0)) -> Part:
        """Return the part rotated by ``angle`` radians about an axis through a point (right-handed)."""
        first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
        moved = self.vertices - np.asarray(about, float)
        cos, sin = np.cos(angle), np.sin(angle)
        rotated = moved.copy()
        rotated[:, first] = cos * moved[:, first] - sin * moved[:, second]
        rotated[:, second] = sin * moved[:, first] + cos * moved[:, second]
        return Part(rotated + np.asarray(about, float), self.faces)

    def widened(self, share: Number) -> Part:
        """Return the part ``share`` times as wide about its own middle."""
        middle = self.vertices.mean(0)
        return Part(middle + (self.vertices - middle) * (share, 1, 1), self.faces)

    def mirrored(self) -> Part:
        """Return the part on the shape's other side."""
        return Part(self.vertices * (-1, 1, 1), self.faces[:, ::-1])


@cache
def _loft_faces(rings: int, corners: int) -> np.ndarray:
    ring, corner = (grid.ravel() for grid in np.meshgrid(np.arange(rings - 1), np.arange(corners), indexing="ij"))
    a, b = ring * corners + corner, ring * corners + (corner + 1) % corners
    sides = np.concatenate([np.stack([a, b, b + corners], 1), np.stack([a, b + corners, a + corners], 1)])
    fan = np.arange(1, corners - 1)
    start = np.stack([np.zeros_like(fan), fan + 1, fan], 1)
    end = np.stack([np.zeros_like(fan), fan, fan + 1], 1) + (rings - 1) * corners
    return np.concatenate([sides, start, end])


@cache
def _unit_ball(fine: int) -> Part:
    made = trimesh.creation.icosphere(subdivisions=fine)
    return Part(np.array(made.vertices), np.array(made.faces))


def loft(rings: np.ndarray) -> Part:
    """Return the surface through rings (rings corners 3) of equally many corners; the two ends are convex and flat."""
    rings = np.asarray(rings, float)
    vertices, faces = rings.reshape(-1, 3), _loft_faces(*rings.shape[:2])
    a, b, c = (vertices - vertices.mean(0))[faces.T]
    inwards = float((a * np.cross(b, c)).sum()) < 0
    return Part(vertices, faces[:, ::-1] if inwards else faces)


def block(low: _Point, high: _Point) -> Part:
    """Return a box between two corners."""
    low, high = np.minimum(low, high), np.maximum(low, high)
    x, z = (low[0] + high[0]) / 2, (low[2] + high[2]) / 2
    return beam((x, low[1], z), (x, high[1], z), (high[0] - low[0], high[2] - low[2]))


def beam(start: _Point, end: _Point, size: _Point, end_size: _Point | None = None, across: str = "xz") -> Part:
    """Return a beam of four sides; its section lies in the two axes ``across``, its sizes are along them."""
    rings = np.repeat(np.array([start, end], float)[:, None], 4, 1)
    for ring, extent in zip(rings, (size, size if end_size is None else end_size), strict=True):
        ring[:, "xyz".index(across[0])] += np.multiply((-0.5, 0.5, 0.5, -0.5), extent[0])
        ring[:, "xyz".index(across[1])] += np.multiply((-0.5, -0.5, 0.5, 0.5), extent[1])
    return loft(rings)


def rod(start: _Point, end: _Point, radius: Number, end_radius: Number | None = None, sides: int = 8) -> Part:
    """Return a round rod, or a cone cut off, between two points."""
    return tube(np.array([start, end], float), (radius, radius if end_radius is None else end_radius), sides)


def tube(
    path: np.ndarray, radii: Sequence[Number] | np.ndarray, sides: int = 8, flat: float = 1.0, blunt: bool = False
) -> Part:
    """Return a round tube along a path (points 3); ``flat`` is how much higher than wide its section is.

    Wide is along x where the path allows. A blunt tube's ends are rounded.
    """
    path, radii = np.asarray(path, float), np.asarray(radii, float)
    high = radii * flat
    if blunt:
        path, radii, high = _blunted(path, radii, high)
    along = np.gradient(path, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    aside = np.eye(3)[np.abs(along).max(0).round(6).argmin()] - 0 * along
    aside -= (aside * along).sum(1, keepdims=True) * along
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
    upwards = np.cross(aside, along)
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    across = radii[:, None, None] * np.cos(angle)[None, :, None] * aside[:, None]
    return loft(path[:, None] + across + high[:, None, None] * np.sin(angle)[None, :, None] * upwards[:, None])


def _blunted(path: np.ndarray, wide: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a path with a smaller ring behind either end."""
    start, end = path[0] - path[1], path[-1] - path[-2]
    reach = 0.55 * np.minimum(wide, high)[[0, -1]]
    start, end = path[0] + start / np.linalg.norm(start) * reach[0], path[-1] + end / np.linalg.norm(end) * reach[1]
    wide, high = (np.concatenate([size[:1] * 0.6, size, size[-1:] * 0.6]) for size in (wide, high))
    return np.concatenate([start[None], path, end[None]]), wide, high


def ball(centre: _Point, radii: _PoNumber, fine: int = 1) -> Part:
    """Return an ellipsoid; ``fine`` 1 has 80 faces, 2 has 320."""
    unit = _unit_ball(fine)
    return Part(unit.vertices * np.asarray(radii, float) + np.asarray(centre, float), unit.faces)


def lathe(
    radii: Sequence[Number] | np.ndarray, heights: Sequence[Number] | np.ndarray, x: Number = 0, sides: int = 12
) -> Part:
    """Return a solid of revolution: circles of ``radii`` at ``heights`` about the upright through (x, 0)."""
    angle = 2 * np.pi * np.arange(sides) / sides
    rings = np.empty((len(radii), sides, 3))
    rings[..., 0] = x + np.multiply.outer(radii, np.cos(angle))
    rings[..., 2] = np.multiply.outer(radii, np.sin(angle))
    rings[..., 1] = np.asarray(heights, float)[:, None]
    return loft(rings)


def slab(outline: np.ndarray, low: Number, high: Number, round_by: Number = 0.0) -> Part:
    """Return a plate of a convex outline (corners 2) in (x, z), between two heights; its edges drawn in by a share."""
    levels = [(low, 1.0), (high, 1.0)]
    if round_by > 0:
        edge = 0.3 * (high - low)
        levels = [(low, 1 - round_by), (low + edge, 1.0), (high - edge, 1.0), (high, 1 - round_by)]
    middle = outline.mean(0)
    rings = np.empty((len(levels), len(outline), 3))
    for ring, (height, share) in zip(rings, levels, strict=True):
        ring[:, [0, 2]] = middle + share * (outline - middle)
        ring[:, 1] = height
    return loft(rings)


def rounded(
    width: Number, depth: Number, back_width: Number | None = None, power: Number = 8.0, corners: int = 20
) -> np.ndarray:
    """Return a rounded rectangle (corners 2) in (x, z): a superellipse, narrower at the back with ``back_width``."""
    angle = 2 * np.pi * (np.arange(corners) + 0.5) / corners
    x, z = np.cos(angle), np.sin(angle)
    outline = np.stack([np.sign(x) * np.abs(x) ** (2 / power), np.sign(z) * np.abs(z) ** (2 / power)], 1)
    share = 1.0 if back_width is None else back_width / width
    taper = share + (1 - share) * (outline[:, 1:] + 1) / 2
    return outline * (width / 2, depth / 2) * np.concatenate([taper, np.ones_like(taper)], 1)


class Builder:
    """Collects the parts of one shape."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.parts: list[Part] = []

    def add(self, *parts: Part) -> None:
        """Take parts as they are."""
        self.parts.extend(parts)

    def pair(self, *parts: Part) -> None:
        """Take parts of the left, and their mirror images."""
        for part in parts:
            self.parts += [part, part.mirrored()]

    def mesh(self, category: str) -> Mesh:
        """Return the shape in its own frame (y down, front -z) and unit."""
        starts = np.cumsum([0] + [len(part.vertices) for part in self.parts[:-1]])
        vertices = np.concatenate([part.vertices for part in self.parts]) * (1.0, -1.0, -1.0)
        faces = np.concatenate([part.faces + start for part, start in zip(self.parts, starts, strict=True)])
        return Mesh(vertices, faces.astype(np.int64), category=category).in_unit()
