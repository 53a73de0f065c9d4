"""The ground under a body: its plane, when which feet stand on it, and poses and roots whose standing feet stay put.

One camera sees how far away a body is by its size in the image alone, the noisiest of what is lifted. A foot that
stands is a better mark: it does not move, and the line of sight to it meets the ground in one point.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from uplift.data.poses import USUAL_FPS
from uplift.data.samples import Samples

if TYPE_CHECKING:
    from uplift.data.poses import PoseData
    from uplift.skeleton import Skeleton

__all__ = ["Ground", "Grounded", "contact_joints", "put_on_ground"]


@dataclass
class Ground(Samples):
    """The plane under the body of each frame and the joints that stand on it; NaN and False where none was found."""

    point: Float[np.ndarray, "frames 3"]
    """On the plane, where the clip's body is in the middle; from the camera, in the unit and axes of the prediction."""
    normal: Float[np.ndarray, "frames 3"]
    """Unit vectors that point up."""
    contact: Bool[np.ndarray, "frames joints"]
    """The joint stands."""


class Grounded(NamedTuple):
    """Poses and places of the root with feet that stand still, and what was found."""

    pose: Float[np.ndarray, "frames joints 3"]
    """Relative to the root."""
    root: Float[np.ndarray, "frames 3"]
    ground: Ground | None
    """None where no clip has a ground."""
    notes: tuple[str, ...]


_GRAVITY = 9810.0  # mm/s²


def put_on_ground(
    pose: Float[np.ndarray, "frames joints 3"],
    root: Float[np.ndarray, "frames 3"],
    gravity: Float[np.ndarray, "frames 3"],
    data: PoseData,
    rays: Float[np.ndarray, "frames joints 2"],
    skeleton: Skeleton,
) -> Grounded:
    """Return the poses of each clip with standing feet that stay where they are, bones as long as before.

    Of each clip in turn: joints that are still and near one level stand (a hidden Markov model of two states); the
    plane through them is fitted; root and limbs are moved by least squares, so that standing joints do not move,
    limbs stay near their lines of sight and lifted depths, and the root accelerates little. What is not on a limb
    that stands goes along with the root. A clip without a ground is returned as it was, with a note that says why.

    Args:
        pose: relative to the root, camera frame (x right, y down, z away), mm.
        root: from the camera, mm.
        gravity: unit vectors in the camera frame.
        data: the same frames, for their clips, confidence and frame rate; the camera of a clip stands still.
        rays: keypoints as x/z and y/z.
        skeleton: its ``contacts`` are the joints that may stand.
    """
    points = pose + root[:, None].astype(np.float64)
    known = np.asarray(np.isfinite(points).all((1, 2)))
    contacts = contact_joints(skeleton, points[known], gravity[known])
    why_not = _no_ground(data, skeleton, contacts)
    if why_not:
        return Grounded(pose, root, None, (f"ground: poses are as they were lifted: {why_not}",))
    sights = _unit(np.pad(rays.astype(np.float64), ((0, 0), (0, 0), (0, 1)), constant_values=1.0))
    limbs = _limbs(skeleton, contacts)
    ground = Ground(np.full_like(root, np.nan), np.full_like(root, np.nan), np.zeros(pose.shape[:2], bool))
    found: list[_Standing | str] = []
    for motion, rows in _motions(points, sights, gravity, data, contacts):
        one = _stand(motion, limbs)
        found.append(one)
        if isinstance(one, _Standing):
            points[rows], ground.contact[rows] = one.points, one.contact
            ground.point[rows], ground.normal[rows] = one.point, -one.normal
    if not any(isinstance(one, _Standing) for one in found):
        ground = None
    moved = np.where(known[:, None], points[:, skeleton.root_index], root)
    pose = np.where(known[:, None, None], points - moved[:, None], pose).astype(pose.dtype)
    return Grounded(pose, moved.astype(root.dtype), ground, _notes(found, data))


def _no_ground(data: PoseData, skeleton: Skeleton, contacts: np.ndarray) -> str:
    """Return why nothing can be put on a ground; empty where something may be."""
    clips = data.clips()
    if not (np.bincount(clips, minlength=1) >= _LEAST_FRAMES).any():
        return f"no clip has {_LEAST_FRAMES} frames (a file needs 'sequence' and 'frame' for clips)"
    return "" if len(contacts) else f"no limb of the skeleton '{skeleton.name}' is lowest (contacts: in its YAML)"


# The joints that may stand, and the limbs that lead to them.

_LEAST_SHARE = 0.15
"""Share of the frames in which one of a pair of limbs must be the lowest."""


def contact_joints(
    skeleton: Skeleton, points: Float[np.ndarray, "frames joints 3"], gravity: Float[np.ndarray, "frames 3"]
) -> Int[np.ndarray, " contacts"]:
    """Return the joints that may stand: the skeleton's ``contacts``, else the ends of limbs that are often the lowest."""
    if skeleton.contacts:
        return np.array([skeleton.index(joint) for joint in skeleton.contacts])
    ends = np.bincount(skeleton.bone_indices.ravel(), minlength=len(skeleton.joints)) == 1
    ends[skeleton.root_index] = False
    places = np.flatnonzero(ends)
    if not len(places) or not len(points):
        return places[:0]
    below = np.einsum("fjc,fc->fj", points[:, places], gravity)
    lowest = np.zeros(len(skeleton.joints))
    lowest[places] = np.bincount(below.argmax(1), minlength=len(places)) / len(below)
    return places[(lowest + lowest[skeleton.mirror_permutation])[places] >= _LEAST_SHARE]


class _Limbs(NamedTuple):
    """The joints that move: those that may stand, all on the way to them from the root, and the root, the last."""

    joints: Int[np.ndarray, " moved"]
    """Indices into the skeleton's."""
    contacts: Int[np.ndarray, " contacts"]
    """Places in ``joints``."""
    bones: Int[np.ndarray, "bones 2"]
    """Places in ``joints``: parent, child."""
    above: Bool[np.ndarray, "bones contacts"]
    """Whether a bone is on the way from the root to a joint that may stand."""
    carried: Int[np.ndarray, " joints"]
    """The place in ``joints`` of what each joint of the skeleton goes along with."""


def _limbs(skeleton: Skeleton, contacts: Int[np.ndarray, " contacts"]) -> _Limbs:
    parents = skeleton.parents
    ways = [_way(skeleton, skeleton.joints[place]) for place in contacts]
    names = [
        joint for joint in parents if joint != skeleton.root and any(joint in way for way in ways)
    ]  # breadth first
    place = {joint: at for at, joint in enumerate([*names, skeleton.root])}
    bones = [(place[str(parents[joint])], at) for at, joint in enumerate(names)]
    above = [[joint in way for way in ways] for joint in names]
    moved = [*names, skeleton.root]
    for joint, parent in parents.items():
        if parent is not None:
            place.setdefault(joint, place[parent])
    return _Limbs(
        np.array([skeleton.index(joint) for joint in moved]),
        np.array([moved.index(skeleton.joints[joint]) for joint in contacts]),
        np.array(bones),
        np.array(above),
        np.array([place[joint] for joint in skeleton.joints]),
    )


def _way(skeleton: Skeleton, joint: str) -> set[str]:
    """Return the joints on the way from the root to ``joint``, without the root."""
    way = set()
    while (parent := skeleton.parents[joint]) is not None:
        way.add(joint)
        joint = parent
    return way


class _Motion(NamedTuple):
    """One clip of one body before a camera that stands still, in the axes of the camera; frames in time."""

    points: Float[np.ndarray, "frames joints 3"]
    """From the camera, mm; NaN in frames that were not lifted."""
    sights: Float[np.ndarray, "frames joints 3"]
    """Unit vectors along the lines of sight."""
    confidence: Float[np.ndarray, "frames joints"]
    follows: Bool[np.ndarray, " frames"]
    """Whether a frame is the next after the one before it."""
    gravity: Float[np.ndarray, " 3"]
    seconds: float
    """From frame to frame."""
    noise: float
    """Standard deviation of a line of sight, each way, radians."""

    @property
    def known(self) -> Bool[np.ndarray, " frames"]:
        """Frames that were lifted."""
        return np.asarray(np.isfinite(self.points).all((1, 2)))


def _motions(
    points: np.ndarray, sights: np.ndarray, gravity: np.ndarray, data: PoseData, contacts: np.ndarray
) -> Iterator[tuple[_Motion, Int[np.ndarray, " rows"]]]:
    """Yield every clip with its rows."""
    clips, follows, confidence = data.clips(), data.follows(), data.confidence
    noise = _noise(sights[:, contacts], confidence[:, contacts] > 0, follows)
    order = np.argsort(clips, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(clips[order])) + 1):
        down = _unit(np.median(gravity[rows], axis=0).astype(np.float64))
        seconds = 1 / (data.fps or USUAL_FPS)
        clip_follows = follows[rows] & (np.arange(len(rows)) > 0)
        yield _Motion(points[rows], sights[rows], confidence[rows], clip_follows, down, seconds, noise), rows


_QUIET = 0.1
"""Share of frames in which joints that may stand are taken to stand: their shaking there is noise."""


def _noise(sights: np.ndarray, seen: np.ndarray, follows: np.ndarray) -> float:
    """Return the noise of lines of sight, from second differences of the quietest frames; they are Rayleigh distributed."""
    three = (seen[2:] & seen[1:-1] & seen[:-2]) & (follows[2:] & follows[1:-1])[:, None]
    second = np.linalg.norm(sights[2:] - 2 * sights[1:-1] + sights[:-2], axis=-1)[three]
    return float(np.quantile(second, _QUIET) / np.sqrt(-12 * np.log(1 - _QUIET))) if len(second) else 0.0


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


# One clip: contacts and plane in turn, then the places.

_LEAST_FRAMES = 5
_LEAST_CONTACT = 0.1
"""Share of frames with a standing joint below which there is no ground to be found."""
_ROUNDS = 3
_UNLIKELY = -1.0
"""Standing before a level is known, in nats."""


class _Standing(NamedTuple):
    """A clip whose feet stand."""

    points: Float[np.ndarray, "frames joints 3"]
    contact: Bool[np.ndarray, "frames joints"]
    point: Float[np.ndarray, " 3"]
    """On the plane, below the middle of the clip."""
    normal: Float[np.ndarray, " 3"]
    """Downwards."""
    height: float
    """Of the camera above the plane."""
    slope_deg: float
    """From gravity."""
    sliding: tuple[float, float]
    """Sum over all steps of the way that standing joints go, before and after."""
    steps: int


def _stand(motion: _Motion, limbs: _Limbs) -> _Standing | str:
    """Return the clip with feet that stand still on one plane, or why there is none."""
    if motion.known.sum() < _LEAST_FRAMES:
        return f"fewer than {_LEAST_FRAMES} frames"
    feet = limbs.joints[limbs.contacts]
    reach = _reach(motion, limbs)
    still, plane = _still(motion, feet, reach), None
    steps = _likeliest(still + _UNLIKELY)
    for _ in range(_ROUNDS):
        contact = _of_frames(steps)
        if contact.any(1).sum() < max(_LEAST_CONTACT * motion.known.sum(), 2):
            return "no foot stands still for long"
        frame, foot = np.nonzero(contact & (motion.confidence[:, feet] > 0))
        plane = _plane(motion.sights[frame, feet[foot]], motion.points[frame, feet[foot]], motion.gravity, reach)
        steps = _likeliest(still + _level(motion.points[:, feet] @ plane[0] - plane[1], reach))
    if not steps.any() or plane is None:
        return "no foot stands still for long"
    moved, steps = _solve_what_fits(motion, limbs, steps, plane, reach)
    contact = np.zeros(motion.points.shape[:2], bool)
    contact[:, feet] = _of_frames(steps)
    ways = [np.linalg.norm(np.diff(points[:, feet], axis=0), axis=-1)[steps].sum() for points in (motion.points, moved)]
    middle = np.median(moved[motion.known][:, limbs.joints[-1]], axis=0)
    point = middle + plane[0] * (plane[1] - middle @ plane[0])
    slope = np.degrees(np.arccos(np.clip(plane[0] @ motion.gravity, -1, 1)))
    return _Standing(moved, contact, point, *plane, float(slope), (ways[0], ways[1]), int(steps.sum()))


def _reach(motion: _Motion, limbs: _Limbs) -> float:
    """Return the usual length of the way from the root to a joint that may stand."""
    ends = motion.points[motion.known][:, limbs.joints[limbs.bones]]
    length = np.median(np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1), axis=0)
    way = np.zeros(len(limbs.joints))
    for (parent, child), one in zip(limbs.bones, length, strict=True):
        way[child] = way[parent] + one
    return float(np.median(way[limbs.contacts]))


# When a joint stands: it is still, as the image shows best, and near the level where joints are still.

_WINDOW = 0.35
"""Over which motion is measured, as a share of sqrt(length of the leg / gravity): 0.1 s in humans (Alexander and Jayes 1983)."""
_STILL, _MOVING = 0.003, 0.2
"""Standard deviations of the way across the line of sight in a window, in lengths of the leg, beside the noise."""
_MOST_NOISE = 0.03
_STILL_DEPTH = 0.08
"""The same along the line of sight, where lifted places are noisy."""
_NEAR_LEVEL, _LEVELS = 0.05, 0.5
"""Standard deviation of the height of a joint that stands, and the range of heights of those that do not."""
_SWITCH = 2.0
"""What it costs to begin or end standing, in nats."""
_OUTLIER = -4.0
"""The most that one step speaks against standing, in nats: detections jump."""


def _still(motion: _Motion, feet: np.ndarray, reach: float) -> Float[np.ndarray, "steps contacts"]:
    """Return how much better it fits each step from frame to frame that a joint stands than that it moves, in nats."""
    steps = np.arange(len(motion.points) - 1)
    window = max(1, round(_WINDOW * np.sqrt(reach / _GRAVITY) / motion.seconds))
    run = np.cumsum(~motion.follows)
    first = np.maximum(steps - (window - 1) // 2, np.searchsorted(run, run[:-1]))
    last = np.minimum(steps + 1 + window // 2, np.searchsorted(run, run[:-1], side="right") - 1)
    sights, far = motion.sights[:, feet], np.linalg.norm(motion.points[:, feet], axis=-1)
    across = np.linalg.norm(sights[last] - sights[first], axis=-1) * (far[last] + far[first]) / 2
    noise = np.minimum(np.sqrt(2) * motion.noise * far[:-1], _MOST_NOISE * reach)
    still, moving, depth = np.hypot(_STILL * reach, noise), _MOVING * reach, _STILL_DEPTH * reach
    better = 2 * np.log(moving / still) - across**2 / 2 * (still**-2 - moving**-2)
    spread = np.hypot(moving, depth)
    better += np.log(spread / depth) - (far[last] - far[first]) ** 2 / 2 * (depth**-2 - spread**-2)
    seen = motion.confidence[:, feet] > 0
    better = np.where(seen[first] & seen[last], better, _UNLIKELY)
    in_time = (motion.follows[1:] & motion.known[1:] & motion.known[:-1])[:, None] & np.isfinite(better)
    return np.where(in_time, np.maximum(better, _OUTLIER), -np.inf)


def _level(off: Float[np.ndarray, "frames contacts"], reach: float) -> Float[np.ndarray, "steps contacts"]:
    """Return how much better the height of each step, ``off`` the plane, fits standing, in nats."""
    share = (off[1:] + off[:-1]) / 2 / reach
    better = np.log(_LEVELS / (_NEAR_LEVEL * np.sqrt(2 * np.pi))) - share**2 / (2 * _NEAR_LEVEL**2)
    return np.nan_to_num(np.maximum(better, 2 * _OUTLIER))


def _likeliest(better: Float[np.ndarray, "steps contacts"]) -> Bool[np.ndarray, "steps contacts"]:
    """Return in which steps each joint stands: the likeliest states (Viterbi 1967)."""
    better = np.maximum(better, -1e6)
    score, each = np.zeros((2, better.shape[1])), np.arange(better.shape[1])
    came = np.zeros((len(better), 2, better.shape[1]), bool)  # from the other state
    for step, gain in enumerate(better):
        switched = score[::-1] - _SWITCH
        came[step] = switched > score
        score = np.maximum(score, switched)
        score[1] += gain
    stands, state = np.zeros(better.shape, bool), score.argmax(0)
    for step in range(len(better) - 1, -1, -1):
        stands[step] = state == 1
        state = np.where(came[step, state, each], 1 - state, state)
    return stands


def _of_frames(steps: Bool[np.ndarray, "steps contacts"]) -> Bool[np.ndarray, "frames contacts"]:
    """Return in which frames a joint stands: in the step before or after them."""
    return np.pad(steps, ((0, 1), (0, 0))) | np.pad(steps, ((1, 0), (0, 0)))


# The plane: where the lines of sight to standing joints end.

_PLANE_ROUNDS = 8
_SLOPE = np.tan(np.radians(3.0))
"""How far the plane's normal is off lifted gravity."""
_AS_ONE = 0.03
"""What a frame is worth, of independent ones."""
_LOWER = 0.7
"""Of joints that are still, more than half are on the ground; the quantile of their heights to begin with."""

_Plane = tuple[Float[np.ndarray, " 3"], float]
"""The normal, downwards, and the distance of the camera along it."""


def _plane(
    sights: Float[np.ndarray, "points 3"], points: Float[np.ndarray, "points 3"], gravity: np.ndarray, reach: float
) -> _Plane:
    """Return the plane that lines of sight meet as far away as ``points`` are.

    At a distance h along its normal n, 1 / (way along a unit vector u to it) = n . u / h: linear, with exact u, so
    that noisy depths do not slope the plane towards the camera. Re-weighted against what does not stand on it.
    """
    far, across = np.linalg.norm(points, axis=-1), np.linalg.svd(gravity[None])[2][1:]
    normal, height = gravity, float(np.quantile(points @ gravity, _LOWER))
    for _ in range(_PLANE_ROUNDS):
        if abs(height) < _NEAR_LEVEL * reach:  # a camera on the ground sees no plane, but its edge
            break
        off = points @ normal - height
        trust = 1 / (1 + (off / (_NEAR_LEVEL * reach)) ** 2)
        slant = np.maximum(np.abs(sights @ normal), 0.02)
        spread = np.hypot(_STILL_DEPTH * reach, _NEAR_LEVEL * reach / slant) / far**2
        weight = np.sqrt(_AS_ONE * trust) / spread
        matrix = np.concatenate([sights * weight[:, None], across * height / _SLOPE])
        found = np.linalg.lstsq(matrix, np.append(weight / far, [0.0, 0.0]), rcond=None)[0]
        size = np.linalg.norm(found) * np.sign(height)
        if found @ gravity / size < 0.5:
            return gravity, height
        normal, height = found / size, 1 / size
    return normal, float(height)


# The places of root and limbs: least squares (Gauss-Newton), with standing joints that do not move.

_GAUSS_NEWTON = 15
_ROOT_DEPTH = 0.01
"""Standard deviation of a lifted root's distance, as a share of it."""
_LIMB_DEPTH = 0.08
"""Of a joint's depth from the root, in lengths of the leg."""
_ON_RAY = 0.01
"""Of a joint's way from its line of sight, in lengths of the leg, beside the noise."""
_ON_PLANE = 0.03
"""Of a standing joint's height: heels rise."""
_FIXED = 5e-4
"""Of the way of a standing joint, and of a bone's length."""
_ACCELERATION = 0.5
"""Of the root, in units of gravity."""
_FREE = 1e9
_DAMPING = 0.02
"""Of the way of a joint from its parent in one iteration, in lengths of the leg."""
_STRETCHED = 0.003
"""Error of a bone's length, in lengths of the leg, at which the foot below it is taken not to stand after all."""
_RELEASES = 5


class _Equations:
    """A sparse linear least-squares problem in the places of points, put together block by block."""

    def __init__(self, points: int):
        self.points, self.count = points, 0
        self.rows, self.columns, self.values, self.right = [], [], [], []

    def add(self, parts: Sequence[tuple[np.ndarray, np.ndarray]], right: Float[np.ndarray, " n"]) -> None:
        """Add n equations: the sum over ``parts``, (points (n), coefficients (n 3)), of their products is ``right``."""
        rows = self.count + np.arange(len(right))
        for point, coefficient in parts:
            self.rows.append(np.repeat(rows, 3))
            self.columns.append((3 * point[:, None] + np.arange(3)).ravel())
            self.values.append(np.broadcast_to(coefficient, (len(right), 3)).ravel())
        self.right.append(right)
        self.count += len(right)

    def add_vectors(
        self, parts: Sequence[tuple[np.ndarray, float]], right: Float[np.ndarray, "n 3"], weight: np.ndarray
    ) -> None:
        """Add n vector equations, each times its ``weight`` (n 3 3): the sum of factors times points is ``right``."""
        for axis in range(3):
            row = np.broadcast_to(weight, (len(right), 3, 3))[:, axis]
            self.add([(point, factor * row) for point, factor in parts], (row * right).sum(-1))

    def normal(self) -> tuple[Any, np.ndarray]:
        """Return the matrix and the right side of the normal equations."""
        from scipy.sparse import csr_array  # slow to import

        places = (np.concatenate(self.rows), np.concatenate(self.columns))
        matrix = csr_array((np.concatenate(self.values), places), shape=(self.count, 3 * self.points))
        return matrix.T @ matrix, matrix.T @ np.concatenate(self.right)


def _solve_what_fits(
    motion: _Motion, limbs: _Limbs, steps: Bool[np.ndarray, "steps contacts"], plane: _Plane, reach: float
) -> tuple[Float[np.ndarray, "frames joints 3"], Bool[np.ndarray, "steps contacts"]]:
    """Return the places of all joints, and the steps in which feet stand without pulling limbs out of their length."""
    length = _lengths(motion.points[:, limbs.joints], limbs)
    for _ in range(_RELEASES):
        moved = _solve(motion, limbs, steps, plane, reach)
        off = np.abs(_lengths(moved[:, limbs.joints], limbs) - length) > _STRETCHED * reach
        pulled = (off.astype(int) @ limbs.above) > 0  # (frames contacts)
        held = steps & ~(pulled[1:] | pulled[:-1])
        if (held == steps).all():
            break
        steps = held
    return moved, steps


def _solve(
    motion: _Motion, limbs: _Limbs, steps: Bool[np.ndarray, "steps contacts"], plane: _Plane, reach: float
) -> Float[np.ndarray, "frames joints 3"]:
    """Return the places of all joints."""
    from scipy.sparse.linalg import spsolve  # slow to import

    known = motion.known
    first = np.where(known[:, None, None], motion.points[:, limbs.joints], 0.0)
    at = np.arange(first[..., 0].size).reshape(first.shape[:2])
    steady = _Equations(at.size)
    _near_lifted(steady, at, first, motion, limbs, reach)
    _smooth(steady, at, motion)
    steps = steps & (known[1:] & known[:-1])[:, None]
    _standing(steady, at[:, limbs.contacts], steps, plane, reach)
    matrix, right = steady.normal()
    place, length = first.reshape(-1, 3), _lengths(first, limbs)
    above = at[:, limbs.contacts][known[:, None] & ~_of_frames(steps)]
    for _ in range(_GAUSS_NEWTON):
        bent = _Equations(at.size)
        _roots(bent, at[:, -1], place, first[:, -1], reach)
        _bones(bent, at, place, length, limbs, reach)
        _on_sights(bent, at, place, motion, limbs, reach)
        sunk = above[place[above] @ plane[0] > plane[1]]
        bent.add([(sunk, plane[0] / (_ON_PLANE * reach))], np.full(len(sunk), plane[1] / (_ON_PLANE * reach)))
        more, more_right = bent.normal()
        place = np.asarray(spsolve((matrix + more).tocsc(), right + more_right)).reshape(-1, 3)
    shift = np.where(known[:, None, None], place.reshape(first.shape) - first, 0.0)
    return motion.points + shift[:, limbs.carried]


def _sight_weights(
    sights: Float[np.ndarray, "n 3"], across: np.ndarray | float, along: np.ndarray | float
) -> Float[np.ndarray, "n 3 3"]:
    """Return what divides vectors by ``along`` on lines of sight and by ``across`` at right angles to them."""
    outer = sights[:, :, None] * sights[:, None, :]
    across, along = (np.broadcast_to(np.asarray(one, float), len(sights))[:, None, None] for one in (across, along))
    return outer / along + (np.eye(3) - outer) / across


def _roots(equations: _Equations, at: np.ndarray, place: np.ndarray, lifted: np.ndarray, reach: float) -> None:
    """Keep roots near where they were lifted, those that are far from it less so (Cauchy)."""
    far = np.maximum(np.linalg.norm(lifted, axis=-1), reach)
    along = _ROOT_DEPTH * far
    along = along * np.sqrt(1 + (np.linalg.norm(place[at] - lifted, axis=-1) / (3 * along)) ** 2)
    equations.add_vectors([(at, 1.0)], lifted, _sight_weights(lifted / far[:, None], _ON_RAY * reach, along))


def _near_lifted(
    equations: _Equations, at: np.ndarray, first: np.ndarray, motion: _Motion, limbs: _Limbs, reach: float
) -> None:
    """Keep limbs at their lifted depth from the root, where a joint was not seen at its lifted place."""
    for place, joint in enumerate(limbs.joints[:-1]):
        across = np.where(motion.confidence[:, joint] > 0, _FREE, _LIMB_DEPTH) * reach
        weight = _sight_weights(motion.sights[:, joint], across, _LIMB_DEPTH * reach)
        equations.add_vectors([(at[:, place], 1.0), (at[:, -1], -1.0)], first[:, place] - first[:, -1], weight)


def _smooth(equations: _Equations, at: np.ndarray, motion: _Motion) -> None:
    """Let the root accelerate little."""
    follows = motion.follows & motion.known & np.roll(motion.known, 1)
    middle = np.flatnonzero(follows[1:-1] & follows[2:]) + 1
    root, weight = at[:, -1], np.eye(3) / (_ACCELERATION * _GRAVITY * motion.seconds**2)
    parts = [(root[middle - 1], 1.0), (root[middle], -2.0), (root[middle + 1], 1.0)]
    equations.add_vectors(parts, np.zeros((len(middle), 3)), weight)


def _standing(equations: _Equations, at: np.ndarray, steps: np.ndarray, plane: _Plane, reach: float) -> None:
    """Keep standing joints where they are, and near the plane."""
    frame, foot = np.nonzero(steps)
    parts = [(at[frame + 1, foot], 1.0), (at[frame, foot], -1.0)]
    equations.add_vectors(parts, np.zeros((len(frame), 3)), np.eye(3) / (_FIXED * reach))
    stands = at[_of_frames(steps)]
    equations.add([(stands, plane[0] / (_ON_PLANE * reach))], np.full(len(stands), plane[1] / (_ON_PLANE * reach)))


def _lengths(places: Float[np.ndarray, "frames moved 3"], limbs: _Limbs) -> Float[np.ndarray, "frames bones"]:
    return np.linalg.norm(places[:, limbs.bones[:, 1]] - places[:, limbs.bones[:, 0]], axis=-1)


def _bones(
    equations: _Equations, at: np.ndarray, place: np.ndarray, length: np.ndarray, limbs: _Limbs, reach: float
) -> None:
    """Keep bones as long as they are, to first order about ``place``, from which limbs go little in one iteration."""
    one, other = at[:, limbs.bones[:, 0]].ravel(), at[:, limbs.bones[:, 1]].ravel()
    along = _unit(place[other] - place[one]) / (_FIXED * reach)
    equations.add([(one, -along), (other, along)], length.ravel() / (_FIXED * reach))
    equations.add_vectors([(other, 1.0), (one, -1.0)], place[other] - place[one], np.eye(3) / (_DAMPING * reach))


def _on_sights(
    equations: _Equations, at: np.ndarray, place: np.ndarray, motion: _Motion, limbs: _Limbs, reach: float
) -> None:
    """Keep joints near their lines of sight, those that are far from them less so (Cauchy)."""
    for moved, joint in enumerate(limbs.joints[:-1]):
        rows = np.flatnonzero((motion.confidence[:, joint] > 0) & motion.known)
        sights, point = motion.sights[rows, joint], place[at[rows, moved]]
        away = point - sights * (point * sights).sum(-1, keepdims=True)
        spread = np.hypot(_ON_RAY * reach, motion.noise * np.linalg.norm(point, axis=-1))
        spread = spread * np.sqrt(1 + (np.linalg.norm(away, axis=-1) / (3 * spread)) ** 2)
        weight = _sight_weights(sights, spread, _FREE * reach)
        equations.add_vectors([(at[rows, moved], 1.0)], np.zeros((len(rows), 3)), weight)


# What was found, in words.


def _notes(found: Sequence[_Standing | str], data: PoseData) -> tuple[str, ...]:
    """Return what was found of the ground, and why clips have none."""
    stood = [one for one in found if isinstance(one, _Standing)]
    notes = []
    if stood:
        height, slope = (float(np.median([getattr(one, name) for one in stood])) for name in ("height", "slope_deg"))
        frames = sum(len(one.contact) for one in stood)
        share = sum(int(one.contact.any(1).sum()) for one in stood) / frames
        steps = max(sum(one.steps for one in stood), 1)
        before, after = (sum(one.sliding[which] for one in stood) / steps for which in (0, 1))
        many = f"{len(stood):,} clips, medians: " if len(found) > 1 else ""
        side = "below" if height > 0 else "above"
        notes.append(
            f"ground: {many}{abs(height):,.0f} mm {side} the camera, slope {slope:.1f} degrees, feet in contact in "
            f"{share:.0%} of the frames; sliding {before:.0f} -> {after:.0f} mm a frame"
        )
        if data.fps is None:
            notes.append(f"ground: the frame rate is not known, {USUAL_FPS:g} a second are taken (fps=)")
    reasons = Counter(one for one in found if isinstance(one, str))
    for reason, count in reasons.items():
        which = f"{count:,} of {len(found):,} clips are" if len(found) > 1 else "the clip is"
        notes.append(f"ground: {which} as lifted: {reason}")
    return tuple(notes)
