"""`Mesh`: the surface of one shape as triangles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

__all__ = ["UNIT_HALF", "Mesh"]

UNIT_HALF = 0.9
"""Half of the longest side of a shape's box in its own unit: a margin is left inside the grid of -1 to 1."""


@dataclass(frozen=True)
class Mesh:
    """Triangles of one shape, in its own frame: it faces the camera, x its left, y down, z behind it."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    """Corners of each triangle, anticlockwise from outside."""
    name: str = ""
    category: str = ""

    def in_unit(self) -> Mesh:
        """Return the mesh in its own unit: its box centred, the longest side 2 `UNIT_HALF`."""
        low, high = self.vertices.min(0), self.vertices.max(0)
        half = max(float((high - low).max()) / 2, 1e-12)
        return replace(self, vertices=(self.vertices - (low + high) / 2) * (UNIT_HALF / half))
