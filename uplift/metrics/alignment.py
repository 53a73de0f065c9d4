"""Bring a predicted pose to the truth's scale, or its scale, place and rotation, before an error is taken."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from uplift.errors import UserError, did_you_mean
from uplift.geometry.rigid import nearest_rotation

__all__ = [
    "ALIGNED_ERRORS", "align", "clean_pair", "counted", "least_squares_scale", "length", "norm_scale", "procrustes",
    "xy_scale",
]  # fmt: skip

ALIGNED_ERRORS = ("mpjpe", "mpjpe_gt_scale", "n_mpjpe", "n_mpjpe_norm", "p_mpjpe", "p_mpjpe_reflect")
"""The errors that differ only in the alignment before them, by their protocol names."""

_SPREAD = 1e-12
"""Joints that lie closer together than this share of their distance to the origin are one point."""

Poses = Float[np.ndarray, "frames joints 3"]
Weights = Float[np.ndarray, "frames joints"] | Bool[np.ndarray, "frames joints"]


def align(protocol: str, pose: Poses, truth: Poses, root: int, weight: Weights | None = None) -> Poses:
    """Return ``pose`` aligned as ``protocol`` (one of `ALIGNED_ERRORS`) says, joints of weight 0 with it.

    ``root`` is the place of the root joint: it sits at the origin and is left out of the xy scale.
    Where ``weight`` is 0, or either pose is not finite, a joint does not count in the alignment.
    """
    pose = np.asarray(pose, np.float64)
    match protocol:
        case "mpjpe":
            return pose
        case "mpjpe_gt_scale":
            return pose * xy_scale(pose, truth, root, weight)[:, None, None]
        case "n_mpjpe":
            return pose * least_squares_scale(pose, truth, weight)[:, None, None]
        case "n_mpjpe_norm":
            return pose * norm_scale(pose, truth, weight)[:, None, None]
        case "p_mpjpe":
            return procrustes(pose, truth, weight)
        case "p_mpjpe_reflect":
            return procrustes(pose, truth, weight, reflect=True)
    raise UserError(f"There is no aligned error named '{protocol}'.{did_you_mean(protocol, ALIGNED_ERRORS)}")


def counted(pose: Poses, truth: Poses, weight: Weights | None = None) -> Weights:
    """Return ``weight`` (default 1), but 0 for joints that are not finite in both poses."""
    finite = _finite(pose) & _finite(truth)
    if weight is None:
        return finite.astype(np.float64)
    return np.where(finite & (np.asarray(weight) > 0), weight, 0.0).astype(np.float64)


def xy_scale(pose: Poses, truth: Poses, root: int, weight: Weights | None = None) -> Float[np.ndarray, " frames"]:
    """Return the mean of |truth_xy| over the joints without the root, divided by the same of ``pose``.

    Neither is re-centred. 0 where the prediction has no extent in xy. Source: the evaluation script
    released with Kudo et al. 2018.
    """
    x, y, w = clean_pair(pose, truth, weight)
    w = w.copy()
    w[:, root] = 0
    return _ratio(*((w * length(points[..., :2])).sum(1) for points in (y, x)))


def least_squares_scale(pose: Poses, truth: Poses, weight: Weights | None = None) -> Float[np.ndarray, " frames"]:
    """Return <pose, truth> / <pose, pose>, the scale of least squared error; 0 for a pose of zeros.

    Negative where that lowers the error. Source: N-MPJPE, Rhodin et al., CVPR 2018.
    """
    x, y, w = clean_pair(pose, truth, weight)
    wx = w[..., None] * x
    return _ratio(*(np.einsum("fjc,fjc->f", wx, points) for points in (y, x)))


def norm_scale(pose: Poses, truth: Poses, weight: Weights | None = None) -> Float[np.ndarray, " frames"]:
    """Return norm(truth) / norm(pose); 0 for a pose of zeros. Source: ElePose, Wandt et al., CVPR 2022."""
    x, y, w = clean_pair(pose, truth, weight)
    return np.sqrt(_ratio(*(np.einsum("fjc,fjc,fj->f", points, points, w) for points in (y, x))))


def procrustes(pose: Poses, truth: Poses, weight: Weights | None = None, *, reflect: bool = False) -> Poses:
    """Return ``pose`` moved, turned and scaled onto ``truth`` with the least squared error.

    Rotations are proper (det +1) unless ``reflect``: a mirrored pose is this method's failure
    and must cost. Poses that are flat, collinear or short of joints have several best rotations,
    all of the same error; joints all in one point go to the truth's centroid; a frame in which
    nothing counts comes back at scale 0. Source: Umeyama, TPAMI 1991, eq. 40-43.
    """
    x, y, w = clean_pair(pose, truth, weight)
    share = _ratio(w, w.sum(1, keepdims=True))
    centre_x, centre_y = (np.einsum("fj,fjc->fc", share, points)[:, None] for points in (x, y))
    spread = (x - centre_x) * share[..., None]
    variance = np.einsum("fjc,fjc->f", spread, x - centre_x)
    variance = np.where(variance > _SPREAD**2 * np.einsum("fjc,fjc,fj->f", x, x, share), variance, 0)
    rotation, size = nearest_rotation(np.swapaxes(spread, 1, 2) @ (y - centre_y), reflect=reflect)
    turn = rotation * _ratio(size, variance)[:, None, None]
    known = np.where(_finite(pose)[..., None], pose, np.nan).astype(np.float64)
    return (known - centre_x) @ turn + centre_y


def clean_pair(pose: Poses, truth: Poses, weight: Weights | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return both poses in double precision with zeros where nothing counts, and the weights."""
    weight = counted(pose, truth, weight)
    pose, truth = np.asarray(pose, np.float64), np.asarray(truth, np.float64)
    if weight.all():
        return pose, truth, weight
    some = (weight > 0)[..., None]
    return np.where(some, pose, 0), np.where(some, truth, 0), weight


def length(vectors: Float[np.ndarray, "*any axes"]) -> Float[np.ndarray, "*any"]:
    """Return the Euclidean length over the last axis."""
    return np.sqrt(np.einsum("...c,...c->...", vectors, vectors))


def _finite(points: Poses) -> np.ndarray:
    return np.isfinite(points[..., 0]) & np.isfinite(points[..., 1]) & np.isfinite(points[..., 2])


def _ratio(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Return above / below, 0 where there is nothing below."""
    above, below = np.broadcast_arrays(above, below)
    return np.divide(above, below, out=np.zeros(above.shape), where=below > np.finfo(np.float64).tiny)
