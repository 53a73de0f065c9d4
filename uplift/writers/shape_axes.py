"""The axes and the unit that lifted shapes are written in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from uplift.axes import FROM_LEVEL
from uplift.errors import UserError, did_you_mean
from uplift.meshes.mesh import Mesh
from uplift.meshes.surface_frames import in_camera
from uplift.shapes.prediction import ShapePrediction

__all__ = ["SHAPE_AXES", "Frame", "check_axes"]

_OWN = {
    "own": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "gltf": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "print": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}
"""Rotations from the shape's own frame."""
SHAPE_AXES = {
    "own": "x the object's left, y down, z behind it",
    "gltf": "y up, the object faces +z, x is its left",
    "print": "z up, the object faces -y, x is its left",
    "camera": "x right in the image, y down, z away from the camera",
    "opencv": "another name of camera: x right in the image, y down, z away from the camera",
    "level": "as seen, y is gravity: x right, y down, z away, level",
    "blender": "as seen, z up: x right, y away from the camera, level",
    "opensim": "as seen, y up: x right, z towards the camera, level",
}
"""Names of axes and what they mean; all are right-handed, so left stays left."""


@dataclass(frozen=True)
class Frame:
    """Axes and unit of files of one prediction."""

    axes: str
    unit: str = "px"
    height_mm: float | None = None
    """Of every object, along its own y."""
    length_mm: float | None = None
    """The longest side of every object's box in its own axes."""

    def placed(self, mesh: Mesh, prediction: ShapePrediction, item: int) -> Float[np.ndarray, "points 3"]:
        """Return an own mesh's corners in these axes and this unit.

        The origin of ``own``, ``gltf`` and ``print`` is that of the shape's own frame, that of all others the
        crop's centre at the depth of that origin.
        """
        scale = float(prediction.scale[item])
        if self.axes in _OWN:
            points = scale * (mesh.vertices @ np.array(_OWN[self.axes], float).T)
        else:
            points = in_camera(mesh.vertices, prediction.view[item], scale, prediction.offset[item])
            points = points @ self._from_camera(prediction.view[item]).T
        return np.asarray(points * self._factor(mesh, prediction, item), float)

    def _from_camera(self, view: np.ndarray) -> np.ndarray:
        if self.axes in ("camera", "opencv"):
            return np.eye(3)
        # Gravity is the own frame's y: the least turn about x that takes it to y keeps what is right in the image.
        _, cos, sin = view[:, 1]
        size = np.hypot(cos, sin) or 1.0
        level = np.array([[1, 0, 0], [0, cos / size, sin / size], [0, -sin / size, cos / size]])
        return np.array(FROM_LEVEL[self.axes], float) @ level

    def _factor(self, mesh: Mesh, prediction: ShapePrediction, item: int) -> float:
        """Return units of the file in one unit of the crop."""
        sides = np.ptp(mesh.vertices, axis=0) * float(prediction.scale[item])
        if self.height_mm is not None:
            return self.height_mm / max(float(sides[1]), 1e-12)
        if self.length_mm is not None:
            return self.length_mm / max(float(sides.max()), 1e-12)
        return float(prediction.scale_px[item]) if self.unit == "px" else 1.0

    def about(self, prediction: ShapePrediction, items: list[int]) -> dict[str, Any]:
        """Return what a file says of itself: its unit, axes, and where its items stand in the photo."""
        return {
            "unit": self.unit,
            "unit_is": self._unit_told(),
            "axes": self.axes,
            "axes_are": SHAPE_AXES[self.axes],
            "handedness": "right",
            "items": [_standing(prediction, item) for item in items],
        }

    def _unit_told(self) -> str:
        if self.height_mm is not None:
            return f"millimetres, each object taken to be {self.height_mm:g} mm high"
        if self.length_mm is not None:
            return f"millimetres, the longest side of each object's box taken to be {self.length_mm:g} mm"
        if self.unit == "px":
            return "pixels of the photo that the mask came from, at the object's depth"
        return "half the side of the mask's crop"


def check_axes(axes: str) -> str:
    """Return the name of known axes; raises UserError for others."""
    if axes not in SHAPE_AXES:
        raise UserError(f"axes={axes}: no such axes of shapes.{did_you_mean(axes, SHAPE_AXES)}")
    return axes


def _standing(prediction: ShapePrediction, item: int) -> dict[str, Any]:
    """Return one item's name and place: own frame to camera, in units of the crop."""
    distance = float(prediction.distance[item])
    return {
        "name": prediction.names[item],
        "view": np.round(prediction.view[item], 6).tolist(),
        "scale": round(float(prediction.scale[item]), 6),
        "offset": np.round(prediction.offset[item], 6).tolist(),
        "distance": round(distance, 6) if np.isfinite(distance) else None,
        "centre_px": np.round(prediction.centre_px[item], 3).tolist(),
        "scale_px": round(float(prediction.scale_px[item]), 4),
    }
