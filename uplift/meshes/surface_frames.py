"""The surfaces of lifted shapes, in their own frames or where the camera sees them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from uplift.meshes.mesh import Mesh
from uplift.meshes.surface import Surface, surface_of
from uplift.shapes.prediction import ShapePrediction

__all__ = ["in_camera", "prediction_surfaces", "surfaces"]


def surfaces(prediction: ShapePrediction, *, frame: str = "own", smooth: int = 0) -> list[Mesh | None]:
    """Return the mesh of each item, None where its grid is empty.

    ``own`` is the shape's frame, the cube from -1 to 1; ``camera`` is the camera's, in units of the crop.
    Raises ValueError for another frame.
    """
    if frame not in ("own", "camera"):
        raise ValueError(f"frame={frame}: expected own or camera")
    found: list[Mesh | None] = []
    for item, one in enumerate(prediction_surfaces(prediction, smooth=smooth)):
        seen = one.mesh if one.mesh is None or frame == "own" else _placed(one.mesh, prediction, item)
        found.append(seen)
    return found


def prediction_surfaces(prediction: ShapePrediction, *, smooth: int = 0) -> list[Surface]:
    """Return what was cut out of each item's grid, in its own frame, named as the item."""
    return [
        surface_of(np.asarray(grid, np.float32), level=prediction.level, smooth=smooth, name=name)
        for grid, name in zip(prediction.occupancy, prediction.names, strict=True)
    ]


def in_camera(
    points: Float[np.ndarray, "points 3"],
    view: Float[np.ndarray, "3 3"],
    scale: float | np.floating,
    offset: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "points 3"]:
    """Return points of the own frame in the camera's: x right, y down, z away, in units of the crop."""
    return scale * (points @ view.T) + np.append(offset, 0.0)


def _placed(mesh: Mesh, prediction: ShapePrediction, item: int) -> Mesh:
    points = in_camera(mesh.vertices, prediction.view[item], prediction.scale[item], prediction.offset[item])
    return replace(mesh, vertices=np.asarray(points, float))
