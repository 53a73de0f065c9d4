"""What lifters hand over: poses or shapes, with what they came from and who each is."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from uplift.data.poses import UNITS

if TYPE_CHECKING:
    from uplift.skeleton import Skeleton

__all__ = ["Prediction", "ShapePrediction"]

# What a lifter hands over: poses with the keypoints they came from and the identity of every frame.


@dataclass
class Prediction:
    """Poses of one skeleton, frame by frame, with what was known about each frame.

    ``pose`` is relative to the root in ``axes``: of the camera (x right, y down, z away) unless it was
    turned to others; ``level_pose`` is the pose of the camera's axes with the estimated tilt undone.
    ``root`` is where the root joint is, in ``unit`` and ``axes``, where that is known. ``spread`` is the
    uncertainty of the depth in ``unit``, ``filled`` says which joints were not seen. ``truth`` is relative
    to the root, camera frame, in ``truth_unit``. Raises ValueError where the arrays do not fit together.
    """

    pose: np.ndarray  # (frames, joints, 3)
    level_pose: np.ndarray  # (frames, joints, 3)
    unit: str
    keypoints: np.ndarray  # (frames, joints, 2)
    confidence: np.ndarray  # (frames, joints)
    joint_names: tuple[str, ...]
    skeleton: Skeleton
    tilt_deg: np.ndarray | None = None  # (frames)
    identity: dict[str, np.ndarray] = field(default_factory=dict)
    fps: float | None = None
    image_size: tuple[int, int] | None = None
    truth: np.ndarray | None = None  # (frames, joints, 3)
    truth_unit: str = "mm"
    spread: np.ndarray | None = None  # (frames, joints)
    root: np.ndarray | None = None  # (frames, 3)
    filled: np.ndarray | None = None  # (frames, joints), bool
    axes: str = "camera"
    source: str = ""
    title: str = ""
    notes: tuple[str, ...] = ()  # what the reader assumed

    def __post_init__(self) -> None:
        """Check shapes, unit and names."""
        self.joint_names = tuple(str(name) for name in self.joint_names)
        for name, shape in self._shapes().items():
            found = getattr(self, name)
            if found is not None and np.shape(found) != shape:
                raise ValueError(f"prediction: {name} has shape {np.shape(found)}, expected {shape}")
        for name, values in self.identity.items():
            if np.shape(values) != (len(self),):
                raise ValueError(f"prediction: identity '{name}' has shape {np.shape(values)}, expected ({len(self)},)")
        for unit in (self.unit, self.truth_unit):
            if unit not in UNITS:
                raise ValueError(f"prediction: unit '{unit}' is not one of {', '.join(UNITS)}")
        unknown = {name for bone in self.skeleton.bones for name in bone} - set(self.joint_names)
        if unknown:
            raise ValueError(f"prediction: bones name joints that are not there: {', '.join(sorted(unknown))}")

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.pose)

    @property
    def points(self) -> np.ndarray:
        """Return (frames, joints, 3): the joints where they are, or relative to the root where that has no known place."""
        return self.pose if self.root is None else self.pose + self.root[:, None]

    def select(self, rows: np.ndarray) -> Prediction:
        """Return the frames that ``rows`` (a mask or indices) picks, everything else unchanged."""
        arrays = {name: getattr(self, name) for name in self._shapes()}
        picked = {name: value[rows] for name, value in arrays.items() if value is not None}
        return replace(self, **picked, identity={key: np.asarray(value)[rows] for key, value in self.identity.items()})

    @property
    def bone_indices(self) -> Int[np.ndarray, "bones 2"]:
        """Return parent and child of every bone as indices into ``joint_names``."""
        where = {name: index for index, name in enumerate(self.joint_names)}
        pairs = [(where[parent], where[child]) for parent, child in self.skeleton.bones]
        return np.array(pairs, dtype=np.int64).reshape(-1, 2)

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        frames, joints = np.shape(self.pose)[0], len(self.joint_names)
        return {
            "pose": (frames, joints, 3),
            "level_pose": (frames, joints, 3),
            "keypoints": (frames, joints, 2),
            "confidence": (frames, joints),
            "tilt_deg": (frames,),
            "truth": (frames, joints, 3),
            "spread": (frames, joints),
            "root": (frames, 3),
            "filled": (frames, joints),
        }


# `ShapePrediction`: lifted shapes, as they are evaluated and written.


@dataclass
class ShapePrediction:
    """A shape for each mask: occupancy in the shape's own frame, and where that stands in the camera's.

    A point p of the own frame is at `scale` * (`view` @ p) + (`offset`, 0) in the camera frame (see
    `uplift.data.masks.Placed`), in units of the mask's crop; `scale_px` of these are pixels.
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
