"""Rotations of numpy arrays: about axes, as quaternions (x y z w), and nearest to a matrix (orthogonal Procrustes)."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

__all__ = [
    "least_turn", "nearest_rotation", "nearest_rotations", "quaternion_entries", "quaternion_matrix", "quaternion_product",
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
    second: Float[np.ndarray, "*#any 4"], first: Float[np.ndarray, "*#any 4"]
) -> Float[np.ndarray, "*#any 4"]:
    """Return the quaternions that turn by ``first``, then by ``second``."""
    a, b = second[..., :3], first[..., :3]
    vector = second[..., 3:] * b + first[..., 3:] * a + _cross(a, b)
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
    turn = np.concatenate([_cross(start, end), 1 + cosine], -1)
    opposite = cosine[..., 0] < -1 + 1e-12
    if opposite.any():
        start = np.broadcast_to(start, (*opposite.shape, 3))[opposite]
        turn[opposite, :3] = np.cross(start, np.eye(3)[np.argmin(np.abs(start), axis=-1)])
        turn[opposite, 3] = 0
    return turn / np.linalg.norm(turn, axis=-1, keepdims=True)


def _cross(a: Float[np.ndarray, "*#any 3"], b: Float[np.ndarray, "*#any 3"]) -> Float[np.ndarray, "*#any 3"]:
    """Return what `numpy.cross` does, without its many steps for each call."""
    (ax, ay, az), (bx, by, bz) = ((one[..., 0], one[..., 1], one[..., 2]) for one in (a, b))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


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


_BLOCK = 1 << 14
_CLEAR = 0.01
"""Product of the sums of two singular values, of a matrix of size 1, from which the closed form has 12 digits."""


def nearest_rotations(matrices: Float[np.ndarray, "many 3 3"]) -> Float[np.ndarray, "many 3 3"]:
    """Return the proper rotations of `nearest_rotation`, of many matrices five times as fast, in blocks that fit a cache.

    Source: FOAM, Markley 1993, J Astronaut Sci 41(2), eq. 22-28; by singular values where that loses digits.
    """
    found = np.empty(matrices.shape)
    for start in range(0, len(matrices), _BLOCK):
        part = matrices[start : start + _BLOCK]
        found[start : start + _BLOCK], clear = _foam(np.ascontiguousarray(np.moveaxis(part, 0, -1)))
        if not clear.all():
            found[start : start + _BLOCK][~clear] = nearest_rotation(part[~clear])[0]
    return found


def _foam(b: Float[np.ndarray, "3 3 many"]) -> tuple[Float[np.ndarray, "many 3 3"], Bool[np.ndarray, " many"]]:
    """Return the rotations nearest to matrices, and which of them are exact."""
    size = np.sqrt((b * b).sum((0, 1)))
    b = b / np.where(size > 0, size, 1)
    adjoint = np.stack([_cross(b[one - 2].T, b[one - 1].T).T for one in range(3)])
    det = (b[0] * adjoint[0]).sum(0)
    last = 1 - 4 * (adjoint * adjoint).sum((0, 1))
    most = np.full(det.shape, np.sqrt(3.0))  # at least the sum of singular values, to which Newton's steps lead down
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(12):
            square = most * most
            most -= (square * (square - 2) - 8 * det * most + last) / (4 * (square - 1) * most - 8 * det)
        kappa = (most * most - 1) / 2
        zeta = kappa * most - det
        cubed = np.einsum("ikn,kjn->ijn", np.einsum("ikn,jkn->ijn", b, b), b)
        found = ((kappa + 1) * b + most * adjoint - cubed) / zeta
    return np.moveaxis(found, -1, 0), np.asarray((zeta > _CLEAR) & (size > 0))
