"""Where to draw each joint of a skeleton in the plane, from its rest pose or from its bones alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from uplift.skeleton import Skeleton
from uplift.skeleton.sides import CENTRE, LEFT, joint_sides

__all__ = ["rest_pose", "skeleton_layout"]

_AZIMUTHS_DEG = (0.0, 30.0, 55.0, 75.0)
_LOW_WORDS = ("foot", "toe", "ankle", "heel", "paw", "hoof", "tars", "claw", "leg", "tail")
_ROUNDS = 300


def rest_pose(skeleton: Skeleton) -> Float[np.ndarray, "joints 3"] | None:
    """Return the rest pose (x the body's left, y down, z behind it); None where a joint has no direction.

    A bone without a proportion has the mean of the others' lengths.
    """
    rest, lengths = skeleton.body.get("rest", {}), skeleton.body.get("proportions", {})
    if any(joint not in rest for joint in skeleton.joints if joint != skeleton.root):
        return None
    usual = float(np.mean(list(lengths.values()))) if lengths else 1.0
    pose = np.zeros((len(skeleton.joints), 3))
    for joint, parent in skeleton.parents.items():
        if parent is not None:
            way = np.asarray(rest[joint], dtype=float)
            step = way / np.linalg.norm(way) * lengths.get(joint, usual)
            pose[skeleton.index(joint)] = pose[skeleton.index(parent)] + step
    return pose


def skeleton_layout(skeleton: Skeleton) -> Float[np.ndarray, "joints 2"]:
    """Return where to draw each joint, x right and y down, in units of about one bone.

    The rest pose where there is one, turned to where its joints stand clearest of each other; else
    a plane figure with bones as straight as they go (stress majorisation: Gansner, Koren and North,
    Graph Drawing by Stress Majorization, 2004), the body's left on the image's right as when it
    faces the camera.
    """
    pose = rest_pose(skeleton)
    if pose is not None:
        return _clearest_view(pose)
    return _upright(_plane_figure(skeleton), skeleton)


def _clearest_view(pose: Float[np.ndarray, "joints 3"]) -> Float[np.ndarray, "joints 2"]:
    """Return the pose seen level from the front or turned, where few joints hide each other."""

    def seen(azimuth_deg: float) -> np.ndarray:
        angle = np.radians(azimuth_deg)
        x = pose[:, 0] * np.cos(angle) + pose[:, 2] * np.sin(angle)
        depth = pose[:, 2] * np.cos(angle) - pose[:, 0] * np.sin(angle)
        return np.stack([x, pose[:, 1] - (0.25 * depth if azimuth_deg else 0)], axis=1)

    def room(view: np.ndarray) -> float:
        apart = np.linalg.norm(view[:, None] - view[None], axis=2) + np.eye(len(view)) * 1e9
        return float(np.minimum(apart.min(1), 0.1 * np.ptp(view, axis=0).max()).mean() / np.ptp(pose))

    rooms = [room(seen(azimuth)) for azimuth in _AZIMUTHS_DEG]
    best = _AZIMUTHS_DEG[int(np.argmax(rooms))] if rooms[0] < 0.7 * max(rooms) else 0.0
    return seen(best)


def _plane_figure(skeleton: Skeleton) -> Float[np.ndarray, "joints 2"]:
    """Lay the bones out flat by majorising stress, mirror partners level with each other."""
    wanted = _distances(skeleton)
    sides = np.array(joint_sides(skeleton, skeleton.joints))
    sign = np.where(sides == CENTRE, 0.0, np.where(sides == LEFT, 1.0, -1.0))
    across = skeleton.mirror_permutation
    if not skeleton.mirror:
        place = _fan(skeleton)
        if len(skeleton.bones) < len(skeleton.joints):
            return place
    else:
        space = _classical_scaling(wanted)
        apart = np.linalg.norm(space - space[across], axis=1) / 2
        even = _main_axis((space + space[across]) / 2)
        place = np.stack([sign * apart, even], axis=1)
    weight = 1 / (wanted + np.eye(len(wanted))) ** 2 * (1 - np.eye(len(wanted)))
    laplacian = np.linalg.pinv(np.diag(weight.sum(1)) - weight)
    for _ in range(_ROUNDS if len(wanted) <= 200 else 30):
        now = np.linalg.norm(place[:, None] - place[None], axis=2)
        pull = -weight * wanted / np.maximum(now, 1e-6)
        np.fill_diagonal(pull, 0)
        np.fill_diagonal(pull, -pull.sum(1))
        place = laplacian @ pull @ place
        if skeleton.mirror:
            place = (place + place[across] * np.array([-1.0, 1.0])) / 2
    return place


def _distances(skeleton: Skeleton) -> Float[np.ndarray, "joints joints"]:
    """Return the length of the way along bones between any two joints, in bones."""
    count = len(skeleton.joints)
    distance = np.full((count, count), np.inf)
    np.fill_diagonal(distance, 0)
    distance[tuple(skeleton.bone_indices.T)] = distance[tuple(skeleton.bone_indices.T[::-1])] = 1
    for via in range(count):
        distance = np.minimum(distance, distance[:, via, None] + distance[None, via])
    return distance


def _classical_scaling(distance: Float[np.ndarray, "joints joints"]) -> Float[np.ndarray, "joints axes"]:
    centre = np.eye(len(distance)) - 1 / len(distance)
    values, vectors = np.linalg.eigh(-0.5 * centre @ distance**2 @ centre)
    keep = np.argsort(values)[::-1][: min(8, len(values))]
    return vectors[:, keep] * np.sqrt(np.maximum(values[keep], 0))


def _main_axis(points: Float[np.ndarray, "joints axes"]) -> Float[np.ndarray, " joints"]:
    centred = points - points.mean(0)
    return centred @ np.linalg.svd(centred, full_matrices=False)[2][0]


def _fan(skeleton: Skeleton) -> Float[np.ndarray, "joints 2"]:
    """Spread the ends of the tree over a half circle, in the order of the file, limbs straight."""
    parents, order = skeleton.parents, list(skeleton.parents)
    inner = set(parents.values())
    ends = [joint for joint in skeleton.joints if joint not in inner]
    angles = dict(zip(ends, np.linspace(0, np.pi, 2 * len(ends) + 1)[1::2], strict=True))
    below: dict[str, list[float]] = {joint: [angles[joint]] if joint in angles else [] for joint in order}
    for joint in reversed(order):
        if (parent := parents[joint]) is not None:
            below[parent] += below[joint]
    place = np.zeros((len(order), 2))
    for joint in order:
        if (parent := parents[joint]) is not None:
            angle = float(np.mean(below[joint]))
            step = np.array([np.cos(angle), -np.sin(angle)])
            place[skeleton.index(joint)] = place[skeleton.index(parent)] + step
    return place


def _upright(place: Float[np.ndarray, "joints 2"], skeleton: Skeleton) -> Float[np.ndarray, "joints 2"]:
    """Turn the figure so that up, or the front of a body seen from above, points up the image."""
    vectors = {name: skeleton.facing_matrix(name) @ place for name in skeleton.facing}
    up = vectors.get("up", np.zeros(2))
    low = _low_joints(skeleton)
    if not np.linalg.norm(up) > 0.5 and "up" not in vectors and low.any() and not low.all():
        up = place[~low].mean(0) - place[low].mean(0)
    front = vectors.get("front", np.zeros(2))
    above = bool(skeleton.mirror) and np.linalg.norm(front) > 1.5 * np.linalg.norm(up)
    way = front if above else up
    if np.linalg.norm(way) < 1e-3:
        return place
    turn = -np.pi / 2 - np.arctan2(way[1], way[0])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = place @ rotation.T
    left = vectors["left"] @ rotation.T if "left" in vectors else np.array([1.0, 0.0])
    flip = (left[0] < 0) != above
    return turned * np.array([-1.0 if flip else 1.0, 1.0])


def _low_joints(skeleton: Skeleton) -> Bool[np.ndarray, " joints"]:
    return np.array([any(word in joint.casefold() for word in _LOW_WORDS) for joint in skeleton.joints])
