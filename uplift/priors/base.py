"""`Prior`, a term of the objective, and what it is given in a training step: a `Lift` of poses or a `ShapeLift`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Never

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor, nn

from uplift.config import ranks
from uplift.geometry.normalise import bone_lengths, renormalise
from uplift.geometry.rotation import level, turn
from uplift.models.lifter import Lifted, Lifter
from uplift.models.silhouettes import ObjectPose
from uplift.skeleton import Skeleton

if TYPE_CHECKING:
    from uplift.data.mask_tensors import MaskSet
    from uplift.data.tensors import TrainingSet

__all__ = ["Lift", "Prior", "ShapeLift", "ShapePrior", "joint_distance"]

# What a prior is given: lifted poses and their rotated views, or shapes and their silhouettes.


def joint_distance(
    first: Float[Tensor, "batch joints axes"], second: Float[Tensor, "batch #joints axes"]
) -> Float[Tensor, "batch joints"]:
    """Return the distance of each joint, with a finite gradient at 0."""
    return ((first - second).square().sum(-1) + 1e-12).sqrt()


def _former(old: str, new: str) -> Any:
    """Return a property for the former name of an attribute: using it is an error that gives the new name."""

    def refuse(lift: object) -> Never:
        raise AttributeError(f"lift.{old} is now called lift.{new}")

    return property(refuse)


@dataclass(frozen=True)
class Lift:
    """A batch of lifted poses with one random view each; lengths are in units of the mean 2D radius.

    Camera frame: x right, y down, z away from the camera. The fields of `differentiable` carry gradients to
    the lifter.
    """

    differentiable: ClassVar[tuple[str, ...]] = ("pose", "level_pose", "rotated", "reprojected")
    seen = _former("seen", "reprojected")
    seen_scale = _former("seen_scale", "reprojected_scale")
    turned = _former("turned", "rotated")

    skeleton: Skeleton
    keypoints: Float[Tensor, "batch joints 2"]
    """Real, normalised 2D keypoints, relative to the root; missing joints are 0."""
    confidence: Float[Tensor, "batch joints"]
    """0..1 as in the data; 0 = missing. Joints hidden from the network keep theirs."""
    hidden: Bool[Tensor, "batch joints"]
    """Visible joints that were hidden from the network in this step."""
    pose: Float[Tensor, "batch joints 3"]
    """The lifted pose, relative to the root."""
    tilt: Float[Tensor, " batch"]
    """Down-tilt of the camera in radians, as the lifter estimates it."""
    lifted_keypoints: Float[Tensor, "batch joints 2"]
    """What `pose` projects to: `keypoints`, with missing and hidden joints filled in by the lifter."""
    view: Float[Tensor, "batch 3 3"]
    """The rotation from the camera frame to the frame of a new, random camera."""
    scale: Float[Tensor, " batch"]
    """Pixels per unit."""
    distance: Float[Tensor, " batch"]
    """From the camera to the root; the same for the new camera."""
    labels: Float[Tensor, "batch joints 3"] | None
    """True poses in the same units, NaN where a joint or frame has no label; None in 2D-only training."""
    lifter: Lifter
    label_unit: Float[Tensor, " batch"] | None = None
    """The labels' unit (mm) per unit of the model, NaN where unlabelled."""
    label_tilt: Float[Tensor, " batch"] | None = None
    """True tilt of the camera in radians, NaN where unknown."""
    masks: UInt8[Tensor, "batch side side"] | None = None
    """Image crops, 0 outside the body, 255 inside, never mirrored; None where the data has none."""
    mask_map: Float[Tensor, "batch 3 3"] | None = None
    """Maps `measured_keypoints` (x, y, 1) to (u w, v w, w), with u and v from -1 to 1 over the crop.

    It mirrors the points of mirrored frames; NaN without a mask."""
    row: Int[Tensor, " batch"] | None = None
    """Indices into the training set, to look up what `Prior.prepare` measured for each frame."""
    renormalise_views: bool = True
    count_root: bool = True

    @property
    def loss_shapes(self) -> tuple[tuple[int, ...], ...]:
        """The shapes that a loss may have: one number, or one for each frame."""
        return (), (len(self.pose),)

    @cached_property
    def level_pose(self) -> Float[Tensor, "batch joints 3"]:
        """The pose with the estimated tilt undone, so that y is gravity; `pose` for skeletons without gravity."""
        return turn(self.pose, level(self.tilt)) if self.skeleton.gravity else self.pose

    @cached_property
    def rotated(self) -> Float[Tensor, "batch joints 3"]:
        """The pose in the new camera's frame."""
        return turn(self.pose, self.view)

    @cached_property
    def reprojected(self) -> Float[Tensor, "batch joints 2"]:
        """The 2D keypoints of `rotated`, normalised as real ones are; missing joints included."""
        return self._reprojected[0]

    @cached_property
    def reprojected_scale(self) -> Float[Tensor, " batch"]:
        """Units of `rotated` per unit of `reprojected`: the radius that `reprojected` was divided by."""
        return self._reprojected[1]

    @cached_property
    def _reprojected(self) -> tuple[Tensor, Tensor]:
        projected = self.lifter.camera.project(self.rotated, self.distance)
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
        """`lifted_keypoints` relative to the origin of `keypoints`, which is a stand-in where the root is missing."""
        shown = (self.visible * ~self.hidden).unsqueeze(-1)
        offset = ((self.keypoints - self.lifted_keypoints) * shown).sum(1, keepdim=True)
        offset = offset / shown.sum(1, True).clamp_min(1)
        root_missing = self.visible[:, self.skeleton.root_index, None, None] == 0
        return self.lifted_keypoints + offset * root_missing

    @cached_property
    def relifted(self) -> Lifted:
        """The view `reprojected`, lifted again by the same lifter with the same joints missing."""
        keypoints = self.reprojected * self.visible.unsqueeze(-1)
        return self.lifter(keypoints, self.confidence, self.distance / self.reprojected_scale)

    @cached_property
    def returned(self) -> Float[Tensor, "batch joints 3"]:
        """The pose of `relifted` in the units of `pose`, turned back to its frame."""
        return turn(self.relifted.pose * self.reprojected_scale[:, None, None], self.view.mT)

    @cached_property
    def bone_lengths(self) -> Float[Tensor, "batch bones"]:
        """Lengths of the bones of `pose`."""
        return bone_lengths(self.pose, self.lifter.bones)

    @cached_property
    def visible_bones(self) -> Float[Tensor, "batch bones"]:
        """1 where both ends of a bone are in the data, else 0."""
        start, end = self.lifter.bones.mT
        return self.visible.index_select(1, start) * self.visible.index_select(1, end)

    @staticmethod
    def mean(value: Tensor, weight: Tensor) -> Tensor:
        """Return the weighted mean of ``value`` over all its axes and all ranks; 0 where all weights are 0."""
        weight = weight.expand_as(value)
        weighted, weights = ranks.total((value * weight).sum(), weight.sum())
        return weighted / weights.clamp_min(torch.finfo(value.dtype).tiny)

    @staticmethod
    def sums(*values: Float[Tensor, "batch *rest"]) -> tuple[Tensor, ...]:
        """Return the sum of each value over the batch, on several ranks that of all of them."""
        return ranks.total(*(value.sum(0) for value in values))


@dataclass(frozen=True)
class ShapeLift:
    """A batch of masks and the shapes that explain them; the fields of `differentiable` carry gradients to the shapes.

    While views are found (`uplift.MixtureModule`), the shapes are a few that explain all masks; after that
    (`uplift.ShapeModule`) each mask of the batch has its own.
    """

    differentiable: ClassVar[tuple[str, ...]] = ("logits", "occupancy", "reprojected")
    seen = _former("seen", "reprojected")
    loss_shapes: ClassVar[tuple[tuple[int, ...], ...]] = ((),)
    """The shapes that a loss may have: one number."""

    logits: Float[Tensor, "shapes depth height width"]
    """Logits of `occupancy` in the shape frame: indices run along z, y, x; y is down, the front is -z."""
    occupancy: Float[Tensor, "shapes depth height width"]
    """0..1 for each voxel."""
    reprojected: Float[Tensor, "reprojected side side"]
    """Silhouettes of the shapes from random views, cropped as masks are."""
    masks: Float[Tensor, "items side side"]
    """The real masks of this step, cropped the same way."""
    used: Float[Tensor, "shapes views"]
    """Share of the masks that each shape explains from each view; sums to 1; no gradient."""
    views: Float[Tensor, "views 3 3"]
    """Rotations from the shape frame to the camera frame."""
    done: float
    """Share of the stage that is over, 0..1."""

    @classmethod
    def of(
        cls,
        logits: Float[Tensor, "shapes depth height width"],
        reprojected: Float[Tensor, "reprojected side side"],
        masks: Float[Tensor, "items side side"],
        pose: ObjectPose,
        done: float,
    ) -> ShapeLift:
        """Return what priors judge where each mask has a shape of its own, in a pose of its own."""
        used = torch.eye(len(logits), device=logits.device) / len(logits)
        return cls(logits, torch.sigmoid(logits), reprojected, masks, used, pose.view.detach(), done)


class Prior(nn.Module):
    """A term of the objective: subclass it, write `loss`, and name the class in a task or on the command line.

    Options are keyword arguments of ``__init__``, set beside ``use`` and ``weight``. Trainable parameters are
    ordinary ``nn.Parameter`` and are trained with the lifter.

    Example (``priors.ground.use=my.py:FlatGround``)::

        class FlatGround(uplift.Prior):
            def __init__(self, skeleton, *, feet=("rankle", "lankle")):
                super().__init__(skeleton)
                self.feet = [skeleton.index(name) for name in feet]

            def loss(self, lift):
                height = lift.level_pose[:, self.feet, 1]
                return height.amax(1) - height.amin(1)
    """

    judges: ClassVar[Literal["poses", "shapes"]] = "poses"
    """What `loss` is given: a `Lift` of poses or a `ShapeLift`."""
    gate_itself: bool = False
    """Set to True by an adversarial prior whose own parameters must not be updated in this step."""
    gate_lifter: bool = False
    """Set to True by an adversarial prior where the lifter must not be updated in this step."""

    def __init__(self, skeleton: Skeleton):
        super().__init__()
        self.skeleton = skeleton

    def prepare(self, data: TrainingSet | MaskSet | Any) -> None:
        """Prepare from the training data, once before the first step: fit a density, measure proportions."""

    def loss(self, lift: Lift | ShapeLift | Any) -> Float[Tensor, " batch"] | Float[Tensor, ""]:
        """Return the penalty, lower is better: one number, or for poses one for each frame."""
        raise NotImplementedError(f"{type(self).__name__} has no loss(self, lift)")

    def critic_loss(
        self, real: Float[Tensor, "batch ..."], reprojected: Float[Tensor, "views ..."]
    ) -> Float[Tensor, ""] | None:
        """Return what the prior's own parameters are trained on, or None.

        A prior that overrides this is adversarial: its parameters are frozen while `loss` trains the lifter.

        Args:
            real: keypoints (batch joints 2) of the data, missing joints 0; or masks (batch side side).
            reprojected: random views, detached: keypoints with the same joints missing, or silhouettes.
        """
        return None

    def metrics(self, lift: Lift | ShapeLift | Any) -> dict[str, float]:
        """Return numbers to log, by name."""
        return {}


class ShapePrior(Prior):
    """A `Prior` that judges shapes and their silhouettes: there is no skeleton, and `loss` gets a `ShapeLift`.

    Example (``priors.light.use=my.py:Light``)::

        class Light(uplift.ShapePrior):
            def loss(self, lift):
                return lift.occupancy.mean()
    """

    judges = "shapes"

    def __init__(self) -> None:
        nn.Module.__init__(self)
