"""How made-up shapes are put together: `Part`, moved and mirrored, and the `Builder` that collects them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uplift.meshes.mesh import Mesh

__all__ = ["Builder", "Part", "Point"]

Point = Sequence[int | float] | np.ndarray


class Part(NamedTuple):
    """One closed surface, wound outwards; while a shape is built x is its left, y UP and its front +z."""

    vertices: np.ndarray
    """(vertices, 3)"""
    faces: np.ndarray
    """(faces, 3)"""

    def turned(self, angle: int | float, axis: str = "y", about: Point = (0, 0, 0)) -> Part:
        """Return the part turned by ``angle`` radians about an axis through a point (right-handed)."""
        first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
        moved = self.vertices - np.asarray(about, float)
        cos, sin = np.cos(angle), np.sin(angle)
        turned = moved.copy()
        turned[:, first] = cos * moved[:, first] - sin * moved[:, second]
        turned[:, second] = sin * moved[:, first] + cos * moved[:, second]
        return Part(turned + np.asarray(about, float), self.faces)

    def widened(self, share: int | float) -> Part:
        """Return the part ``share`` times as wide about its own middle."""
        middle = self.vertices.mean(0)
        return Part(middle + (self.vertices - middle) * (share, 1, 1), self.faces)

    def mirrored(self) -> Part:
        """Return the part on the shape's other side."""
        return Part(self.vertices * (-1, 1, 1), self.faces[:, ::-1])


class Builder:
    """Collects the parts of one shape."""

    def __init__(self) -> None:
        self.parts: list[Part] = []

    def add(self, *parts: Part) -> None:
        """Take parts as they are."""
        self.parts.extend(parts)

    def pair(self, *parts: Part) -> None:
        """Take parts of the left, and their mirror images."""
        for part in parts:
            self.parts += [part, part.mirrored()]

    def mesh(self, category: str) -> Mesh:
        """Return the shape in the own frame (y down, front -z) and unit."""
        starts = np.cumsum([0] + [len(part.vertices) for part in self.parts[:-1]])
        vertices = np.concatenate([part.vertices for part in self.parts]) * (1.0, -1.0, -1.0)
        faces = np.concatenate([part.faces + start for part, start in zip(self.parts, starts, strict=True)])
        return Mesh(vertices, faces.astype(np.int64), category=category).in_unit()
