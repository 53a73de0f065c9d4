"""The rest directions of a rig: the skeleton's rest pose, or the mean shape of the clip."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from uplift.prediction import Prediction
from uplift.skeleton import Skeleton
from uplift.skeleton.layout import rest_pose
from uplift.writers.moving import from_y_down

__all__ = ["nearest_rotation", "rest_directions"]

_ROUNDS = 3
_SCATTERED = 0.3


def rest_directions(
    prediction: Prediction, ways: dict[str, Float[np.ndarray, "frames 3"]], lengths: dict[str, float]
) -> dict[str, Float[np.ndarray, "3"]]:
    """Return the direction of every bone (by its child) in the rest pose, for a body that faces the viewer.

    Where the skeleton gives no rest pose it is the mean of the clip's frames, each turned onto the first.
    """
    skeleton = prediction.skeleton
    axes = from_y_down(prediction.axes)
    pose = rest_pose(skeleton)
    if pose is None:
        return _facing(skeleton, _mean_shape(ways), lengths, axes)
    steps = {
        joint: pose[skeleton.index(joint)] - pose[skeleton.index(parent)]
        for joint, parent in skeleton.parents.items()
        if parent is not None
    }
    return {joint: axes @ step / np.linalg.norm(step) for joint, step in steps.items()}


def nearest_rotation(matrix: Float[np.ndarray, "*frames 3 3"]) -> Float[np.ndarray, "*frames 3 3"]:
    """Return the proper rotation nearest to each matrix."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., -1] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def _mean_shape(ways: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return mean directions; those of the fullest frame for a bone that points everywhere."""
    stacked = np.stack(list(ways.values()), 1)
    known = np.isfinite(stacked.sum(-1))
    first = int(np.argmax(known.sum(1)))
    shape = np.where(known[first][:, None], stacked[first], 0)
    whole, count = np.nan_to_num(stacked), np.maximum(known.sum(0), 1)[:, None]
    for _ in range(_ROUNDS):
        turn = nearest_rotation(np.einsum("bi,fbj->fij", shape, whole) + 1e-9 * np.eye(3))
        mean = np.einsum("fij,fbj->bi", turn, whole) / count
        scattered = np.linalg.norm(mean, axis=-1) < _SCATTERED
        mean[scattered & known[first]] = stacked[first][scattered & known[first]]
        size = np.linalg.norm(mean, axis=-1, keepdims=True)
        shape = np.where(size > 1e-6, mean / np.maximum(size, 1e-6), [0.0, 1.0, 0.0])
    return dict(zip(ways, shape, strict=True))


def _facing(
    skeleton: Skeleton, rest: dict[str, np.ndarray], lengths: dict[str, float], axes: np.ndarray
) -> dict[str, np.ndarray]:
    """Turn the shape to face the viewer, upright as it is under gravity; as it is where there is no front."""
    if "front" not in skeleton.facing:
        return rest
    pose = np.zeros((len(skeleton.joints), 3))
    for joint, parent in skeleton.parents.items():
        if parent is not None:
            pose[skeleton.index(joint)] = pose[skeleton.index(parent)] + rest[joint] * lengths[joint]
    front = skeleton.facing_matrix("front") @ pose
    up = axes @ [0.0, -1.0, 0.0]
    own_up = up if skeleton.gravity or "up" not in skeleton.facing else skeleton.facing_matrix("up") @ pose
    own, wanted = _basis(own_up, front), _basis(up, axes @ [0.0, 0.0, -1.0])
    if own is None or wanted is None:
        return rest
    return {joint: wanted.T @ own @ way for joint, way in rest.items()}


def _basis(up: np.ndarray, front: np.ndarray) -> Float[np.ndarray, "3 3"] | None:
    """Return the rows up, front and the side of a body; None where front is along up."""
    up = up / max(float(np.linalg.norm(up)), 1e-12)
    front = front - up * (up @ front)
    size = float(np.linalg.norm(front))
    if size < 1e-6 or not np.linalg.norm(up) > 0.5:
        return None
    return np.stack([up, front / size, np.cross(up, front / size)])
