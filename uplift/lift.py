"""What a prior sees of one training step: the lifted poses, the views they are turned to, the labels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from uplift.lifter import Lifted, Lifter
from uplift.normalise import renormalise
from uplift.skeleton import Skeleton
from uplift.views import level, turn

__all__ = ["Lift"]


@dataclass(frozen=True)
class Lift:
    """A batch of lifted poses, one view each. Lengths are in units of the mean 2D radius.

    `pose`, `level_pose`, `turned` and `seen` carry gradients to the lifter.
    """

    skeleton: Skeleton
    keypoints: Float[Tensor, "batch joints 2"]
    """The real, normalised 2D keypoints; missing joints are 0."""
    confidence: Float[Tensor, "batch joints"]
    """0..1; 0 = missing. What the data says, whatever was hidden from the network."""
    hidden: Bool[Tensor, "batch joints"]
    """Joints that are known but were hidden from the network in this step."""
    pose: Float[Tensor, "batch joints 3"]
    """The lifted pose: camera frame (x right, y down, z away), relative to the root."""
    tilt: Float[Tensor, " batch"]
    """Down-tilt of the camera, radians, as the lifter sees it."""
    lifted_keypoints: Float[Tensor, "batch joints 2"]
    """What `pose` projects to: `keypoints`, with missing and hidden joints as the lifter fills them in."""
    view: Float[Tensor, "batch 3 3"]
    """The rotation from the camera frame to the frame of a new, random camera."""
    scale: Float[Tensor, " batch"]
    """Pixels per unit."""
    distance: Float[Tensor, " batch"]
    """Of the camera to the root, in units; the new camera is as far."""
    labels: Float[Tensor, "batch joints 3"] | None
    """True poses in the same units, NaN where a joint or a frame has none; None in 2D-only training."""
    lifter: Lifter
    label_unit: Float[Tensor, " batch"] | None = None
    """Of the labels' own unit (mm) in one unit of the model, NaN where unlabelled."""
    label_tilt: Float[Tensor, " batch"] | None = None
    """True tilt of the camera, radians, as `tilt`; NaN where that is not known."""
    masks: UInt8[Tensor, "batch side side"] | None = None
    """Crops of the images, 0 outside the body, 255 inside, never mirrored; None where the data has none."""
    mask_map: Float[Tensor, "batch 3 3"] | None = None
    """What takes `measured_keypoints` (x, y, 1) to the crop, (u w, v w, w): u, v from -1 to 1 over it; NaN without
    a mask. That of a mirrored frame mirrors the points."""
    row: Int[Tensor, " batch"] | None = None
    """Which frames of the training set they are, for what a prior found out about each in `prepare`."""
    renormalise_views: bool = True
    count_root: bool = True

    @cached_property
    def level_pose(self) -> Float[Tensor, "batch joints 3"]:
        """The pose with the estimated tilt undone: y is gravity. The pose itself without gravity."""
        return turn(self.pose, level(self.tilt)) if self.skeleton.gravity else self.pose

    @cached_property
    def turned(self) -> Float[Tensor, "batch joints 3"]:
        """The pose in the new camera's frame."""
        return turn(self.pose, self.view)

    @cached_property
    def seen(self) -> Float[Tensor, "batch joints 2"]:
        """The turned pose's 2D keypoints, normalised as real ones are; missing joints included."""
        return self._seen[0]

    @cached_property
    def seen_scale(self) -> Float[Tensor, " batch"]:
        """Units of `turned` per unit of `seen`: the radius that `seen` was divided by."""
        return self._seen[1]

    @cached_property
    def _seen(self) -> tuple[Tensor, Tensor]:
        projected = self.lifter.camera.project(self.turned, self.distance)
        if not self.renormalise_views:
            return projected, projected.new_ones(len(projected))
        root = self.skeleton.root_index
        return renormalise(projected, self.confidence, root, count_root=self.count_root)

    @cached_property
    def visible(self) -> Float[Tensor, "batch joints"]:
        """1 where the data has the joint, 0 where it is missing."""
        return (self.confidence > 0).to(self.confidence.dtype)

    @cached_property
    def measured_keypoints(self) -> Float[Tensor, "batch joints 2"]:
        """`lifted_keypoints` from where `keypoints` are measured: the stand-in of a root that is missing."""
        shown = (self.visible * ~self.hidden).unsqueeze(-1)
        apart = ((self.keypoints - self.lifted_keypoints) * shown).sum(1, keepdim=True) / shown.sum(1, True).clamp_min(
            1
        )
        gone = self.visible[:, self.skeleton.root_index, None, None] == 0
        return self.lifted_keypoints + apart * gone

    @cached_property
    def relifted(self) -> Lifted:
        """The turned view lifted again, by the same lifter, with the same joints missing."""
        keypoints = self.seen * self.visible.unsqueeze(-1)
        return self.lifter(keypoints, self.confidence, self.distance / self.seen_scale)

    @staticmethod
    def mean(value: Tensor, weight: Tensor) -> Tensor:
        """Return the mean of ``value`` over the batch and more, weighted; 0 if nothing weighs."""
        weight = weight.expand_as(value)
        return (value * weight).sum() / weight.sum().clamp_min(torch.finfo(value.dtype).tiny)
