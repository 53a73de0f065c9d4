"""The orientation prior: left is on the left of forward, which rules out the depth-mirrored pose."""

from __future__ import annotations

import warnings
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from uplift.data.tensors import TrainingSet
from uplift.errors import NotForThisSkeleton, UserError, did_you_mean
from uplift.geometry.rotation import level, turn
from uplift.priors.base import Lift, Prior
from uplift.skeleton import Skeleton

__all__ = ["Handedness", "handedness"]

_SHORT = 1e-3
"""Mean 2D radii: a direction shorter than this fades to a handedness of 0."""


def handedness(
    up: Float[Tensor, "*batch 3"], front: Float[Tensor, "*batch 3"], left: Float[Tensor, "*batch 3"], *, planar: bool
) -> Float[Tensor, "*batch"]:
    """Return the sine of the angle from front to left about ``up``: (up x front) . left, divided by the lengths.

    Positive for a real body in a frame with x right, y down, z away, negative for its mirror image (Kudo et al.
    2018, 3.4, with the sign for our frame). ``planar`` divides by the lengths in the plane normal to ``up``, as
    their code does; otherwise by the full lengths, as printed. Coincident joints give 0, with a gradient of at
    most a thousand.
    """
    triple = (torch.linalg.cross(up, front) * left).sum(-1)
    sides = torch.stack([front, left])
    of_front, of_left = _length(_normal_part(sides, up) if planar else sides)
    return triple / (_length(up) * of_front * of_left)


def _normal_part(vector: Tensor, up: Tensor) -> Tensor:
    share = (vector * up).sum(-1, keepdim=True) / up.square().sum(-1, keepdim=True).clamp_min(_SHORT**2)
    return vector - share * up


def _length(vector: Tensor) -> Tensor:
    return vector.square().sum(-1).clamp_min(_SHORT**2).sqrt()


class Handedness(Prior):
    """Hinge on `handedness` of the skeleton's facing directions.

    Args:
        skeleton: with directions ``front`` and ``left``, and ``up`` if it has no gravity.
        front, left: replace the skeleton's directions, as ``[from, to]``.
        planar: whether the angle is measured in the plane normal to up.
        frame: of up, if the skeleton does not give it: ``level`` with the estimated tilt undone, or ``camera``.
        margin: the least sine that costs nothing.
        labels: whether directions that most labelled poses contradict are reversed, with a warning.
    """

    sign: Tensor
    ends: Tensor
    """(directions, 2, joints), 1 for the joints that a direction is from, and for those that it is to."""
    upward: Tensor

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        front: Any = None,
        left: Any = None,
        planar: bool = True,
        frame: str = "level",
        margin: float = 0.0,
        labels: bool = True,
    ):
        super().__init__(skeleton)
        if frame not in ("level", "camera"):
            raise UserError(f"priors.handedness.frame={frame!r}.{did_you_mean(frame, ('level', 'camera'))}")
        given = {name: value for name, value in (("front", front), ("left", left)) if value is not None}
        self.directions = {**skeleton.facing, **{name: _direction(name, given[name], skeleton) for name in given}}
        needed = ("front", "left") if skeleton.gravity else ("front", "left", "up")
        missing = [name for name in needed if name not in self.directions]
        if missing:
            raise NotForThisSkeleton(
                f"skeleton '{skeleton.name}' gives no facing direction {', '.join(missing)}, and without it a pose and "
                "its depth-mirrored image cannot be distinguished (give it `facing:`, or set priors.handedness.weight=0)."
            )
        self.planar, self.frame, self.margin, self.labels = planar, frame, margin, labels
        self.register_buffer("sign", torch.ones(()))
        ends = [
            [[float(joint in end) for joint in skeleton.joints] for end in ends] for ends in self.directions.values()
        ]
        self.register_buffer("ends", torch.tensor(ends), persistent=False)
        self.register_buffer("upward", torch.tensor([0.0, -1.0, 0.0]), persistent=False)

    def prepare(self, data: TrainingSet) -> None:
        """Compare the directions with the labelled poses, if there are any."""
        if not self.labels or data.labels is None:
            return
        pose = data.labels[data.labelled]
        known = pose.isfinite().all(-1).to(pose.dtype)
        tilt = torch.zeros_like(pose[:, 0, 0])
        if data.label_tilt is not None:
            tilt = data.label_tilt[data.labelled].nan_to_num()
        value, shown = self.value(pose.nan_to_num(), tilt, known)
        if shown.any() and float(Lift.mean((value > 0).float(), shown)) < 0.5:
            self.sign.neg_()
            warnings.warn(
                f"the facing directions of skeleton '{self.skeleton.name}' are contradicted by most labelled poses and "
                "are reversed: correct its `facing:` (uplift skeleton check).",
                stacklevel=2,
            )

    def value(
        self,
        pose: Float[Tensor, "batch joints 3"],
        tilt: Float[Tensor, " batch"],
        visible: Float[Tensor, "batch joints"],
    ) -> tuple[Float[Tensor, " batch"], Float[Tensor, " batch"]]:
        """Return each frame's handedness and whether all its ends have a visible joint (0 or 1)."""
        weight = visible[:, None, None] * self.ends
        total = weight.sum(-1, keepdim=True)
        share = weight / total.clamp_min(1)
        directions = (share[:, :, 1] - share[:, :, 0]) @ pose
        if self.frame == "level" and self.skeleton.gravity:
            directions = turn(directions, level(tilt))
        found = dict(zip(self.directions, directions.unbind(1), strict=True))
        up = found.get("up", self.upward.expand(len(pose), 3))
        value = self.sign * handedness(up, found["front"], found["left"], planar=self.planar)
        return value, (total.amin((1, 2, 3)) > 0).to(pose.dtype)

    def loss(self, lift: Lift) -> Tensor:
        """Return max(0, margin - handedness) averaged over the frames that show it."""
        value, known = self.value(lift.pose, lift.tilt, lift.visible)
        return Lift.mean((self.margin - value).clamp_min(0), known)

    def metrics(self, lift: Lift) -> dict[str, float]:
        """Return the share of frames whose handedness is right."""
        value, known = self.value(lift.pose.detach(), lift.tilt.detach(), lift.visible)
        return {"facing_sign": float(Lift.mean((value > 0).float(), known))}


def _direction(name: str, value: Any, skeleton: Skeleton) -> tuple[tuple[str, ...], tuple[str, ...]]:
    where = f"priors.handedness.{name}"
    ends = [(end,) if isinstance(end, str) else end for end in value] if isinstance(value, (list, tuple)) else []
    if len(ends) != 2 or not all(isinstance(end, (list, tuple)) and end for end in ends):
        raise UserError(f"{where}={value!r}: expected [from, to], each a joint or a list of joints.")
    for joint in (*ends[0], *ends[1]):
        if joint not in skeleton.joints:
            raise UserError(f"{where}: no joint '{joint}' in '{skeleton.name}'.{did_you_mean(joint, skeleton.joints)}")
    return tuple(ends[0]), tuple(ends[1])
