"""Rotations of numpy arrays: about axes, as quaternions (x y z w), and nearest to a matrix (orthogonal Procrustes)."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

__all__ = [
    "least_turn", "nearest_rotation", "quaternion_entries", "quaternion_matrix", "quaternion_product",
    "rotation_about", "rotation_by", "slerp",
]  # fmt: skip


def rotation_about(
    axis: str | tuple[float, float, float] | Float[np.ndarray, " 3"], angle_rad: Float[np.ndarray, "*any"]
) -> Float[np.ndarray, "*any 3 3"]:
    """Return the right-handed rotations about "x", "y" or "z", or about any unit axis (Rodrigues' formula)."""
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    if isinstance(axis, str):
        here = "xyz".index(axis)
        first, second = (here + 1) % 3, (here + 2) % 3
        rotation = np.zeros((*np.shape(angle_rad), 3, 3))
        rotation[..., here, here] = 1
        rotation[..., first, first] = rotation[..., second, second] = cosine
        rotation[..., first, second], rotation[..., second, first] = -sine, sine
        return rotation
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=angle_rad.dtype)
    sine, cosine = sine[..., None, None], cosine[..., None, None]
    return np.eye(3, dtype=angle_rad.dtype) + sine * cross + (1 - cosine) * (cross @ cross)


def rotation_by(vector: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any 3 3"]:
    """Return the right-handed rotations about vectors by their lengths, radians (Rodrigues; OpenCV's rvec)."""
    half = np.linalg.norm(vector, axis=-1, keepdims=True) / 2
    return quaternion_matrix(np.concatenate([vector / 2 * np.sinc(half / np.pi), np.cos(half)], -1))


# Quaternions: unit ones are rotations.


def quaternion_matrix(quaternion: Float[np.ndarray, "*any 4"]) -> Float[np.ndarray, "*any 3 3"]:
    """Return the rotation matrices of unit quaternions."""
    return np.stack(quaternion_entries(*np.moveaxis(quaternion, -1, 0)), -1).reshape(*quaternion.shape[:-1], 3, 3)


def quaternion_entries(x: Any, y: Any, z: Any, w: Any) -> list[Any]:
    """Return the nine entries of the rotation matrix, row by row, of arrays or tensors."""
    return [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip


def quaternion_product(
    second: Float[np.ndarray, "*any 4"], first: Float[np.ndarray, "*any 4"]
) -> Float[np.ndarray, "*any 4"]:
    """Return the quaternions that turn by ``first``, then by ``second``."""
    a, b = second[..., :3], first[..., :3]
    vector = second[..., 3:] * b + first[..., 3:] * a + np.cross(a, b)
    return np.concatenate([vector, second[..., 3:] * first[..., 3:] - (a * b).sum(-1, keepdims=True)], -1)


def slerp(start: Float[np.ndarray, " 4"], end: Float[np.ndarray, " 4"], share: float) -> Float[np.ndarray, " 4"]:
    """Return the quaternion ``share`` along the shorter arc between two (Shoemake 1985)."""
    cosine = float(start @ end) / max(float(np.linalg.norm(start) * np.linalg.norm(end)), 1e-12)
    end = -end if cosine < 0 else end
    angle = np.arccos(min(abs(cosine), 1.0))
    if angle < 1e-4:
        return (1 - share) * start + share * end
    return (np.sin((1 - share) * angle) * start + np.sin(share * angle) * end) / np.sin(angle)


def least_turn(start: Float[np.ndarray, "*#any 3"], end: Float[np.ndarray, "*#any 3"]) -> Float[np.ndarray, "*#any 4"]:
    """Return the quaternions of the least rotations from one unit direction to another.

    For opposite directions, where there are many, a half turn about one axis across them.
    """
    cosine = (start * end).sum(-1, keepdims=True)
    turn = np.concatenate([np.cross(start, end), 1 + cosine], -1)
    aside = np.cross(start, np.eye(3)[np.argmin(np.abs(start), axis=-1)])
    half = np.concatenate([aside, np.zeros_like(cosine)], -1)
    turn = np.where(cosine < -1 + 1e-12, half, turn)
    return turn / np.linalg.norm(turn, axis=-1, keepdims=True)


def nearest_rotation(
    matrix: Float[np.ndarray, "*any 3 3"], *, reflect: bool = False
) -> tuple[Float[np.ndarray, "*any 3 3"], Float[np.ndarray, "*any"]]:
    """Return the rotation R that maximises trace(R^T matrix), and that trace.

    For points x and y as rows, the matrix sum of w y x^T gives the R with the least w |y - R x|^2; the trace over
    sum of w |x|^2 is the best scale. Proper (det +1) unless ``reflect``. Source: Umeyama, TPAMI 1991, eq. 40-43.
    """
    u, singular, vt = np.linalg.svd(matrix)
    if not reflect:
        sign = np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)
        u[..., 2] *= sign[..., None]
        singular[..., 2] *= sign
    return u @ vt, np.asarray(singular.sum(-1))
