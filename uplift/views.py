"""Turn poses: views about gravity with the camera's own tilts, or uniform on SO(3)."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["about_x", "about_y", "least_rotation", "level", "random_rotations", "turn", "views_about_gravity"]


def about_x(angle: Float[Tensor, " batch"]) -> Float[Tensor, "batch 3 3"]:
    """Return rotations about x, the image's right: y turns towards z for a positive angle."""
    return _plane_rotation(angle, 1, 2)


def about_y(angle: Float[Tensor, " batch"]) -> Float[Tensor, "batch 3 3"]:
    """Return rotations about y, gravity in the level frame: x' = x cos + z sin (Kudo et al. 2018, eq. 1)."""
    return _plane_rotation(angle, 2, 0)


def _plane_rotation(angle: Tensor, first: int, second: int) -> Tensor:
    cos, sin = angle.cos(), angle.sin()
    rotation = torch.zeros(*angle.shape, 3, 3, dtype=angle.dtype, device=angle.device)
    rotation[..., 3 - first - second, 3 - first - second] = 1
    rotation[..., first, first] = cos
    rotation[..., second, second] = cos
    rotation[..., second, first] = sin
    rotation[..., first, second] = -sin
    return rotation


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
    """Return rotations from each camera to one that walked round by ``azimuth`` and tilts by ``new_tilt``.

    Undo the pose's own tilt, turn about gravity, tilt the new camera (ElePose, Wandt et al. 2022).
    All angles in radians.
    """
    return level(new_tilt).mT @ about_y(azimuth) @ level(tilt)


def random_rotations(count: int, device: torch.device | str = "cpu") -> Float[Tensor, "count 3 3"]:
    """Return rotations uniform on SO(3), from uniform unit quaternions (Shoemake 1992)."""
    u, v, w = torch.rand(3, count, device=device)
    v, w = 2 * math.pi * v, 2 * math.pi * w
    a, b = (1 - u).sqrt(), u.sqrt()
    x, y, z, r = a * v.sin(), a * v.cos(), b * w.sin(), b * w.cos()
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * r), 2 * (x * z + y * r),
        2 * (x * y + z * r), 1 - 2 * (x * x + z * z), 2 * (y * z - x * r),
        2 * (x * z - y * r), 2 * (y * z + x * r), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).reshape(count, 3, 3)


def turn(pose: Float[Tensor, "batch joints 3"], view: Float[Tensor, "batch 3 3"]) -> Float[Tensor, "batch joints 3"]:
    """Return ``pose`` seen from ``view``: every joint multiplied by its frame's rotation."""
    return pose @ view.mT
