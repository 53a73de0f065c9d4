"""`Prior` and what it sees of a training step (`Lift`), and the checks that no prior fails in silence."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor, nn

from uplift.errors import UserError
from uplift.geometry.normalise import renormalise
from uplift.geometry.rotation import level, turn
from uplift.models.lifter import Lifted, Lifter
from uplift.skeleton import Skeleton

if TYPE_CHECKING:
    from uplift.data.tensors import TrainingSet

__all__ = ["Lift", "Prior", "PriorWatch", "blame"]

# What a prior sees of one training step: the lifted poses, the views they are turned to, the labels.


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


# `Prior`: a term of the objective that judges lifted poses or their turned views.


class Prior(nn.Module):
    """Subclass this, write `loss`, and name your class in a task: ``priors.ground.use=my.py:FlatGround``.

    Options of your own are keyword arguments of ``__init__`` with defaults; they are set beside
    ``use`` and ``weight``. Trainable parameters are ordinary ``nn.Parameter`` and are trained with
    the lifter.
    """

    gate_itself: bool = False
    """Set by a prior that trains itself: its own parameters stay as they are in this step."""
    gate_lifter: bool = False
    """Set by a prior that trains itself: the lifter stays as it is in this step."""

    def __init__(self, skeleton: Skeleton):
        super().__init__()
        self.skeleton = skeleton

    def prepare(self, data: TrainingSet) -> None:
        """Look at the training data (2D only) once, before the first step: fit a flow, measure ratios."""

    def loss(self, lift: Lift) -> Float[Tensor, " batch"] | Float[Tensor, ""]:
        """Return the penalty, a number for each frame or one for all; lower is better."""
        raise NotImplementedError(f"{type(self).__name__} has no loss(self, lift)")

    def own_loss(
        self, real: Float[Tensor, "batch joints 2"], seen: Float[Tensor, "batch joints 2"]
    ) -> Float[Tensor, ""] | None:
        """Return what the prior's own parameters are trained on, or None.

        ``real`` are keypoints of the data and ``seen`` the turned views, detached; joints missing in
        the data are 0 in both. A prior with an `own_loss` is adversarial: its parameters are held
        still while `loss` trains the lifter.
        """
        return None

    def metrics(self, lift: Lift) -> dict[str, float]:
        """Return numbers worth logging, by name."""
        return {}


# Call a prior's hooks and refuse what would fail in silence: no gradient, NaN, a wrong shape.

_PATIENCE = 20
_PACKAGE = Path(__file__).resolve().parent.parent


class PriorWatch:
    """Calls each prior's `loss` and `own_loss` and checks what comes back.

    A loss is connected when it carries a graph to something trainable. A constant 0 may be a
    satisfied hinge written with an ``if``: it is refused when twenty steps have brought no graph.
    """

    def __init__(self, priors: Mapping[str, Prior]):
        self.priors = dict(priors)
        self.connected: set[str] = set()
        self.calls = dict.fromkeys(priors, 0)

    def loss(self, name: str, lift: Lift, step: int) -> Tensor:
        """Return the prior's loss as one number."""
        prior = self.priors[name]
        with blame(name, prior, "loss"):
            value = prior.loss(lift)
        if not isinstance(value, Tensor) or value.shape not in ((), (len(lift.pose),)):
            found = f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
            raise UserError(
                f"priors.{name}: loss(lift) returned {found}, expected one number (shape ()) or one a frame "
                f"(shape ({len(lift.pose)},))."
            )
        if value.is_complex():
            raise UserError(f"priors.{name}: loss(lift) returned {value.dtype}, expected real numbers.")
        value = value.mean() if value.is_floating_point() else value.float().mean()
        self._check(name, value, step)
        return value

    def own_loss(self, name: str, real: Tensor, seen: Tensor) -> Tensor | None:
        """Return what the prior trains itself on in this step."""
        prior = self.priors[name]
        with blame(name, prior, "own_loss"):
            own = prior.own_loss(real, seen)
        if own is None:
            return None
        if not isinstance(own, Tensor) or own.shape != () or not own.requires_grad:
            raise UserError(
                f"priors.{name}: own_loss(real, seen) must return one number (a tensor of shape ()) that depends on "
                "the prior's own parameters."
            )
        return own

    def metrics(self, name: str, lift: Lift) -> dict[str, float]:
        """Return what the prior wants logged, under its name."""
        prior = self.priors[name]
        with blame(name, prior, "metrics"):
            found = prior.metrics(lift)
            return {f"{name}_{key}": float(value) for key, value in found.items()}

    def _check(self, name: str, value: Tensor, step: int) -> None:
        if name not in self.connected:
            self.calls[name] += 1
            if value.requires_grad:
                self.connected.add(name)
            elif bool(value != 0) or self.calls[name] >= _PATIENCE:
                raise UserError(
                    f"priors.{name}: its loss depends on nothing that can be trained (no gradient reaches the pose or "
                    "parameters of its own). Compute it from lift.pose, lift.level_pose, lift.turned or lift.seen, "
                    "without .detach(), .numpy() or comparisons in place of differences."
                )
        if value.device.type == "cpu" and not bool(torch.isfinite(value)):
            raise UserError(
                f"priors.{name}: loss is {value.item()} at step {step}. Look for a division by 0, a square root or "
                "a norm of 0 (add a small number), or a learning rate that is too high."
            )


class blame:
    """Turn an error inside a user's own prior into a `UserError` that names file and line."""

    def __init__(self, name: str, prior: nn.Module, hook: str):
        self.name, self.prior, self.hook = name, prior, hook

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if not isinstance(error, Exception) or isinstance(error, UserError):
            return
        if type(self.prior).__module__.startswith("uplift."):
            return
        frames = traceback.extract_tb(error.__traceback__)
        own = [f for f in frames if _PACKAGE not in Path(f.filename).resolve().parents]
        place = next((f for f in own if "site-packages" not in f.filename), None)
        # A hook with other arguments, or one that returns what cannot be read, fails in our frames alone.
        where = f"{place.filename}, line {place.lineno}" if place else f"{_file_of(self.prior)}"
        raise UserError(
            f"priors.{self.name}: {self.hook} failed in {where}: {type(error).__name__}: {error}"
        ) from error


def _file_of(prior: nn.Module) -> str:
    module = sys.modules.get(type(prior).__module__)
    return f"{type(prior).__name__} of {getattr(module, '__file__', None) or type(prior).__module__}"
