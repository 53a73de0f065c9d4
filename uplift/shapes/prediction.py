"""`ShapePrediction`: lifted shapes, as they are evaluated and written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["ShapePrediction"]


@dataclass
class ShapePrediction:
    """A shape for each mask: occupancy in the shape's own frame, and where that stands in the camera's.

    A point p of the own frame is at `scale` * (`view` @ p) + (`offset`, 0) in the camera frame (see
    `uplift.masks.container.Placed`), in units of the mask's crop; `scale_px` of these are pixels.
    """

    occupancy: Float[np.ndarray, "items depth height width"]
    """0..1 at the centres of the voxels of the cube from -1 to 1: indices run along z, y, x of the own frame."""
    view: Float[np.ndarray, "items 3 3"]
    scale: Float[np.ndarray, " items"]
    offset: Float[np.ndarray, "items 2"]
    distance: Float[np.ndarray, " items"]
    """Of the camera, in units of the crop; infinite for parallel rays."""
    masks: np.ndarray
    """(items side side) uint8, what was lifted."""
    names: list[str]
    centre_px: np.ndarray
    scale_px: np.ndarray
    level: float = 0.5
    """Where the surface is: occupancy above it is inside."""
    title: str = ""
    images: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.occupancy)

    @property
    def resolution(self) -> int:
        """Voxels along the grid."""
        return self.occupancy.shape[-1]

    def select(self, rows: np.ndarray) -> ShapePrediction:
        """Return some items."""
        rows = np.flatnonzero(rows) if rows.dtype == bool else rows
        return ShapePrediction(
            self.occupancy[rows], self.view[rows], self.scale[rows], self.offset[rows], self.distance[rows],
            self.masks[rows], [self.names[row] for row in rows], self.centre_px[rows], self.scale_px[rows],
            self.level, self.title, None if self.images is None else self.images[rows], self.notes,
        )  # fmt: skip
