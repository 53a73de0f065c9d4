"""Rotations of poses: views about gravity or uniform on SO(3), and where gravity points."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from uplift.config.ranks import drawn
from uplift.geometry.rigid import quaternion_entries

__all__ = [
    "about_x", "about_y", "about_z", "body_tilt", "clip_direction", "clip_median", "gravity_of", "least_rotation", "level", "nearest_rotation",
    "random_rotations", "real_tilt", "turn", "views_about_gravity",
]  # fmt: skip


def about_x(angle: Float[Tensor, " batch"]) -> Float[Tensor, "batch 3 3"]:
    """Return rotations about x, the image's right: y turns towards z for a positive angle."""
    return _plane_rotation(angle, 1, 2)


def about_y(angle: Float[Tensor, " batch"]) -> Float[Tensor, "batch 3 3"]:
    """Return rotations about y, gravity in the level frame: x' = x cos + z sin (Kudo et al. 2018, eq. 1)."""
    return _plane_rotation(angle, 2, 0)


def about_z(angle: Float[Tensor, " batch"]) -> Float[Tensor, "batch 3 3"]:
    """Return rotations about z, the direction away from the camera: x turns towards y for a positive angle."""
    return _plane_rotation(angle, 0, 1)


def _plane_rotation(angle: Tensor, first: int, second: int) -> Tensor:
    cos, sin, zero = angle.cos(), angle.sin(), torch.zeros_like(angle)
    entries = [zero] * 9
    entries[4 * (3 - first - second)] = torch.ones_like(angle)
    entries[4 * first] = entries[4 * second] = cos
    entries[3 * second + first], entries[3 * first + second] = sin, -sin
    return torch.stack(entries, -1).unflatten(-1, (3, 3))


def level(tilt: Float[Tensor, " batch"]) -> Float[Tensor, "batch 3 3"]:
    """Return the rotations from the camera frame to the level frame, where y is gravity.

    A camera tilted down by ``tilt`` radians sees gravity at (0, cos, sin).
    """
    return about_x(-tilt)


def least_rotation(start: Float[Tensor, "batch 3"], end: Float[Tensor, " 3"]) -> Float[Tensor, "batch 3 3"]:
    """Return the smallest rotations that take each ``start`` to the direction ``end`` (Rodrigues' formula).

    The two must not point exactly away from each other: there the rotation is not defined.
    """
    start = torch.nn.functional.normalize(start, dim=-1)
    end = torch.nn.functional.normalize(end, dim=-1).expand_as(start)
    x, y, z = torch.linalg.cross(start, end).unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    cosine = (start * end).sum(-1)
    identity = torch.eye(3, dtype=start.dtype, device=start.device)
    return identity + skew + skew @ skew / (1 + cosine).clamp_min(1e-6)[:, None, None]


def views_about_gravity(
    tilt: Float[Tensor, " batch"], azimuth: Float[Tensor, " batch"], new_tilt: Float[Tensor, " batch"]
) -> Float[Tensor, "batch 3 3"]:
    """Return rotations from each camera to one turned by ``azimuth`` about gravity and tilted by ``new_tilt``.

    Undo the pose's own tilt, turn about gravity, tilt the new camera (ElePose, Wandt et al. 2022).
    All angles in radians.
    """
    return level(new_tilt).mT @ about_y(azimuth) @ level(tilt)


def random_rotations(count: int, device: torch.device | str = "cpu") -> Float[Tensor, "count 3 3"]:
    """Return rotations uniform on SO(3), from uniform unit quaternions (Shoemake 1992)."""
    u, v, w = drawn(count, lambda rows: torch.rand(3, rows, device=device), dim=1)
    v, w = 2 * math.pi * v, 2 * math.pi * w
    a, b = (1 - u).sqrt(), u.sqrt()
    entries = quaternion_entries(a * v.sin(), a * v.cos(), b * w.sin(), b * w.cos())
    return torch.stack(entries, -1).reshape(count, 3, 3)


def nearest_rotation(matrix: Float[Tensor, "batch 3 3"]) -> Float[Tensor, "batch 3 3"]:
    """Return the proper rotations nearest to matrices; of ``y.mT @ x`` those that bring the points x onto y (Kabsch 1976)."""
    left, _, right = torch.linalg.svd(matrix)
    proper = torch.linalg.det(left @ right)
    left = torch.cat([left[..., :2], left[..., 2:] * proper[:, None, None]], -1)
    return left @ right


def turn(pose: Float[Tensor, "batch joints 3"], view: Float[Tensor, "batch 3 3"]) -> Float[Tensor, "batch joints 3"]:
    """Return ``pose`` seen from ``view``: every joint multiplied by its frame's rotation."""
    return pose @ view.mT


# Where gravity points: from the lifter's tilt, from the bodies, and steady over a clip.

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
    """Return each frame's camera tilt, radians, estimated from the bodies, and the trust in each frame.

    ``pose`` is in the frame of a camera that does not roll, so its x axis is level whatever the tilt.
    Over many views one direction of the body is level least of all: its upright, which is the world's
    where the body stands as it mostly does. No label is needed: bodies are fitted to their mean shape
    (Kabsch 1976), and the direction most orthogonal to the camera's x axis in the body's frame is an
    eigenvector, re-weighted for those who bend.
    """
    size = pose.norm(dim=-1).mean(1).clamp_min(1e-6)
    shape = pose / size[:, None, None]
    template = shape[0]
    for _ in range(_ROUNDS):
        turned, away = _fitted(shape, template)
        usual = away <= away.quantile(0.7) if len(away) < 1_000_000 else torch.ones_like(away, dtype=torch.bool)
        template = (turned.mT @ shape.mT).mT[usual].mean(0)
    turned, away = _fitted(shape, template)
    trust = torch.exp(-away / away.median().clamp_min(1e-9))
    side = turned[:, 0]
    weight = trust
    for _ in range(_ROUNDS):
        upright = torch.linalg.eigh((side * weight[:, None]).mT @ side)[1][:, 0]
        weight = trust / (1 + (side @ upright / _SLACK).square())
    up = turned @ upright
    up = torch.where((up[:, 1] * trust).sum() > 0, -up, up)
    return torch.atan2(-up[:, 2], -up[:, 1]), trust


def _fitted(shape: Tensor, template: Tensor) -> tuple[Tensor, Tensor]:
    """Return the rotations of the template that fit the shapes best, and the squared distances that are left."""
    turned = nearest_rotation(shape.mT @ template)
    return turned, (shape - template @ turned.mT).square().sum((1, 2))


def clip_median(
    value: Float[Tensor, " frames"], weight: Float[Tensor, " frames"], clip: Int[Tensor, " frames"]
) -> Float[Tensor, " frames"]:
    """Return, for each frame, the weighted median over its clip."""
    order = torch.argsort(value)
    order = order[torch.argsort(clip[order], stable=True)]
    counts = torch.bincount(clip)
    ends = counts.cumsum(0)
    digits = torch.float32 if weight.device.type == "mps" else torch.float64  # Apple's GPUs have no other
    total = weight[order].cumsum(0, dtype=digits)
    before = torch.cat([total.new_zeros(1), total])[ends - counts]
    half = before + (total[ends - 1] - before) / 2
    place = torch.clamp(torch.searchsorted(total, half), ends - counts, ends - 1)  # without weight, its first
    return value[order[place]][clip]


def clip_direction(vector: Float[Tensor, "frames 3"], clip: Int[Tensor, " frames"]) -> Float[Tensor, "frames 3"]:
    """Return, for each frame, the unit vector along the median of its clip's vectors; long ones count more.

    The geometric median of the directions (Weiszfeld 1937), which a minority of frames far off does not move.
    """
    length = vector.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    unit, weight, count = vector / length, length, int(clip.max()) + 1 if len(clip) else 0
    median = unit
    for _ in range(_ROUNDS):
        total = vector.new_zeros(count, 3).index_add_(0, clip, unit * weight)
        median = torch.nn.functional.normalize(total, dim=-1)[clip]
        weight = length / ((unit - median).norm(dim=-1, keepdim=True) + _SLACK / 10)
    return median
