"""One individual's clip as a Biovision hierarchy (``.bvh``): a rig and its turns, for animation programs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from uplift.config.files import as_bytes, replacing
from uplift.data.parsers.mocap import Figure, Tree
from uplift.errors import UserError
from uplift.export.clips import frame_rate, one_body, seen_at, steps
from uplift.export.scene import from_y_down, held, known_points
from uplift.export.tables import unique
from uplift.geometry.rigid import nearest_rotation
from uplift.models.prediction import Prediction
from uplift.skeleton import Skeleton
from uplift.skeleton.draw import rest_pose

__all__ = ["euler_zxy", "turn_onto", "write_bvh"]

_MOST_REPEATS = 20  # frames in the file for each one there is


@dataclass(frozen=True)
class _BvhFit:
    """How far the file's joints are from the predicted ones, in ``unit``: BVH has bones of one length only."""

    largest_error: float
    mean_error: float
    unit: str
    frames: int
    added: tuple[str, ...]
    """Joints without length, added where children of one joint move on their own."""

    def __str__(self) -> str:
        """Return a sentence for a log."""
        unit = "" if self.unit == "relative" else f" {self.unit}"
        return (
            f"bones of one length each: joints are {self.mean_error:.3g}{unit} from the predicted ones on average, "
            f"{self.largest_error:.3g}{unit} at most"
        )


def write_bvh(
    prediction: Prediction, path: str | Path, fps: int | float | None = None, individual: str | None = None
) -> _BvhFit:
    """Write one individual of a clip, ``individual`` of several, and return how well it fits; ``fps`` replaces the prediction's.

    Lengths are centimetres where the prediction is in mm, else as they are; axes as given. Every bone has its
    median length, every direction is kept; the twist about a bone is not observed and left as small as it can be
    (see `_Rig`). A joint or frame that is missing holds what was last known: BVH has no gaps. A joint at the end of
    a limb gets an end site a tenth of its bone further on. Raises UserError for several clips or individuals, where
    no rate is known, and for frame numbers with wide gaps.
    """
    clip = one_body(prediction, path, individual)
    rate = frame_rate(prediction, fps)
    if rate is None:
        raise UserError(f"cannot write {path}: a .bvh needs frames a second, which the input does not say. Add fps=30.")
    when = steps(clip)[clip.moment]
    when -= when[0]
    count = round(float(when[-1])) + 1
    if count > _MOST_REPEATS * len(when):
        raise UserError(
            f"cannot write {path}: a .bvh has no gaps, and the frames {clip.frames[clip.moment[0]]} to "
            f"{clip.frames[clip.moment[-1]]} hold only "
            f"{len(when):,} poses. Write each stretch of frames on its own, or a .glb."
        )
    rows = clip.rows[seen_at(when, np.arange(count, dtype=float))]
    pose = known_points(prediction.pose[rows])
    root = np.zeros((count, 1, 3)) if prediction.root is None else known_points(prediction.root[rows][:, None])
    place = held(root[:, 0])
    rig = _Rig(prediction, pose)
    with replacing(path) as handle:
        handle.write(as_bytes(_text(rig, place, 0.1 if prediction.unit == "mm" else 1.0, rate)))
    gap = np.linalg.norm(rig.positions(place) - (pose + place[:, None])[:, rig.sources].transpose(1, 0, 2), axis=-1)
    gap = gap[np.isfinite(gap)]
    added = tuple(name for name in rig.tree.names if name not in prediction.joint_names)
    return _BvhFit(float(gap.max()), float(gap.mean()), prediction.unit, count, added)


def euler_zxy(rotation: Float[np.ndarray, "frames 3 3"]) -> Float[np.ndarray, "frames 3"]:
    """Return degrees about z, x, y (each about the axes turned before it) that change little from frame to frame."""
    x = np.arcsin(np.clip(rotation[:, 2, 1], -1, 1))
    z = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1])
    y = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    angles = np.stack([z, x, y], 1)
    locked = np.hypot(rotation[:, 0, 1], rotation[:, 1, 1]) < 1e-6
    sum_or_gap = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    for now in range(len(angles)):
        if locked[now]:  # z and y turn about one axis: z stays
            angles[now, 0] = angles[now - 1, 0] if now else 0.0
            angles[now, 2] = np.sign(angles[now, 1]) * (sum_or_gap[now] - angles[now, 0])
        if now:  # of the two triples for this rotation, and full turns more or less, the nearest to the frame before
            z, x, y = angles[now]
            triples = np.array([[z, x, y], [z + np.pi, np.pi - x, y + np.pi]])
            triples += 2 * np.pi * np.round((angles[now - 1] - triples) / (2 * np.pi))
            angles[now] = triples[np.abs(triples - angles[now - 1]).sum(1).argmin()]
    return np.degrees(angles)


def _text(rig: _Rig, place: np.ndarray, scale: float, rate: float) -> str:
    # White space and braces divide the words of the file.
    names = unique(re.sub(r"[\s{}]+", "_", name) or "_" for name in rig.tree.names)
    lines, depths = ["HIERARCHY"], [-1]
    for joint, parent in enumerate(rig.tree.parents):
        depth = depths[parent + 1] + 1
        lines += [f"{'  ' * level}}}" for level in range(depths[-1], depth - 1, -1)]
        lines += _joint_lines(rig, joint, names[joint], "  " * depth, scale)
        depths.append(depth)
    lines += [f"{'  ' * level}}}" for level in range(depths[-1], -1, -1)]
    lines += ["MOTION", f"Frames: {len(place)}", f"Frame Time: {1 / rate:.8f}"]
    values = np.concatenate([place * scale, *map(euler_zxy, rig.turned)], 1)
    lines += [" ".join(f"{value:.5f}" for value in row) for row in values + 0.0]
    return "\n".join([*lines, ""])


def _joint_lines(rig: _Rig, joint: int, name: str, pad: str, scale: float) -> list[str]:
    kind, place = ("JOINT", "3 ") if joint else ("ROOT", "6 Xposition Yposition Zposition ")
    lines = [f"{pad}{kind} {name}", f"{pad}{{", f"{pad}  {_offset(rig.tree.offsets[joint], scale)}"]
    lines.append(f"{pad}  CHANNELS {place}Zrotation Xrotation Yrotation")
    if np.isfinite(tip := rig.tree.tips[joint]).all():
        lines += [f"{pad}  End Site", f"{pad}  {{", f"{pad}    {_offset(tip, scale)}", f"{pad}  }}"]
    return lines


def _offset(offset: np.ndarray, scale: float) -> str:
    return "OFFSET " + " ".join(f"{value:.6f}" for value in offset * scale + 0.0)


# The rig: bones of one length each, and the rotations that bring them nearest to the poses.

_OWN_JOINT = 2e-4  # share of a bone by which a child may miss before it gets a turn of its own
_WEAK = 1e-5  # weight of the parent's frame, which decides what the bones leave open
_FOLDED = 0.5
"""1 + cosine of the angle to the rest direction (120 degrees) below which the previous frame counts."""
_TIP = 0.1
_SETTLE = 8


class _Rig:
    """The rig of a pose (relative to the root, NaN where not known): a tree in the prediction's unit, and its motion.

    Bones have their median length. A joint with one child turns the least way from its parent's frame, as the
    twist about a bone cannot be seen; where the bone folds back on its rest direction, and the least way is
    undefined, the twist follows from the frame before. A joint with several children turns rigidly onto them (Kabsch,
    Acta Cryst. A32, 1976), and a child that this misses gets a separate turn at the same place, which is exact. What
    is not known holds its last turn. Joints are listed parents first and depth first, as in the file. Raises UserError
    where a joint is nowhere known.
    """

    def __init__(self, prediction: Prediction, pose: Float[np.ndarray, "frames joints 3"]):
        self._directions, self._lengths = _bones(prediction, pose)
        self._rest = _rest_directions(prediction, self._directions, self._lengths)
        self._settles = rest_pose(prediction.skeleton) is None
        self._where = {name: place for place, name in enumerate(prediction.joint_names)}
        parents = prediction.skeleton.parents
        self._children: dict[str, list[str]] = {joint: [] for joint in parents}
        for joint in (name for name in prediction.joint_names if parents.get(name) is not None):
            self._children[str(parents[joint])].append(joint)
        self._joints: list[tuple[str, int, np.ndarray, np.ndarray]] = []
        self.sources: list[int] = []
        """The joint of the prediction that each joint of the rig sits on."""
        self.turned: list[Float[np.ndarray, "frames 3 3"]] = []
        """Of each joint in its parent's frame."""
        self._add(prediction.skeleton.root, -1, np.zeros(3), np.tile(np.eye(3), (len(pose), 1, 1)))
        names, above, offsets, tips = zip(*self._joints, strict=True)
        self.tree = Tree(names, above, np.array(offsets), np.array(tips))

    def positions(self, root: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "joints frames 3"]:
        return Figure.posed(self.tree, root, self.turned).positions

    def _add(self, joint: str, parent: int, offset: np.ndarray, frame: np.ndarray) -> None:
        children, source = self._children[joint], self._where[joint]
        turned = self._turned(children, frame) if children else frame
        tip = np.full(3, np.nan) if children else offset * _TIP
        place = self._append((joint, parent, offset, tip), source, frame, turned)
        for child in children:
            rest, directions, below, basis = self._rest[child], self._directions[child], place, turned
            if np.nanmax(np.linalg.norm(turned @ rest - directions, axis=-1)) > _OWN_JOINT:
                basis = turn_onto(rest[None], directions[:, None], turned)
                bare = f"{joint}_to_{child}", place, np.zeros(3), np.full(3, np.nan)
                below = self._append(bare, source, turned, basis)
            self._add(child, below, rest * self._lengths[child], basis)

    def _turned(self, children: list[str], frame: np.ndarray) -> np.ndarray:
        """Turn a joint onto its children; without a rest pose these first settle at their mean in its frame."""
        directions = np.stack([self._directions[child] for child in children], 1)
        for _ in range(_SETTLE if self._settles and len(children) > 1 else 0):
            turned = turn_onto(np.stack([self._rest[child] for child in children]), directions, frame)
            for place, child in enumerate(children):
                mean = np.nanmean(np.einsum("fji,fj->fi", turned, directions[:, place]), 0)
                if (size := np.linalg.norm(mean)) > 0:
                    self._rest[child] = mean / size
        return turn_onto(np.stack([self._rest[child] for child in children]), directions, frame)

    def _append(self, joint: tuple, source: int, frame: np.ndarray, turned: np.ndarray) -> int:
        self._joints.append(joint)
        self.sources.append(source)
        self.turned.append(np.einsum("fji,fjk->fik", frame, turned))
        return len(self._joints) - 1


def turn_onto(
    rest: Float[np.ndarray, "children 3"],
    directions: Float[np.ndarray, "frames children 3"],
    frame: Float[np.ndarray, "frames 3 3"],
) -> Float[np.ndarray, "frames 3 3"]:
    """Return rotations that bring ``rest`` onto ``directions``, what these leave open as ``frame`` has it."""
    known = np.isfinite(np.sum(directions, axis=-1))
    wanted = np.einsum("fki,kj->fij", np.where(known[..., None], directions, 0), rest)
    trust = known.all(1).astype(float)
    if len(rest) == 1:
        unfolded = np.einsum("fi,fij,j->f", np.nan_to_num(directions[:, 0]), frame, rest[0])
        trust *= np.clip((1 + unfolded) / _FOLDED, 0, 1)
    turned, _ = nearest_rotation(wanted + _WEAK * frame)
    trusted = np.flatnonzero(trust == 1)
    before = frame[trusted[0]].T @ turned[trusted[0]] if len(trusted) else np.eye(3)
    for now in np.flatnonzero(trust < 1):
        before = frame[now - 1].T @ turned[now - 1] if now else before
        leave = frame[now] @ (trust[now] * np.eye(3) + (1 - trust[now]) * before)
        turned[now], _ = nearest_rotation(wanted[now] + _WEAK * leave)
    return turned


def _bones(prediction: Prediction, pose: np.ndarray) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Return of every joint but the root the direction from its parent (frames 3), and the length."""
    where = {name: place for place, name in enumerate(prediction.joint_names)}
    directions, lengths = {}, {}
    for joint, parent in prediction.skeleton.parents.items():
        if parent is None:
            continue
        step = pose[:, where[joint]] - pose[:, where[parent]]
        length = np.linalg.norm(step, axis=-1)
        known = np.isfinite(length) & (length > 0)
        if not known.any():
            raise UserError(
                f"a .bvh holds complete bodies, but the bone from '{parent}' to '{joint}' is in no frame of this clip. "
                "Leave the joint out of the skeleton, or write another format."
            )
        lengths[joint] = float(np.median(length[known]))
        directions[joint] = np.where(known[:, None], step / np.where(known, length, 1)[:, None], np.nan)
    return directions, lengths


# The rest directions of a rig: the skeleton's rest pose, or the mean shape of the clip.

_ROUNDS = 3
_SCATTERED = 0.3


def _rest_directions(
    prediction: Prediction, directions: dict[str, Float[np.ndarray, "frames 3"]], lengths: dict[str, float]
) -> dict[str, Float[np.ndarray, "3"]]:
    """Return the direction of every bone (by its child) in the rest pose, for a body that faces the viewer.

    Where the skeleton gives no rest pose it is the mean of the clip's frames, each turned onto the first.
    """
    skeleton = prediction.skeleton
    axes = from_y_down(prediction.axes)
    pose = rest_pose(skeleton)
    if pose is None:
        return _facing(skeleton, _mean_shape(directions), lengths, axes)
    steps = {
        joint: pose[skeleton.index(joint)] - pose[skeleton.index(parent)]
        for joint, parent in skeleton.parents.items()
        if parent is not None
    }
    return {joint: axes @ step / np.linalg.norm(step) for joint, step in steps.items()}


def _mean_shape(directions: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return mean directions; those of the fullest frame for a bone that points everywhere."""
    stacked = np.stack(list(directions.values()), 1)
    known = np.isfinite(stacked.sum(-1))
    first = int(np.argmax(known.sum(1)))
    shape = np.where(known[first][:, None], stacked[first], 0)
    filled, count = np.nan_to_num(stacked), np.maximum(known.sum(0), 1)[:, None]
    for _ in range(_ROUNDS):
        turn, _ = nearest_rotation(np.einsum("bi,fbj->fij", shape, filled) + 1e-9 * np.eye(3))
        mean = np.einsum("fij,fbj->bi", turn, filled) / count
        scattered = np.linalg.norm(mean, axis=-1) < _SCATTERED
        mean[scattered & known[first]] = stacked[first][scattered & known[first]]
        size = np.linalg.norm(mean, axis=-1, keepdims=True)
        shape = np.where(size > 1e-6, mean / np.maximum(size, 1e-6), [0.0, 1.0, 0.0])
    return dict(zip(directions, shape, strict=True))


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
    body_up = up if skeleton.gravity or "up" not in skeleton.facing else skeleton.facing_matrix("up") @ pose
    body, wanted = _basis(body_up, front), _basis(up, axes @ [0.0, 0.0, -1.0])
    if body is None or wanted is None:
        return rest
    return {joint: wanted.T @ body @ direction for joint, direction in rest.items()}


def _basis(up: np.ndarray, front: np.ndarray) -> Float[np.ndarray, "3 3"] | None:
    """Return the rows up, front and the side of a body; None where front is along up."""
    up = up / max(float(np.linalg.norm(up)), 1e-12)
    front = front - up * (up @ front)
    size = float(np.linalg.norm(front))
    if size < 1e-6 or not np.linalg.norm(up) > 0.5:
        return None
    return np.stack([up, front / size, np.cross(up, front / size)])
