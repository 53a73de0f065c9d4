"""Where gravity points: from the lifter's tilt, from what bodies do, and steady over a clip."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from uplift.views import turn

__all__ = ["body_tilt", "clip_median", "gravity_of", "real_tilt"]

_ROUNDS = 5
_SLACK = 0.1


def gravity_of(
    tilt: Float[Tensor, " frames"], rotation: Float[Tensor, "frames 3 3"] | None
) -> Float[Tensor, "frames 3"]:
    """Return gravity as a camera turned by ``rotation`` sees it, where the real one is tilted down by ``tilt``.

    Radians. The real camera does not roll: gravity is (0, cos, sin) in its frame.
    """
    real = torch.stack([torch.zeros_like(tilt), tilt.cos(), tilt.sin()], -1)
    return real if rotation is None else turn(real[:, None], rotation)[:, 0]


def real_tilt(tilt: Float[Tensor, " frames"], rotation: Float[Tensor, "frames 3 3"] | None) -> Float[Tensor, " frames"]:
    """Return the tilt of the real camera, which does not roll, from that of one turned by ``rotation``.

    The turned camera's tilt fixes how far gravity points along its axis, and of all tilts of the
    real camera one gives that: sin(tilt) = R32 cos(real) + R33 sin(real). Radians.
    """
    if rotation is None:
        return tilt
    across, along = rotation[:, 2, 1], rotation[:, 2, 2]
    size = (across.square() + along.square()).sqrt().clamp_min(1e-6)
    return torch.asin((tilt.sin() / size).clamp(-1, 1)) - torch.atan2(across, along)


def body_tilt(pose: Float[Tensor, "frames joints 3"]) -> tuple[Float[Tensor, " frames"], Float[Tensor, " frames"]]:
    """Return each frame's camera tilt, radians, as the bodies tell it, and how much each frame is to be trusted.

    ``pose`` is in the frame of a camera that does not roll, so its x axis is level whatever the tilt.
    Over many views of bodies there is one direction in the body that is level least of all: its own
    upright, which is the world's where the body stands as it mostly does. It is found without any
    label: bodies are fitted to their mean shape (Kabsch 1976), and the direction most orthogonal to
    the camera's x axis in the body's frame is an eigenvector, re-weighted for those who bend.
    """
    size = pose.norm(dim=-1).mean(1).clamp_min(1e-6)
    shape = pose / size[:, None, None]
    template = shape[0]
    for _ in range(_ROUNDS):
        turned = _onto(shape, template)
        away = _residual(shape, turned, template)
        usual = away <= away.quantile(0.7) if len(away) < 1_000_000 else torch.ones_like(away, dtype=torch.bool)
        template = (turned.mT @ shape.mT).mT[usual].mean(0)
    turned = _onto(shape, template)
    away = _residual(shape, turned, template)
    trust = torch.exp(-away / away.median().clamp_min(1e-9))
    side = turned[:, 0]
    weight = trust
    for _ in range(_ROUNDS):
        upright = torch.linalg.eigh((side * weight[:, None]).mT @ side)[1][:, 0]
        weight = trust / (1 + (side @ upright / _SLACK).square())
    up = turned @ upright
    up = torch.where((up[:, 1] * trust).sum() > 0, -up, up)
    return torch.atan2(-up[:, 2], -up[:, 1]), trust


def _onto(shape: Tensor, template: Tensor) -> Tensor:
    """Return the proper rotations R for which ``R @ template`` is nearest to each shape."""
    left, _, right = torch.linalg.svd(shape.mT @ template)
    proper = torch.linalg.det(left @ right)
    left = torch.cat([left[..., :2], left[..., 2:] * proper[:, None, None]], -1)
    return left @ right


def _residual(shape: Tensor, turned: Tensor, template: Tensor) -> Tensor:
    return (shape - template @ turned.mT).square().sum((1, 2))


def clip_median(
    value: Float[Tensor, " frames"], weight: Float[Tensor, " frames"], clip: Int[Tensor, " frames"]
) -> Float[Tensor, " frames"]:
    """Return, for each frame, the weighted median over its clip."""
    order = torch.argsort(value)
    order = order[torch.argsort(clip[order], stable=True)]
    counts = torch.bincount(clip)
    ends = counts.cumsum(0)
    total = weight[order].double().cumsum(0)
    before = torch.cat([total.new_zeros(1), total])[ends - counts]
    half = before + (total[ends - 1] - before) / 2
    place = torch.minimum(torch.searchsorted(total, half), ends - 1)
    return value[order[place]][clip]
