"""What lifters return: poses or shapes, with their inputs and the identity of each."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from uplift.config.files import without_folders
from uplift.data.poses import UNITS
from uplift.data.samples import Samples
from uplift.geometry.gravity import roll_of
from uplift.models.ground import Ground

if TYPE_CHECKING:
    from uplift.skeleton import Skeleton

__all__ = ["Prediction", "ShapePrediction", "view_angles_deg"]


@dataclass
class Prediction(Samples):
    """Poses of one skeleton, frame by frame, with what is known about each frame.

    ``pose`` is relative to the root in ``axes``: those of the camera (x right, y down, z away) unless it was
    converted; ``level_pose`` is the camera-frame pose with the estimated tilt undone. ``root`` is the position of
    the root joint, in ``unit`` and ``axes``, where known. ``uncertainty`` is the uncertainty of the depth in ``unit``,
    ``filled`` marks joints that were not visible. ``gravity`` are unit vectors in the real camera's frame, whatever
    ``axes`` says. ``hypotheses`` are whole poses like ``pose`` that fit the keypoints, in the order of their
    ``weights``, the most likely first; weights are probabilities, 1 in sum. ``ground`` is what
    `uplift.models.ground` found, in ``unit`` and ``axes``. ``truth`` is relative to the root, camera frame, in
    ``truth_unit``. Raises ValueError if the arrays do not fit together.
    """

    pose: Float[np.ndarray, "frames joints 3"]
    level_pose: Float[np.ndarray, "frames joints 3"]
    unit: str
    keypoints: Float[np.ndarray, "frames joints 2"]
    confidence: Float[np.ndarray, "frames joints"]
    joint_names: tuple[str, ...]
    skeleton: Skeleton
    tilt_deg: Float[np.ndarray, " frames"] | None = None
    identity: dict[str, Any] = field(default_factory=dict)
    fps: float | None = None
    image_size: tuple[int, int] | None = None
    truth: Float[np.ndarray, "frames joints 3"] | None = None
    truth_unit: str = "mm"
    uncertainty: Float[np.ndarray, "frames joints"] | None = None
    root: Float[np.ndarray, "frames 3"] | None = None
    filled: Bool[np.ndarray, "frames joints"] | None = None
    gravity: Float[np.ndarray, "frames 3"] | None = None
    hypotheses: Float[np.ndarray, "frames hypotheses joints 3"] | None = None
    weights: Float[np.ndarray, "frames hypotheses"] | None = None
    ground: Ground | None = None
    axes: str = "camera"
    source: str = ""
    title: str = ""
    notes: tuple[str, ...] = ()  # what the reader assumed

    def __post_init__(self) -> None:
        """Check shapes, unit and names."""
        self.joint_names = tuple(str(name) for name in self.joint_names)
        wrong = self.misfit(joints=len(self.joint_names))
        if wrong:
            raise ValueError(f"prediction: {wrong}")
        for unit in (self.unit, self.truth_unit):
            if unit not in UNITS:
                raise ValueError(f"prediction: unit '{unit}' is not one of {', '.join(UNITS)}")
        if (self.hypotheses is None) != (self.weights is None):
            raise ValueError("prediction: hypotheses and weights go together, expected both or neither")
        unknown = {name for bone in self.skeleton.bones for name in bone} - set(self.joint_names)
        if unknown:
            raise ValueError(f"prediction: bones name unknown joints: {', '.join(sorted(unknown))}")

    @property
    def points(self) -> np.ndarray:
        """Joint positions (frames, joints, 3); relative to the root if its position is unknown."""
        return self.pose if self.root is None else self.pose + self.root[:, None]

    @property
    def roll_deg(self) -> Float[np.ndarray, " frames"] | None:
        """The camera's roll: positive where "up" leans to the right in the image; None without `gravity`."""
        return None if self.gravity is None else roll_of(self.gravity)

    @property
    def ground_point(self) -> Float[np.ndarray, "frames 3"] | None:
        """A point on the ground; None where none was asked for or found."""
        return None if self.ground is None else self.ground.point

    @property
    def ground_normal(self) -> Float[np.ndarray, "frames 3"] | None:
        """Unit vectors that point up from the ground."""
        return None if self.ground is None else self.ground.normal

    @property
    def contact(self) -> Bool[np.ndarray, "frames joints"] | None:
        """Joints that stand on the ground."""
        return None if self.ground is None else self.ground.contact

    @property
    def bone_indices(self) -> Int[np.ndarray, "bones 2"]:
        """Parent and child of every bone as indices into ``joint_names``."""
        pairs = [[self.joint_names.index(joint) for joint in bone] for bone in self.skeleton.bones]
        return np.array(pairs, dtype=np.int64).reshape(-1, 2)


@dataclass
class ShapePrediction(Samples):
    """A shape for each mask: occupancy in the shape frame, and the pose of that frame in the camera's.

    A point p of the shape frame is at `scale` * (`view` @ p) + (`offset`, 0) in the camera frame (see
    `uplift.data.masks.Placed`), in units of the mask's crop, which are `scale_px` pixels long.
    """

    occupancy: Float[np.ndarray, "items depth height width"]
    """0..1 at the centres of the voxels of the cube from -1 to 1: indices run along z, y, x of the shape frame."""
    view: Float[np.ndarray, "items 3 3"]
    scale: Float[np.ndarray, " items"]
    offset: Float[np.ndarray, "items 2"]
    distance: Float[np.ndarray, " items"]
    """Of the camera, in units of the crop; infinite for parallel rays."""
    masks: UInt8[np.ndarray, "items side side"]
    """The lifted masks."""
    names: list[str]
    """Without folders of the machine: they go into every output."""
    centre_px: np.ndarray
    scale_px: np.ndarray
    level: float = 0.5
    """Iso threshold of the surface: occupancy above it is inside."""
    title: str = ""
    images: np.ndarray | None = None
    uncertainty: Float[np.ndarray, "items depth height width"] | None = None
    """The standard deviation of each voxel's occupancy over the shapes that a mask leaves open, where it is known."""
    probability: Float[np.ndarray, " items"] | None = None
    """Of `view`, among all that a mask may be from."""
    second_view: Float[np.ndarray, "items 3 3"] | None = None
    """The likeliest of the views that are apart from `view`; NaN where there is none."""
    second_probability: Float[np.ndarray, " items"] | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Take the folders of absolute paths off the names."""
        self.names = list(map(without_folders, self.names))

    @property
    def resolution(self) -> int:
        """Voxels along the grid."""
        return self.occupancy.shape[-1]

    @property
    def azimuth_deg(self) -> Float[np.ndarray, " items"]:
        """How far each object is turned about gravity: 0 seen from its front, 90 from its left, 180 from behind."""
        return view_angles_deg(self.view)[0]

    @property
    def elevation_deg(self) -> Float[np.ndarray, " items"]:
        """How far each camera looks down."""
        return view_angles_deg(self.view)[1]

    @property
    def roll_deg(self) -> Float[np.ndarray, " items"]:
        """How far up leans to the right in the image."""
        return view_angles_deg(self.view)[2]


def view_angles_deg(view: Float[np.ndarray, "items 3 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return azimuth, elevation and roll of views in degrees, as `uplift.models.silhouettes.ObjectPose` has them."""
    view = np.asarray(view, np.float64)
    azimuth = np.arctan2(-view[:, 2, 0], view[:, 2, 2])
    elevation = np.arcsin(np.clip(view[:, 2, 1], -1, 1))
    roll = np.arctan2(-view[:, 0, 1], view[:, 1, 1])
    # Adding 0 takes the sign off a zero.
    return np.rad2deg(azimuth) + 0.0, np.rad2deg(elevation) + 0.0, np.rad2deg(roll) + 0.0
